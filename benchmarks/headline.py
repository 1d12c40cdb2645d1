"""Print the headline table of README: left-out errors of the built-in library, beside those of the original files.

    python benchmarks/headline.py

Median / 90th percentile over the 20 materials, from `results/`; `make evidence` measures the built-in library.
"""

from __future__ import annotations

import json

from evidence import FOLDER

ROWS = {
    "manifold complete, 12 readings of an MA-T12": ("readings", "completed_from", "MA-T12"),
    "manifold embed, colours fitted": ("held_out", "blend_2"),
    "manifold reconstruct": ("held_out", "nonnegative"),
    "nearest material, by values": ("held_out", "nearest"),
    "nearest material, by balls in other lights": ("held_out", "nearest_by_balls"),
    "GPLVM after Hikichi & Iwasaki": ("held_out", "published"),
    "principled, fitted to the file itself": ("held_out", "principled"),
}
"""Where results have each row."""


def cells(result: str, keys: tuple[str, ...]) -> list[str]:
    """Return the ball error and Delta E ITP of a row, as text."""
    found = json.loads((FOLDER / f"{result}.json").read_text(encoding="utf-8"))
    for key in keys:
        found = found[key]
    both = (found["ball"], found["ball_itp"])
    errors = [each["error"] if isinstance(each, dict) else each for each in both]
    return [f"{median:.2f} / {p90:.2f}" for median, p90 in errors]


def main() -> None:
    """Print the table in Markdown."""
    print(
        "Left-out errors, median / 90th percentile over 20 materials, averaged over five lights\n\n"
        "| method | CIEDE2000, built-in library | CIEDE2000, original files | Delta E ITP, built-in library | "
        "Delta E ITP, original files |\n|---|---|---|---|---|"
    )
    for title, (result, *keys) in ROWS.items():
        columns = [cells(name, tuple(keys)) for name in (f"built_in_{result}", result)]
        shown = [column[kind] for kind in (0, 1) for column in columns]
        print(f"| {title} | {' | '.join(shown)} |")


if __name__ == "__main__":
    main()
