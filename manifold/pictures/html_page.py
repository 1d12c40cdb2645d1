"""Writes HTML pages in one file, with tables and embedded pictures, which can be printed on A4."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from manifold import __version__
from manifold.core import disk
from manifold.core.names import printable
from manifold.core.records import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEAD = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
@page {{ size: A4; margin: 14mm }}
body {{ font: 15px/1.4 system-ui, sans-serif; margin: 2em auto; max-width: 60em; padding: 0 1em; color: #222 }}
h1 {{ font-size: 1.5em; margin-bottom: .2em }} h2 {{ font-size: 1.1em; margin: 1.4em 0 .4em }}
table {{ border-collapse: collapse; font-size: 13px }} thead {{ display: table-header-group }}
th, td {{ padding: .15em .7em .15em 0; text-align: left; vertical-align: top }}
.numbers td, .numbers th {{ text-align: right; border-bottom: 1px solid #ddd; padding-left: .7em }}
.numbers td:first-child, .numbers th:first-child {{ text-align: left; padding-left: 0 }}
main {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(16em, 1fr)); gap: 1em }}
figure {{ margin: 0 1.5em .6em 0; display: inline-block; vertical-align: top }}
main figure {{ margin: 0; padding: .8em; border: 1px solid #ddd; border-radius: 6px }}
img, svg {{ max-width: 100%; height: auto }} main img {{ width: 100% }}
figcaption {{ font-size: 13px }} figcaption b {{ font-size: 15px }}
section, figure, tr {{ break-inside: avoid }} section.long {{ break-inside: auto }}
@media print {{ body {{ margin: 0; font-size: 12px; max-width: none }} }}
</style></head><body>
<h1>{title}</h1>
"""
_LONG = 20  # rows of a table that may be broken over pages


@dataclass(frozen=True)
class Section:
    """A section of a page: labelled values, a table, pictures, and notes.

    Attributes:
        rows: values by label; several values are a list.
        heads, table: headings of the columns, and the rows of cells.
        pictures: caption and HTML element of each picture, see `picture` and `drawing`.
        notes: sentences.
    """

    title: str
    rows: Mapping[str, object] = field(default_factory=dict)
    heads: Sequence[str] = ()
    table: Sequence[Sequence[object]] = ()
    pictures: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()

    def html(self) -> str:
        """Return the section as HTML; a section without content is empty."""
        if not (self.rows or self.table or self.pictures or self.notes):
            return ""
        is_long = len(self.table) > _LONG
        parts = [f"<section{' class=long' * is_long}><h2>{_text(self.title)}</h2>\n"]
        parts += [
            f"<figure>{element}<figcaption>{_text(caption)}</figcaption></figure>\n"
            for caption, element in self.pictures
        ]
        if self.rows:
            cells = "".join(
                f"<tr><th>{_text(k)}</th><td>{_value(v)}</td></tr>\n" for k, v in self.rows.items()
            )
            parts.append(f"<table>{cells}</table>\n")
        if self.table:
            head = "".join(f"<th>{_text(name)}</th>" for name in self.heads)
            body = "".join(
                "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>\n" for row in self.table
            )
            parts.append(
                f'<table class="numbers"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>\n'
            )
        if self.notes:
            parts.append("<ul>" + "".join(f"<li>{_text(note)}</li>\n" for note in self.notes) + "</ul>\n")
        return "".join([*parts, "</section>\n"])


def write(path: Path, title: str, intro: str, body: str | Sequence[Section]) -> None:
    """Write a page with a title, a sentence, and sections or HTML, atomically."""
    inside = body if isinstance(body, str) else "".join(section.html() for section in body)
    made = f"{intro} Made by manifold {__version__}, {date.today().isoformat()}."
    disk.write_text(path, f"{_HEAD.format(title=_text(title))}<p>{_text(made)}</p>\n{inside}</body></html>\n")


def card(picture: str, alt: str, link: str, name: str, text: str) -> str:
    """Return the HTML of an index entry: a picture from a file beside the page, a linked name, and a line of text."""
    return (
        f'<figure><img src="{quote(picture)}" alt="{_text(alt)}" loading="lazy"><figcaption><b>'
        f'<a href="{quote(link)}">{_text(name)}</a></b><br>{_text(text)}</figcaption></figure>\n'
    )


def picture(display: Array, alt: str, width: int) -> str:
    """Return the HTML element of a picture of display values in [0, 1] (H, W, 3), `width` pixels wide on the page."""
    from PIL import Image

    memory = io.BytesIO()
    Image.fromarray(np.rint(255.0 * np.clip(display, 0.0, 1.0)).astype(np.uint8)).save(memory, "PNG")
    data = base64.b64encode(memory.getvalue()).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" alt="{_text(alt)}" width="{width}">'


def drawing(figure: Figure) -> str:
    """Return the HTML element of a figure, as SVG."""
    memory = io.StringIO()
    figure.savefig(memory, format="svg")
    svg = memory.getvalue()
    return svg[svg.index("<svg") :]


def _text(value: object) -> str:
    return escape(printable(str(value)))


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return "<br>".join(_value(one) for one in value)
    return _text(", ".join(map(str, value)) if isinstance(value, list) else value)
