"""Tables as aligned lines of text, laid out by rich."""

from __future__ import annotations

from collections.abc import Sequence

_WIDEST = 10_000  # columns: rows are never cut


def table_lines(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numeric: Sequence[bool] | None = None,
    bold: bool = False,
) -> list[str]:
    """Return a header line, bold only on terminals, and a line per row; numeric columns are aligned to the right."""
    from rich.console import Console  # 0.1 s, and only results need it
    from rich.table import Table
    from rich.text import Text

    if numeric is None:
        numeric = [all(map(_is_number, cells)) for cells in zip(*rows, strict=True)]
    table = Table(box=None, pad_edge=False, header_style="bold" if bold else "")
    for column, is_right in zip(columns, numeric, strict=True):
        table.add_column(Text(column), justify="right" if is_right else "left", no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row))
    console = Console(highlight=False, width=_WIDEST, color_system="auto" if bold else None)
    with console.capture() as capture:
        console.print(table)
    return [line.rstrip() for line in capture.get().splitlines()]


def _is_number(cell: str) -> bool:
    """Return whether a cell is one number, or a percentage."""
    try:
        float(cell.removesuffix("%"))
    except ValueError:
        return False
    return True
