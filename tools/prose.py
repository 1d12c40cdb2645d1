r"""Check the formulas of the documents: `\frac12` must be written `\frac{1}{2}`.

TeX reads `\tfrac12 X` as one half of X, but some converters to HTML read it as 12 over X, without an error.

    python tools/prose.py [CHECKOUT]    names every such place; exits with 1 if there are any

`codespell` checks the spelling.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

_UNBRACED = re.compile(r"\\[tdc]?frac *\d *\d")


def documents(root: Path) -> Iterator[Path]:
    """Yield the Markdown files of a checkout, without those that the site's build writes."""
    for path in [*root.glob("*.md"), *sorted((root / "docs").rglob("*.md"))]:
        if not {"_build", "_work", "gallery"} & set(path.parts):
            yield path


def unbraced_fractions(path: Path) -> Iterator[str]:
    """Yield line and text of every fraction of two digits without braces."""
    for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), start=1):
        for found in _UNBRACED.finditer(line):
            yield f"{number}: {found[0]}"


def main() -> int:
    """Print the places."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]
    places = [
        f"{path.relative_to(root)}:{place}" for path in documents(root) for place in unbraced_fractions(path)
    ]
    for place in places:
        print(f"{place} (write braces: \\frac{{1}}{{2}})")
    return 1 if places else 0


if __name__ == "__main__":
    sys.exit(main())
