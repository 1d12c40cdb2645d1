"""Measured figures of documents, from benchmarks/results/*.json: `2.6 / 9.8<!-- held_out_blend_2_ball -->`.

The comment is not shown, on the site or on the repository's pages. `python docs/figures.py` writes all figures again.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

RESULTS = Path(__file__).resolve().parents[1] / "benchmarks" / "results"
_ROUNDING = 1e-9  # smaller values are 0 but for the rounding of sums
NAMED = re.compile(r"(-?[\d.,]+(?: / -?[\d.,]+)*)<!-- (\w+) -->")


def figures() -> dict[str, str]:
    """Every number of the results by `file_key_key`, to two digits; lists (median, 90th percentile) with a stroke."""
    found: dict[str, str] = {}
    for file in sorted(RESULTS.glob("*.json")):
        _add(found, file.stem, json.loads(file.read_text(encoding="utf-8")))
    return found


def _add(found: dict[str, str], prefix: str, value: object) -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            _add(found, f"{prefix}_{key}", inner)
    elif isinstance(value, list) and value and all(isinstance(one, dict) and "key" in one for one in value):
        _add(found, prefix, {one["key"]: one for one in value})
    elif isinstance(value, list) and all(isinstance(one, int | float) for one in value):
        found[_key(prefix)] = " / ".join(map(shown, value))
    elif isinstance(value, str | int | float):
        found[_key(prefix)] = shown(value)


def _key(text: str) -> str:
    return re.sub(r"\W+", "_", text)


def shown(value: str | float) -> str:
    """As documents print it: numbers to two digits, whole ones as they are."""
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    if not isinstance(value, float) or not math.isfinite(value):
        return str(value)
    if abs(value) < _ROUNDING:
        value = 0.0
    decimals = 0 if value == 0.0 else max(0, 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}"


def main() -> None:
    """Write the figures of all documents again."""
    held = figures()
    folder = Path(__file__).resolve().parent
    for document in (folder.parent / "README.md", *folder.rglob("*.md")):
        text = document.read_text(encoding="utf-8")
        renewed = NAMED.sub(lambda found: f"{held[found[2]]}<!-- {found[2]} -->", text)
        if renewed != text:
            document.write_text(renewed, encoding="utf-8")


if __name__ == "__main__":
    main()
