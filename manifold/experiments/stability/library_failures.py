"""Failure modes of storage: damaged, changed and foreign files, libraries and models."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold.errors import FileFormatError
from manifold.experiments.stability.data_failures import middle_of_family
from manifold.experiments.stability.limits import NONE_TAKEN, SAME_RESULT
from manifold.experiments.stability.testbed import ALPHAS, COLOURS, MIDDLE, TestBed, named
from manifold.experiments.stability.trials import Measurement, Mode, Trial
from manifold.formats.tensor_file import read_tensors, write_tensors
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.metrics import relative_error
from manifold.model import model_file
from manifold.model.located import locate
from manifold.model.manifold import Manifold
from manifold.records import Array
from manifold.system import temporary

_FIRST, _SECOND = named(ALPHAS[1], 1), named(ALPHAS[2], 1)
_FILE = "held_out_spec.bsdf"

Damage = Callable[[Path, float], None]
"""Done to a path by a severity; 0 does nothing."""


@contextmanager
def _copy(bed: TestBed) -> Iterator[Path]:
    """A folder to be damaged: `library.zarr`, `model.h5` fitted to it, and a file that neither knows."""

    def make() -> Path:
        model = bed.fit(middle_of_family(bed), "material")
        folder = model.library.path.parent
        model.save(folder / "model.h5")
        for path in folder.glob("*.bsdf"):
            path.unlink()
        write_bsdf(folder / _FILE, bed.file(MIDDLE, COLOURS[1]))
        return folder

    with temporary.folder() as folder:
        yield Path(shutil.copytree(bed.once("storage", make), folder, dirs_exist_ok=True))


def _values(bed: TestBed, folder: Path) -> Array:
    """The prediction of a folder's model half way between two materials."""
    return (
        Manifold.load(folder / "model.h5").interpolate(_FIRST, _SECOND, 0.5).eval(bed.pairs.wi, bed.pairs.wo)
    )


def _predicted(damage: Damage) -> Trial:
    """A prediction of a damaged folder beside that of the whole one."""

    def trial(bed: TestBed, severity: float) -> Measurement:
        with _copy(bed) as folder:
            whole = _values(bed, folder)
            damage(folder, severity)
            found = _values(bed, folder)
        return Measurement(relative_error(whole, found))

    return trial


def _verified(bed: TestBed, bits: float) -> Measurement:
    """Damaged materials that `manifold info --verify` does not name."""
    with _copy(bed) as folder:
        _flip_values(folder, bits)
        messages = Library.open(folder / "library.zarr").verify()
    return Measurement(float(bits > 0) - len(messages), tuple(messages))


