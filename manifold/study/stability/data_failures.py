"""Failure modes of data: unmeasured cells, grazing directions, sharp lobes, coarse grids, changed libraries."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.core.directions import from_spherical
from manifold.core.metrics import relative_error
from manifold.core.records import Array, BsdfFile, Mask
from manifold.fit.principled import fit_bsdf
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.diagnostics import diagnose
from manifold.model.location import locate
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions, output_file
from manifold.model.places import Place
from manifold.model.prediction import ClippedBRDF
from manifold.study.stability.testbed import ALPHAS, COLOURS, MIDDLE, TestBed, named, plastic, predict
from manifold.study.stability.trials import SAME_RESULT, Limit, Measurement, Mode

_AS_A_FILE = Limit(
    "relative difference to the result of whole files (of the roughness for the fit)",
    0.1,
    "a file of the usual resolution has an interpolation error of about 9 % between its nodes",
)

_PAIR = (named(ALPHAS[1], 1), named(ALPHAS[2], 1))


def lost_cells(file: BsdfFile, share: float) -> Mask:
    """Return a mask of cells in a few round patches per incidence, (P, T, H, W).

    The patches cover a given share of the measured cells.
    """
    rng = np.random.default_rng(5)
    measured = file.measured_mask
    rows, columns = np.indices(measured.shape[2:])
    lost = np.zeros_like(measured)
    for p, t in np.ndindex(measured.shape[:2] if share > 0 else (0, 0)):
        known = np.argwhere(measured[p, t])
        centres = known[rng.integers(0, len(known), 4)]
        away = np.min([np.hypot(rows - r, columns - c) for r, c in centres], axis=0)
        lost[p, t] = measured[p, t] & (away <= np.quantile(away[measured[p, t]], share))
    return lost


def _times(file: BsdfFile, cells: Mask, factor: float) -> BsdfFile:
    """Return the file with cells (P, T, H, W) multiplied by a factor."""
    scale = np.where(cells, factor, 1.0).astype(np.float32)
    return replace(file, spectra=file.spectra * scale[:, :, None])


Degrade = Callable[[BsdfFile, float], BsdfFile]


def _zeroed(file: BsdfFile, share: float) -> BsdfFile:
    """Set lost cells to exact zeros, though they count as measured."""
    return _times(file, lost_cells(file, share), 0.0)


def _masked(file: BsdfFile, share: float) -> BsdfFile:
    """Mark lost cells as unmeasured and halve their values, like a fault that the instrument has flagged."""
    lost = lost_cells(file, share)
    valid = goniometer.pack_valid(file.measured_mask & ~lost, (3, 1))
    return _times(replace(file, version=(3, 1), valid=valid), lost, 0.5)


def middle_of_family(bed: TestBed) -> list[BsdfFile]:
    """Return the six members of the family with the two middle roughnesses."""
    return [
        bed.file(alpha, COLOURS[k], named(alpha, k)) for alpha in ALPHAS[1:3] for k in range(len(COLOURS))
    ]


def _of_whole_files(bed: TestBed) -> Manifold:
    """Return the manifold of the six whole files."""
    return bed.cached("six", lambda: bed.fit(middle_of_family(bed), "gplvm"))


def _degraded(bed: TestBed, degrade: Degrade, severity: float) -> Manifold:
    """Return the manifold of the six, with every file degraded."""
    key = ("six", degrade.__name__, severity)
    return bed.cached(
        key, lambda: bed.fit([degrade(file, severity) for file in middle_of_family(bed)], "gplvm")
    )


def _predicted(degrade: Degrade, t: float, bed: TestBed, severity: float) -> Measurement:
    """Measure a prediction between two degraded materials against the prediction between the whole ones."""
    model = _degraded(bed, degrade, severity)
    x = model.between(*_PAIR, t)
    clipped = ClippedBRDF(model.predict(x))
    found = output_file(clipped, "predicted", OutputOptions(resolution=16, incidences=6)).plausibility
    made = diagnose(model, Place(x), clipped, found=found, negative_share=clipped.clipped_share)
    undamaged = _of_whole_files(bed)
    whole = undamaged.predict(undamaged.between(*_PAIR, t))
    return Measurement(bed.error(model.predict(x), whole), made.diagnostics)


def _embedded(degrade: Degrade, bed: TestBed, severity: float) -> Measurement:
    """Measure a degraded file embedded in a library of whole files, against the whole file."""
    model, file = _of_whole_files(bed), bed.file(MIDDLE, COLOURS[1])
    found = locate(model, degrade(file, severity))
    whole = bed.cached("embedded", lambda: model.embed(MeasuredBRDF(file)).latent)
    return Measurement(bed.error(model.predict(found.latent), model.predict(whole)), found.diagnostics)


def _fitted(degrade: Degrade, bed: TestBed, severity: float) -> Measurement:
    """Measure the relative error of the roughness that is fitted to a degraded file."""
    file = bed.file(MIDDLE)
    whole = bed.cached("fitted", lambda: fit_bsdf(file))
    found = fit_bsdf(degrade(file, severity))
    ratio = float(np.asarray(found.values["roughness"]) / np.asarray(whole.values["roughness"]))
    return Measurement(abs(ratio - 1.0))


def _unmeasured(key: str, concerns: str, degrade: Degrade, advice: str) -> Mode:
    return Mode(
        key=key,
        concerns=concerns,
        severity="share of the measured cells",
        severities=(0.0, 0.1, 0.3),
        limit=_AS_A_FILE,
        methods={
            "prediction between materials": partial(_predicted, degrade, 0.5),
            "prediction at a material": partial(_predicted, degrade, 0.0),
            "embedding a file": partial(_embedded, degrade),
            "Principled fit": partial(_fitted, degrade),
        },
        advice=advice,
    )


def _albedo_error(found: BRDF, truth: BRDF, theta_i: float) -> float:
    """Return the largest relative error over bands of the directional albedo at an incidence in radians."""
    wi = from_spherical(theta_i, 0.0)
    wo, measure = mirrored_quadrature(wi)
    is_light = measure @ truth.eval_cos(wi, wo)
    return float(np.max(np.abs(measure @ found.eval_cos(wi, wo) / is_light - 1.0)))


def _grazing_file(bed: TestBed, degrees: float) -> Measurement:
    return Measurement(_albedo_error(MeasuredBRDF(bed.file(MIDDLE)), plastic(MIDDLE), np.deg2rad(degrees)))


def _grazing_prediction(bed: TestBed, degrees: float) -> Measurement:
    model = _of_whole_files(bed)
    truth = plastic(MIDDLE, COLOURS[1])
    there, messages = predict(model, model.between(*_PAIR, 0.5))
    return Measurement(_albedo_error(there, truth, np.deg2rad(degrees)), messages)


def _lobe_error(found: BRDF, truth: BRDF) -> float:
    """Return the relative error over outgoing directions, weighted by the lobe, the worst of three incidences."""
    errors = []
    for theta_i in np.deg2rad([0.0, 30.0, 60.0]):
        wi = from_spherical(theta_i, 0.0)
        wo, measure = mirrored_quadrature(wi, 64, 64)
        errors.append(relative_error(truth.eval_cos(wi, wo), found.eval_cos(wi, wo), np.sqrt(measure)))
    return max(errors)


def _sharp_file(bed: TestBed, alpha: float) -> Measurement:
    return Measurement(_lobe_error(MeasuredBRDF(bed.file(alpha)), plastic(alpha)))


def _coarse(file: BsdfFile, nodes: float) -> BsdfFile:
    """Measure half of the family on a grid with that many nodes per axis; return the others unchanged."""
    alpha, colour = file.name.split("_")[1:]
    if (ALPHAS.index(float(alpha)) + int(colour)) % 2:
        return file
    return goniometer.measure(plastic(float(alpha), COLOURS[int(colour)]), file.name, resolution=int(nodes))


def _rounded(file: BsdfFile, bits: float) -> BsdfFile:
    """Return the file with its values rounded to `bits` fewer bits than single precision."""
    unit = np.uint32(1 << int(bits))
    stored = np.ascontiguousarray(file.spectra).view(np.uint32)
    return replace(file, spectra=((stored + unit // 2) & ~(unit - np.uint32(1))).view(np.float32))


Change = Callable[[Path, float], None]
"""A function that changes a folder with `library.zarr` and `model.h5` by a severity; 0 changes nothing."""


def _after_change(change: Change, bed: TestBed, severity: float) -> Measurement:
    """Measure how a change of the library changes a prediction halfway between two materials."""

    def make() -> Path:
        model = bed.fit(middle_of_family(bed), "gplvm")
        model.save(model.library.path.parent / "model.h5")
        return model.library.path.parent

    def values(folder: Path) -> Array:
        model = Manifold.load(folder / "model.h5")
        return model.predict(model.between(*_PAIR, 0.5)).eval(bed.pairs.wi, bed.pairs.wo)

    with TemporaryDirectory() as temporary:
        folder = Path(shutil.copytree(bed.cached("storage", make), temporary, dirs_exist_ok=True))
        whole = values(folder)
        change(folder, severity)
        return Measurement(relative_error(whole, values(folder)))


def _exchange(folder: Path, count: float) -> None:
    """Exchange materials of the library for others under the same names."""
    library = Library.open(folder / "library.zarr")
    (folder / "new").mkdir()
    for name in _materials(library)[: int(count)]:
        file = library.read(name)
        write_bsdf(
            folder / "new" / f"{name}_spec.bsdf", replace(file, spectra=file.spectra * np.float32(0.5))
        )
    if count:
        import_files(library.path, [folder / "new"], replace=True)


def _remove(folder: Path, count: float) -> None:
    """Remove materials from the library."""
    library = Library.open(folder / "library.zarr")
    for name in _materials(library)[: int(count)]:
        shutil.rmtree(library.path / "materials" / name)


def _materials(library: Library) -> list[str]:
    """Return the names of the materials; the first two are those between which predictions lie."""
    return [*_PAIR, *(name for name in library.names if name not in _PAIR)]


MODES: tuple[Mode, ...] = (
    _unmeasured(
        "exact_zeros", "cells that contain zeros although they are marked as measured", _zeroed,
        "Check `manifold info FILE` before importing; repeat measurements with large unmeasured areas.",
    ),
    _unmeasured(
        "masked_cells", "cells that are marked as not measured and contain half of their value", _masked,
        "Keep the instrument's mask in the file: marked cells are filled from their neighbours.",
    ),
    Mode(
        "grazing", "incidence near the horizon, where files interpolate towards 90 degrees",
        "incidence in degrees", (60.0, 75.0, 80.0, 85.0, 87.0),
        Limit(
            "relative error of the directional albedo",
            0.1,
            "a tenth of the light is a step of 2 (at mid grey) to 4 (at white) in CIELAB lightness, visible only "
            "side by side",
        ),
        {"file": _grazing_file, "prediction": _grazing_prediction},
        "Beyond 87 degrees predictions are less reliable; measure more angles of incidence if silhouettes matter.",
    ),
    Mode(
        "sharp_lobe", "nearly mirror-like materials on an outgoing grid of 32 x 32", "GGX roughness alpha",
        (0.2, 0.05, 0.02, 0.01),
        Limit(
            "relative error over the lobe, the worst of 0, 30 and 60 degrees",
            0.2,
            "chosen after the results were known: the shape of the highlight is preserved, and polished metals "
            "differ by more",
        ),
        {"file": _sharp_file},
        "Files represent lobes down to alpha 0.01; use more angles of incidence where highlights are compared.",
    ),
    Mode(
        "mixed_resolution", "a library half of whose files have a coarser outgoing grid",
        "nodes per axis of the coarse files", (32.0, 16.0),
        replace(_AS_A_FILE, quantity="relative difference to the result of a library of 32 nodes"),
        {
            "prediction between materials": partial(_predicted, _coarse, 0.5),
            "prediction at a material": partial(_predicted, _coarse, 0.0),
        },
        "Resolutions can be mixed from 16 nodes upwards; a prediction has the resolution of the files around it.",
    ),
    Mode(
        "single_precision", "values in fewer bits than single precision (13 fewer are half precision)",
        "bits of the mantissa that are lost", (1.0, 13.0),
        replace(
            SAME_RESULT,
            quantity="relative difference to the result of all bits (of the roughness for the fit)",
        ),
        {
            "prediction between materials": partial(_predicted, _rounded, 0.5),
            "embedding a file": partial(_embedded, _rounded),
            "Principled fit": partial(_fitted, _rounded),
        },
        "Single precision exceeds the accuracy of measurements; half precision suffices for storage.",
    ),
    Mode(
        "changed_library", "materials of a library exchanged, or removed, after a model was fitted to it",
        "materials", (0.0, 1.0, 3.0), SAME_RESULT,
        {"exchanged": partial(_after_change, _exchange), "removed": partial(_after_change, _remove)},
        "Embed again after every change of a library.",
    ),
)  # fmt: skip
