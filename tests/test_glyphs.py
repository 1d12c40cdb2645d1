"""Names whose characters the font of figures lacks: another font draws them, or they are escapes; never boxes."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib.font_manager import FontProperties, findfont, fontManager

from manifold.plots import figures, glyphs, plot_latents


@pytest.fixture
def fonts(monkeypatch):
    """The fonts that come with matplotlib, whatever the system has; no font is remembered."""
    folder = str(matplotlib.get_data_path())
    found = [font for font in fontManager.ttflist if font.fname.startswith(folder)]
    monkeypatch.setattr(glyphs, "fontManager", SimpleNamespace(ttflist=found))
    glyphs._family_with.cache_clear()
    yield {font.name: font.fname for font in found}
    glyphs._family_with.cache_clear()


def drawn(tmp_path, name):
    figure = figures.new_figure(3, 2)
    title = figure.add_subplot().set_title(name)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="Glyph .* missing")  # not what its parser warns of
        figures.save(figure, tmp_path / "x.png")
    return title


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("\u6f06\u9ed2 paint", r"\u6f06\u9ed2 paint"),
        ("\U0001f3a8\ufe0f 3", "\\U0001f3a8\ufe0f 3"),
        ("Gr\u00fcn \u00bd \u2713", "Gr\u00fcn \u00bd \u2713"),
        ("\uac00 for 3 $", r"\uac00 for 3 $"),
    ],
)
def test_what_no_font_has_is_drawn_as_escapes(fonts, name, words, tmp_path):
    assert drawn(tmp_path, name).get_text() == words


def test_what_another_font_has_is_drawn_in_it(fonts, tmp_path):
    own = glyphs._characters(findfont(FontProperties(family=["sans-serif"])))
    only = sorted(c for c in glyphs._characters(fonts["STIXGeneral"]) - own if 0x2190 < c < 0xD800)
    title = drawn(tmp_path, f"a {chr(only[0])}")
    assert title.get_text() == f"a {chr(only[0])}"
    assert len(title.get_fontfamily()) == 2


def test_names_are_measured_as_they_are_drawn(fonts):
    figure = figures.new_figure(3, 3)
    axes = figure.add_subplot()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_latents._label(figure, axes, np.eye(2), ["\u6f06", "b"])
    assert {text.get_text() for text in axes.texts} == {r"\u6f06", "b"}
