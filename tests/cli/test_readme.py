"""The path of a newcomer: what the README prints runs as printed, and prints what the README says."""

from __future__ import annotations

import re
import shlex

import numpy as np
import pytest
from helpers.instrument_files import write_every_format
from helpers.paths import REPOSITORY
from helpers.small_library import NAMES, measured

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.cli.application import COMMANDS
from manifold.io_rgl import write_bsdf

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
TABLE = README.split("| you have | run | you get |")[1].split("\n\n")[0]
RUN = [shlex.split(words)[1:] for words in re.findall(r"`(manifold [^`]+)`", TABLE)]
NUMBER = r"[-+]?\d+(?:\.\d+)?"
EXAMPLES = re.findall(r"```text\n\$ manifold (.*?)\n(.*?)```", README, flags=re.DOTALL)
NOT_RUN = {
    "photograph": "needs pictures",
    "explore": "serves until it is interrupted",
    "demo": "takes a minute",
}
"""Commands of the table that other tests run."""

pytestmark = pytest.mark.usefixtures("quick_pictures")


def labels(printed):
    """Of the rows of a result."""
    return re.findall(r"^  ([a-z]\S*(?: \S+)*)(?:  |$)", printed, flags=re.MULTILINE)


@pytest.fixture
def sample(tmp_path, rng):
    """A folder with the readings of a paint."""
    paint = Plastic(GGX.isotropic(0.2), np.array(1.5), np.full(31, 0.1), MA_T12_BANDS)
    write_ma_t12(tmp_path / "sample.xlsx", paint, "sample", rng)
    return tmp_path


@pytest.fixture
def folder(sample):
    """A folder with the files that the table names."""
    (sample / "rgl").mkdir()
    for name in NAMES:
        write_bsdf(sample / "rgl" / f"{name}_rgb.bsdf", measured(name))
    (sample / "formats").mkdir()
    write_every_format(sample / "formats")["merl"].rename(sample / "alum.binary")
    return sample


def test_the_commands_of_the_table_run(run, folder):
    pytest.importorskip("mitsuba")
    assert {words[0] for words in RUN} >= {"complete", "predict", "import", "embed", "convert", "export"}
    assert {words[0] for words in RUN} <= COMMANDS.keys()
    # What needs no library of its own first: until there is one, commands use the built-in materials.
    order = sorted(RUN, key=lambda words: words[0] in ("import", "embed"))
    for words in order:
        if words[0] not in NOT_RUN:
            status, out, err = run(*words, cwd=folder)
            assert status == 0, (words, err)
            assert out
    for made in ("sample.bsdf", "alum_rgb.bsdf", "between.bsdf", "sample.glb", "library.zarr", "model.h5"):
        assert (folder / made).exists(), made


def test_the_first_completion_writes_a_report(run, sample):
    (block, *_) = re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    (line,) = [line for line in block.splitlines() if line.startswith("manifold complete ")]
    status, _, err = run(*shlex.split(line, comments=True)[1:], cwd=sample)
    assert status == 0, err
    assert (sample / "sample.html").is_file()


def test_printed_examples_have_the_numbers_of_what_is_printed(run, tmp_path):
    assert EXAMPLES
    for command, printed in EXAMPLES:
        out = run(*shlex.split(command), cwd=tmp_path)[1]
        assert len(labels(printed)) >= 4
        parts = [" ".join(part.split()) for part in printed.split("\n  ...\n")]
        pattern = ".*".join(f"({NUMBER})".join(map(re.escape, re.split(NUMBER, part))) for part in parts)
        match = re.fullmatch(pattern, " ".join(out.split()))
        assert match, out
        expected = [number for part in parts for number in re.findall(NUMBER, part)]
        for found, number in zip(match.groups(), expected, strict=True):
            last_digit = 10.0 ** -len(number.partition(".")[2])
            # Where the search for gloss and hue ends depends on how a processor rounds.
            assert abs(float(found) - float(number)) < 2.5 * last_digit, (found, number, out)
