"""The path of a newcomer: what the README prints runs as printed, and prints what the README says."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from helpers.paths import REPOSITORY, real_rgl_folder
from helpers.small_library import NAMES, measured

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.estimate import reports
from manifold.io_rgl import write_bsdf
from manifold.render import render

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
SECTION = README.split("## With your own measurements")[1].split("\n## ")[0]
BLOCK, *_ = re.findall(r"```sh\n(.*?)```", SECTION, flags=re.DOTALL)
NUMBER = r"[-+]?\d+(?:\.\d+)?"
EXAMPLES = re.findall(r"```text\n\$ manifold (.*?)\n(.*?)```", README, flags=re.DOTALL)


def commands(text):
    """Arguments of the lines that call `manifold`; files come from elsewhere."""
    found = [shlex.split(line, comments=True) for line in text.splitlines()]
    return [words[1:] for words in found if words[0] == "manifold" and words[1] != "fetch"]


def labels(printed):
    """Of the rows of a result."""
    return re.findall(r"^  ([a-z]\S*(?: \S+)*)(?:  |$)", printed, flags=re.MULTILINE)


@pytest.fixture
def downloaded(tmp_path):
    """A folder that holds `rgl`, as if it had been fetched."""
    (tmp_path / "rgl").mkdir()
    for name in NAMES[2:]:
        write_bsdf(tmp_path / "rgl" / f"{name}_spec.bsdf", measured(name))
    write_bsdf(
        tmp_path / "rgl" / "cardboard_spec.bsdf", replace(measured("syn_card_brown"), name="cardboard")
    )
    return tmp_path


def test_the_commands_run_one_after_the_other(run, downloaded, rng, quick_pictures, monkeypatch):
    pytest.importorskip("mitsuba")
    little = render.RenderSettings(size=64, samples=16)
    monkeypatch.setattr(render, "RenderSettings", lambda: little)
    monkeypatch.setattr(reports, "_BALL", 64)
    paint = Plastic(GGX.isotropic(0.005), np.array(1.5), np.full(31, 0.1), MA_T12_BANDS)  # 85 gloss units
    write_ma_t12(downloaded / "sample.xlsx", paint, "sample", rng)
    (complete,) = re.findall(r"`(manifold complete sample\.xlsx .*?)`", SECTION)
    options = re.findall(
        r"`(--\w+ [^`]+)`", SECTION.split("manifold complete")[1].split("`manifold convert`")[0]
    )
    assert options
    lines = [*commands(BLOCK), *commands(f"{complete} {' '.join(options)}")]
    assert [words[0] for words in lines] == ["import", "embed", "predict", "predict", "report", "complete"]
    for words in lines:
        status, out, err = run(*words, cwd=downloaded)
        assert (status, err) == (0, ""), words
        assert out
    for made in ("library.zarr", "model.h5", "between_spec.bsdf", "predicted.bsdf", "map.png", "sample.png"):
        assert (downloaded / made).exists(), made


def test_printed_examples_have_the_form_of_what_is_printed(run, downloaded):
    assert run("import", "rgl", cwd=downloaded)[0] == run("embed", cwd=downloaded)[0] == 0
    assert EXAMPLES
    for command, printed in EXAMPLES:
        out = run(*shlex.split(command), cwd=downloaded)[1]
        assert out.splitlines()[0] == printed.splitlines()[0]
        expected = [label for label in labels(printed) if label != "..."]
        assert len(expected) >= 5
        assert [label for label in labels(out) if label in expected] == expected


@pytest.mark.skipif(real_rgl_folder() is None, reason="the real files are not here")
def test_printed_examples_have_the_numbers_of_what_is_printed(run, tmp_path):
    assert run("import", real_rgl_folder(), cwd=tmp_path)[0] == run("embed", cwd=tmp_path)[0] == 0
    for command, printed in EXAMPLES:
        out = " ".join(run(*shlex.split(command), cwd=tmp_path)[1].split())
        parts = [" ".join(part.split()) for part in printed.split("\n  ...\n")]
        pattern = ".*".join(f"({NUMBER})".join(map(re.escape, re.split(NUMBER, part))) for part in parts)
        match = re.fullmatch(pattern, out)
        assert match, out
        expected = [number for part in parts for number in re.findall(NUMBER, part)]
        for found, number in zip(match.groups(), expected, strict=True):
            last_digit = 10.0 ** -len(number.partition(".")[2])
            # Where the fit of the map ends depends on how a processor rounds.
            assert abs(float(found) - float(number)) < 2.5 * last_digit, (found, number, out)
