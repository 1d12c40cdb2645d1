"""Print the lowest versions of what the package requires, as constraints for pip: `name>=1.2` becomes `name==1.2.*`."""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
for requirement in project["project"]["dependencies"]:
    print(requirement.replace(">=", "==") + ".*")
