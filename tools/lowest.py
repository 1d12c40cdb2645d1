"""Print the lowest versions of what the package requires, as constraints for pip: `name>=1.2` becomes `name==1.2.*`."""

import re
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
extras = project["optional-dependencies"]
users = [
    requirement for extra, some in extras.items() if extra not in ("dev", "docs") for requirement in some
]
for requirement in sorted({*project["dependencies"], *users}):
    if lowest := re.match(r"([\w-]+)>=([\d.]+)", requirement):
        print(f"{lowest[1]}=={lowest[2]}.*")
