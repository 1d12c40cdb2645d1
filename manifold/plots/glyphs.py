"""Characters that the font of figures lacks: drawn in another font of the system, else written as escapes."""

from __future__ import annotations

from functools import cache

from matplotlib.font_manager import FontProperties, findfont, fontManager
from matplotlib.ft2font import FT2Font

# Outlines of many scripts; colour fonts are bitmaps, which matplotlib cannot draw.
_PREFERRED = (
    "DejaVu Sans", "Noto Sans", "Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans JP", "Noto Sans SC",
    "WenQuanYi Zen Hei", "Droid Sans Fallback", "Hiragino Sans", "PingFang SC", "Yu Gothic", "MS Gothic",
    "Microsoft YaHei", "SimHei", "Malgun Gothic", "Apple SD Gothic Neo", "Noto Emoji", "Noto Sans Symbols 2",
    "Noto Sans Symbols", "Segoe UI Symbol", "Segoe UI Emoji", "Symbola", "FreeSans", "Arial Unicode MS", "Unifont",
)  # fmt: skip
_WITHOUT_SHAPES = ("color", "lastresort", "last resort", "blank")  # in names of fonts
_INVISIBLE = "\u200d\ufe0e\ufe0f"  # joiners and variants of emoji


def drawable(text: str, families: list[str]) -> tuple[str, list[str]]:
    """A text and the families of fonts that can draw it.

    Args:
        text: any, of a name.
        families: that it would be drawn in.
    Returns:
        The text, where what no font has is an escape such as `u6f06` behind a backslash, and the families, with
        others at the end that have what the first lack.
    """
    missing = [c for c in dict.fromkeys(text) if c != "\n" and ord(c) not in _characters_of(tuple(families))]
    found = list(families)
    for c in missing:
        if c in _INVISIBLE:
            text = text.replace(c, "")
        elif (family := _family_with(c)) is None:
            text = text.replace(c, ascii(c)[1:-1])
        elif family not in found:
            found.append(family)
    return text, found


@cache
def _characters_of(families: tuple[str, ...]) -> frozenset[int]:
    return _characters(findfont(FontProperties(family=list(families))))


@cache
def _characters(path: str) -> frozenset[int]:
    try:
        return frozenset(FT2Font(path).get_charmap())
    except (OSError, RuntimeError):  # a damaged font, or one of bitmaps
        return frozenset()


@cache
def _family_with(character: str) -> str | None:
    """The family of an installed font that has a character; preferred ones first."""
    for family, path in _fonts().items():
        if ord(character) in _characters(path):
            return family
    return None


def _fonts() -> dict[str, str]:
    """Path by family of all fonts that may be used, preferred ones first."""
    fonts = {
        font.name: font.fname
        for font in fontManager.ttflist
        if not any(word in font.name.lower() for word in _WITHOUT_SHAPES)
    }
    order = {family: k for k, family in enumerate(_PREFERRED)}
    return dict(sorted(fonts.items(), key=lambda item: order.get(item[0], len(order))))