def _flip_values(folder: Path, bits: float) -> None:
    """Turn over bits of the stored values of a material."""
    chunk = next((folder / "library.zarr" / "materials" / _FIRST / "spectra").glob("c.*"))
    content = bytearray(chunk.read_bytes())
    rng = np.random.default_rng(7)
    for place in rng.permutation(len(content) * 3 // 4)[: int(bits)]:  # behind the values comes their index
        content[place] ^= 1 << int(rng.integers(8))
    chunk.write_bytes(content)


def _flip_latents(folder: Path, bits: float) -> None:
    """Turn over the lowest bit of the exponent of some coordinates: twice or half of what they were."""
    path = folder / "model.h5"
    content = bytearray(path.read_bytes())
    first = content.index(Manifold.load(path).X.tobytes())
    for k in range(int(bits)):
        content[first + 8 * k + 6] ^= 0x10
    path.write_bytes(content)


def _cut(path: Path, share: float) -> None:
    """Cut a share of a file's bytes off its end, at least one where the share is not 0."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - int(np.ceil(share * len(content)))])


def _cut_values(folder: Path, share: float) -> None:
    chunk = next((folder / "library.zarr" / "materials" / _FIRST / "spectra").glob("c.*"))
    if share == 1.0:
        chunk.unlink()
    else:
        _cut(chunk, share)


def _cut_model(folder: Path, share: float) -> None:
    _cut(folder / "model.h5", share)


def _older_model(folder: Path, versions: float) -> None:
    """Give a model the version that it had some versions ago."""
    path = folder / "model.h5"
    content = path.read_bytes()
    version = (model_file.FORMAT_VERSION - int(versions)).to_bytes(4, "little")
    path.write_bytes(model_file.MAGIC + version + content[len(model_file.MAGIC) + 4 :])


def _cut_file(folder: Path, share: float) -> None:
    _cut(folder / _FILE, share)


def _spoil_file(folder: Path, count: float) -> None:
    """Put values that are no numbers into a file, as no writer of this package would."""
    fields = dict(read_tensors(folder / _FILE))
    fields["spectra"] = fields["spectra"].copy()
    fields["spectra"].reshape(-1)[
        np.random.default_rng(7).permutation(fields["spectra"].size)[: int(count)]
    ] = np.nan
    write_tensors(folder / _FILE, fields)


def _import(folder: Path) -> None:
    """Import the file; an import of several leaves a bad one out and says why, which is a refusal too."""
    for message in import_files(folder / "library.zarr", [folder / _FILE]).failed.values():
        raise FileFormatError(message)


def _imported(damage: Damage) -> Trial:
    """Damaged or foreign files that an import takes."""

    def trial(bed: TestBed, severity: float) -> Measurement:
        with _copy(bed) as folder:
            damage(folder, severity)
            _import(folder)
        return Measurement(float(severity > 0))

    return trial


def _located(damage: Damage) -> Trial:
    """Damaged or foreign files that are given a place on a manifold."""

    def trial(bed: TestBed, severity: float) -> Measurement:
        with _copy(bed) as folder:
            damage(folder, severity)
            found = locate(folder / "model.h5", folder / _FILE)
        return Measurement(float(severity > 0), found.reconstruction.diagnostics)

    return trial


def _exchange(folder: Path, count: float) -> None:
    """Exchange materials of a library for others under the same names."""
    library = Library.open(folder / "library.zarr")
    names = (_FIRST, _SECOND, *(name for name in library.names if name not in (_FIRST, _SECOND)))
    files = [library.read(name) for name in names[: int(count)]]
    (folder / "new").mkdir()
    for file in files:
        write_bsdf(
            folder / "new" / f"{file.name}_spec.bsdf", replace(file, spectra=file.spectra * np.float32(0.5))
        )
    if files:
        import_files(library.path, [folder / "new"], replace=True)


def _remove(folder: Path, count: float) -> None:
    """Remove materials from a library."""
    for name in (_FIRST, _SECOND, named(ALPHAS[1], 0))[: int(count)]:
        shutil.rmtree(folder / "library.zarr" / "materials" / name)


def _change_bands(folder: Path, count: float) -> None:
    """Make some wavelengths of the file 5 nm longer; make it an RGB file where all of them are to differ."""
    file = read_bsdf(folder / _FILE)
    wavelengths = np.array(file.bands.wavelengths_nm, dtype=np.float32)
    wavelengths[: int(count)] += 5.0
    changed = replace(file, wavelengths_nm=wavelengths)
    if count == len(wavelengths):
        changed = replace(file, wavelengths_nm=None, version=(1, 0))
    write_bsdf(folder / _FILE, changed)


MODES: tuple[Mode, ...] = (
    Mode(
        "flipped_bits", "a material of a library whose stored values were changed on the disk",
        "bits flipped", (0.0, 1.0, 100.0),
        replace(
            SAME_RESULT,
            quantity="relative difference of the prediction; damaged materials that verification does not find",
        ),
        {"prediction": _predicted(_flip_values), "verification": _verified},
        "Delete the material named in the message and import its file again; `manifold info --verify` finds all.",
    ),
    Mode(
        "cut_material", "a material of a library whose stored values were truncated, or removed (1)",
        "share of the bytes", (0.0, 1e-4, 0.5, 1.0), SAME_RESULT, {"prediction": _predicted(_cut_values)},
        "Delete the material named in the message and import its file again.",
    ),
    Mode(
        "cut_file", "a .bsdf file that was truncated", "share of the bytes that is missing",
        (0.0, 1e-4, 0.5, 0.999), NONE_TAKEN,
        {"import": _imported(_cut_file), "embedding a file": _located(_cut_file)},
        "Fetch the file again; the other files of the same import were added to the library.",
    ),
    Mode(
        "not_a_number", "values in a file that are NaN", "values", (0.0, 1.0, 1000.0), NONE_TAKEN,
        {"import": _imported(_spoil_file), "embedding a file": _located(_spoil_file)},
        "Mark cells without a measurement in `valid` and write zeros there.",
    ),
    Mode(
        "changed_library", "materials of a library exchanged, or removed, after a model was fitted to it",
        "materials", (0.0, 1.0, 3.0), SAME_RESULT,
        {"exchanged": _predicted(_exchange), "removed": _predicted(_remove)},
        "Embed again after every change of a library.",
    ),
    Mode(
        "cut_model", "a model file that was truncated", "share of the bytes that is missing",
        (0.0, 1e-4, 0.5, 0.999), SAME_RESULT, {"prediction": _predicted(_cut_model)},
        "Embed again; a model takes seconds.",
    ),
    Mode(
        "flipped_latents", "a model file whose latents were changed on the disk", "bits flipped",
        (0.0, 1.0, 6.0), SAME_RESULT, {"prediction": _predicted(_flip_latents)},
        "Embed again; a model takes seconds.",
    ),
    Mode(
        "old_model", "a model file of an older version of its format", "versions", (0.0, 1.0, 2.0),
        SAME_RESULT, {"prediction": _predicted(_older_model)},
        "Embed again with this version.",
    ),
    Mode(
        "other_bands", "a file of other wavelengths, or of RGB (3), for a library of spectra",
        "bands that differ, of 3", (0.0, 1.0, 3.0), NONE_TAKEN,
        {"import": _imported(_change_bands), "embedding a file": _located(_change_bands)},
        "Use one library per set of bands.",
    ),
)  # fmt: skip
