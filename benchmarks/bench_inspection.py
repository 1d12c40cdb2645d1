"""How many intact and damaged files `manifold info` flags, and whether it names what was damaged.

    python benchmarks/bench_inspection.py [--files FOLDER] [--json FILE]

Intact are the files of FOLDER, such as measured files of the RGL database, and eight of the corpus, spectral. Damaged
are 50 copies of ten of FOLDER's files (without a folder, of the corpus's eight), in five ways:

    scaled     all values times pi
    cell       one value times 1,000
    negated    one channel times -1
    incidence  the values of one incidence times 3
    bits       200 random bits of the values flipped

A file is flagged if `info` has a finding, or refuses to read it. It is named if `info` also says what was changed: the
factor, the cell, the channel, the incidence, three quarters of the values that changed by more than half
(and by more than a hundredth of the median). The same is
then done to files whose field `luminance` is computed anew from the damaged values, so that it does not help.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from manifold.analytic import corpus
from manifold.colour.conversion import luminance
from manifold.convert.contents import inspect
from manifold.core.errors import FileFormatError
from manifold.core.records import BsdfFile
from manifold.core.text_tables import table_lines
from manifold.formats.tensor_file import read_tensors, write_tensors
from manifold.io_rgl import read_bsdf, write_bsdf

CORPUS = (
    "syn_card_brown", "syn_chrome_mint", "syn_felt_white", "syn_gloss_black",
    "syn_iridescent_violet", "syn_metal_gold", "syn_paper_blue", "syn_satin_purple",
)  # fmt: skip
DAMAGED_FILES = 10
BITS = 200

IsNamed = Callable[[Mapping[str, Any]], bool]
"""Whether the consistency of a file, as JSON has it, says what was damaged."""


def scaled(file: BsdfFile, _: np.random.Generator) -> tuple[BsdfFile, IsNamed]:
    """All values times pi."""
    return replace(file, spectra=file.spectra * np.float32(np.pi)), _says("3.14 times")


def cell(file: BsdfFile, rng: np.random.Generator) -> tuple[BsdfFile, IsNamed]:
    """One value, none of which is zero in its cell, times 1,000."""
    spectra = file.spectra.copy()
    p, t, row, column = rng.choice(np.argwhere(np.all(spectra != 0, axis=2)))
    at = int(p), int(t), int(rng.integers(spectra.shape[2])), int(row), int(column)
    spectra[at] *= 1000
    return replace(file, spectra=spectra), lambda found: _places(found) == {at}


def negated(file: BsdfFile, rng: np.random.Generator) -> tuple[BsdfFile, IsNamed]:
    """One channel times -1."""
    spectra, band = file.spectra.copy(), int(rng.integers(file.spectra.shape[2]))
    spectra[:, :, band] *= -1
    label = file.bands.labels[band]
    return replace(file, spectra=spectra), _says(
        f"values of {label} are -", f"{label} -" if file.bands.is_rgb else label
    )


def incidence(file: BsdfFile, rng: np.random.Generator) -> tuple[BsdfFile, IsNamed]:
    """One incidence times 3."""
    spectra, t = file.spectra.copy(), int(rng.integers(file.spectra.shape[1]))
    spectra[:, t] *= 3
    return replace(file, spectra=spectra), _says(f"{np.rad2deg(file.theta_i_rad[t]):.1f} degrees")


def bits(file: BsdfFile, rng: np.random.Generator) -> tuple[BsdfFile, IsNamed]:
    """Random bits of the values flipped."""
    words = np.ascontiguousarray(file.spectra).view(np.uint32).ravel().copy()
    for k in rng.choice(32 * words.size, BITS, replace=False):
        words[k // 32] ^= np.uint32(1) << np.uint32(k % 32)
    spectra = words.view(np.float32).reshape(file.spectra.shape)
    visible = 0.01 * np.median(file.spectra)
    with np.errstate(invalid="ignore"):
        is_large = np.abs(spectra.astype(float) - file.spectra) > 0.5 * np.abs(file.spectra) + visible
    large = {tuple(at) for at in np.argwhere(is_large).tolist()}
    return replace(file, spectra=spectra), lambda found: len(large & _places(found)) >= 0.75 * len(large)


DAMAGES = {damage.__name__: damage for damage in (scaled, cell, negated, incidence, bits)}


def _says(*words: str) -> IsNamed:
    """Whether a finding has some of the words."""
    return lambda found: any(some in sentence for sentence in found["findings"] for some in words)


def _places(found: Mapping[str, Any]) -> set[tuple[int, ...]]:
    return {tuple(cell["at"]) for cell in found["cells"]}


def with_own_luminance(file: BsdfFile) -> BsdfFile:
    """The file with the luminance of its values."""
    with np.errstate(over="ignore", invalid="ignore"):
        values = luminance(np.moveaxis(file.spectra, 2, -1), file.bands).astype(np.float32)
    return replace(file, luminance=values)


@dataclass(frozen=True)
class Outcome:
    """What `info` says of a file: sentences, or why it refuses it; `is_named` is None for intact files."""

    file: str
    damage: str
    is_flagged: bool
    is_named: bool | None
    sentence: str


def outcome(path: Path, damage: str = "intact", is_named: IsNamed | None = None) -> Outcome:
    """Inspect one file."""
    try:
        found = inspect(path).document["consistency"]
    except FileFormatError as error:
        return Outcome(path.stem, damage, True, None if is_named is None else True, f"refused: {error}")
    findings = found["findings"]
    named = None if is_named is None else bool(findings) and is_named(found)
    return Outcome(path.stem, damage, bool(findings), named, findings[0] if findings else "")


def write_damaged(path: Path, file: BsdfFile, intact: Path) -> None:
    """Write the values and the luminance of a file, whatever they are, with the other fields of an intact one."""
    name = "rgb" if file.bands.is_rgb else "spectra"
    write_tensors(path, read_tensors(intact) | {name: file.spectra, "luminance": file.luminance})


def outcomes_of_damaged(
    paths: list[Path], folder: Path, change: Callable[[BsdfFile], BsdfFile] = lambda file: file
) -> list[Outcome]:
    """Damage files in all ways, change them, write and inspect them; the same random numbers whatever the change."""
    outcomes = []
    for number, path in enumerate(paths):
        for name, damage in DAMAGES.items():
            damaged, is_named = damage(read_bsdf(path), np.random.default_rng(number))
            write_damaged(folder / path.name, change(damaged), path)
            outcomes.append(outcome(folder / path.name, name, is_named))
    return outcomes


def main() -> None:
    """Parse, inspect, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=Path, help="folder of intact .bsdf files")
    parser.add_argument("--json", type=Path, help="write the result here")
    given = parser.parse_args()
    measured = [] if given.files is None else sorted(given.files.glob("*.bsdf"))
    with tempfile.TemporaryDirectory() as folder:
        made, damaged = Path(folder, "corpus"), Path(folder, "damaged")
        made.mkdir()
        damaged.mkdir()
        for material in corpus.isotropic_materials():
            if material.name in CORPUS:
                write_bsdf(made / f"{material.name}_spec.bsdf", corpus.measure(material))
        synthetic = sorted(made.glob("*.bsdf"))
        step = max(len(measured) // DAMAGED_FILES, 1)
        some = measured[::step][:DAMAGED_FILES] or synthetic
        groups = {
            "measured": [outcome(path) for path in measured],
            "corpus": [outcome(path) for path in synthetic],
            "damaged": outcomes_of_damaged(some, damaged),
            "own luminance": outcomes_of_damaged(some, damaged, with_own_luminance),
        }
    rows = [
        (
            group,
            one.file,
            one.damage,
            "flagged" if one.is_flagged else "not flagged",
            _word(one),
            one.sentence[:100],
        )
        for group, outcomes in groups.items()
        for one in outcomes
    ]
    print("\n".join(table_lines(("group", "file", "damage", "", "", "first finding"), rows)))
    counts = [
        Count(
            f"{group}, {damage}",
            len(same),
            sum(one.is_flagged for one in same),
            sum(one.is_named is True for one in same),
        )
        for group, outcomes in groups.items()
        for damage, same in _by_damage(outcomes).items()
    ]
    heads = ("kind", "files", "flagged", "named")
    print("\n".join(["", *table_lines(heads, [tuple(map(str, vars(count).values())) for count in counts])]))
    if given.json:
        given.json.write_text(json.dumps({"counts": [asdict(count) for count in counts]}, indent=2) + "\n")


@dataclass(frozen=True)
class Count:
    """How many files of a kind are flagged and named."""

    key: str
    files: int
    flagged: int
    named: int


def _by_damage(outcomes: list[Outcome]) -> dict[str, list[Outcome]]:
    damages = dict.fromkeys(one.damage for one in outcomes)
    return {damage: [one for one in outcomes if one.damage == damage] for damage in damages}


def _word(one: Outcome) -> str:
    return "" if one.is_named is None else "named" if one.is_named else "not named"


if __name__ == "__main__":
    main()
