"""Failure modes of what files hold: unmeasured cells, grazing directions, sharp lobes, coarse grids, versions."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.directions import from_spherical
from manifold.experiments.stability.bench import ALPHAS, COLOURS, MIDDLE, Bench, named, plastic, predict
from manifold.experiments.stability.trials import Found, Mode
from manifold.fitting.principled import fit_bsdf
from manifold.io_rgl import write_bsdf
from manifold.metrics import relative_error
from manifold.model import predicted_file
from manifold.model.located import locate
from manifold.model.manifold import Manifold
from manifold.records import Array, BsdfFile

# A file of the usual resolution is itself some 9 % off between its nodes: a change of that size is no worse than the
# choice of another instrument.
_AS_A_FILE = 0.1
# A tenth of the light is a step of 2 (at mid grey) to 4 (at white) in CIELAB lightness: seen beside the truth only.
_LIGHT = 0.1

_PAIR = (named(ALPHAS[1], 1), named(ALPHAS[2], 1))


def lost_cells(file: BsdfFile, share: float) -> Array:
    """Cells of a few round patches per incidence that cover a share of the measured ones, bool, shape (P, T, H, W)."""
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


def _times(file: BsdfFile, cells: Array, factor: float) -> BsdfFile:
    """The file with cells (P, T, H, W) multiplied."""
    scale = np.where(cells, factor, 1.0).astype(np.float32)
    return replace(file, spectra=file.spectra * scale[:, :, None])


def _marked(file: BsdfFile, cells: Array, version: tuple[int, int]) -> BsdfFile:
    """The file, as a pipeline of a version writes it, with cells (P, T, H, W) marked as not measured."""
    return replace(file, version=version, valid=goniometer.pack_valid(file.measured_mask & ~cells, version))


Spoil = Callable[[BsdfFile, float], BsdfFile]


def _zeroed(file: BsdfFile, share: float) -> BsdfFile:
    """Cells are lost and hold exact zeros, though they count as measured."""
    return _times(file, lost_cells(file, share), 0.0)


def _masked(file: BsdfFile, share: float) -> BsdfFile:
    """Cells are lost and marked; they hold half their value: a fault that an instrument noted."""
    lost = lost_cells(file, share)
    return _times(_marked(file, lost, (3, 1)), lost, 0.5)


def middle_of_family(bench: Bench) -> list[BsdfFile]:
    """The six members of the family whose roughness is not an extreme one."""
    return [
        bench.file(alpha, COLOURS[k], named(alpha, k)) for alpha in ALPHAS[1:3] for k in range(len(COLOURS))
    ]


def _whole(bench: Bench) -> Manifold:
    """The manifold of the six."""
    return bench.once("six", lambda: bench.fit(middle_of_family(bench), "material"))


def _spoilt(bench: Bench, spoil: Spoil, severity: float) -> Manifold:
    """The manifold of the six, every file spoilt."""
    key = ("six", spoil.__name__, severity)
    return bench.once(
        key, lambda: bench.fit([spoil(file, severity) for file in middle_of_family(bench)], "material")
    )


def _predicted(spoil: Spoil, t: float) -> Callable[[Bench, float], Found]:
    """On the line between two materials of a library of spoilt files, beside the same of whole files."""

    def trial(bench: Bench, severity: float) -> Found:
        model = _spoilt(bench, spoil, severity)
        x = model.between(*_PAIR, t)
        with tempfile.TemporaryDirectory() as folder:
            made = predicted_file.predict(
                model, x, Path(folder, "predicted_spec.bsdf"), resolution=16, n_theta_i=6
            )
        whole = _whole(bench).interpolate(*_PAIR, t)
        return Found(bench.error(model.predict(x), whole), made.diagnostics)

    return trial


def _embedded(spoil: Spoil) -> Callable[[Bench, float], Found]:
    """A spoilt file embedded in a whole library, beside the same file whole."""

    def trial(bench: Bench, severity: float) -> Found:
        model, file = _whole(bench), bench.file(MIDDLE)
        with tempfile.TemporaryDirectory() as folder:
            model.save(Path(folder, "model.h5"))
            write_bsdf(Path(folder, "spoilt_rgb.bsdf"), spoil(file, severity))
            found = locate(Path(folder, "model.h5"), Path(folder, "spoilt_rgb.bsdf"))
        whole = bench.once("embedded", lambda: model.embed(MeasuredBRDF(file)).latent)
        there = model.predict(np.array(found.latent))
        return Found(bench.error(there, model.predict(whole)), found.diagnostics)

    return trial


def _fitted(spoil: Spoil) -> Callable[[Bench, float], Found]:
    """Roughness of a Principled BSDF fitted to a spoilt file, beside the same file whole, as a ratio less 1."""

    def trial(bench: Bench, severity: float) -> Found:
        file = bench.file(MIDDLE)
        whole = bench.once("fitted", lambda: fit_bsdf(file))
        found = fit_bsdf(spoil(file, severity))
        ratio = float(np.asarray(found.values["roughness"]) / np.asarray(whole.values["roughness"]))
        return Found(abs(ratio - 1.0))

    return trial


def _unmeasured(key: str, concerns: str, severity: str, spoil: Spoil, advice: str) -> Mode:
    return Mode(
        key=key,
        concerns=concerns,
        severity=severity,
        severities=(0.0, 0.1, 0.3),
        number="relative difference to the result of whole files (of the roughness for the fit)",
        threshold=_AS_A_FILE,
        methods={
            "prediction between materials": _predicted(spoil, 0.5),
            "prediction at a material": _predicted(spoil, 0.0),
            "embedding a file": _embedded(spoil),
            "Principled fit": _fitted(spoil),
        },
        advice=advice,
    )


def _albedo_error(found: BRDF, truth: BRDF, theta_i: float) -> float:
    """Largest relative error over bands of the directional albedo at an incidence in radians."""
    wi = from_spherical(theta_i, 0.0)
    wo, measure = mirrored_quadrature(wi)
    is_light = measure @ truth.eval_cos(wi, wo)
    return float(np.max(np.abs(measure @ found.eval_cos(wi, wo) / is_light - 1.0)))


def _grazing_file(bench: Bench, degrees: float) -> Found:
    return Found(_albedo_error(MeasuredBRDF(bench.file(MIDDLE)), plastic(MIDDLE), np.deg2rad(degrees)))


def _grazing_prediction(bench: Bench, degrees: float) -> Found:
    model = _whole(bench)
    truth = plastic(MIDDLE, COLOURS[1])
    there, said = predict(model, model.between(*_PAIR, 0.5))
    return Found(_albedo_error(there, truth, np.deg2rad(degrees)), said)


def _lobe_error(found: BRDF, truth: BRDF) -> float:
    """Relative error over outgoing directions, each as wide as the lobe is there, the worst of three incidences."""
    errors = []
    for theta_i in np.deg2rad([0.0, 30.0, 60.0]):
        wi = from_spherical(theta_i, 0.0)
        wo, measure = mirrored_quadrature(wi, 64, 64)
        errors.append(relative_error(truth.eval_cos(wi, wo), found.eval_cos(wi, wo), np.sqrt(measure)))
    return max(errors)


def _sharp_file(bench: Bench, alpha: float) -> Found:
    return Found(_lobe_error(MeasuredBRDF(bench.file(alpha)), plastic(alpha)))


def _coarse(file: BsdfFile, nodes: float) -> BsdfFile:
    """The file measured on a grid of that many nodes per axis, if it is one of every second member of the family."""
    alpha, colour = file.name.split("_")[1:]
    if (ALPHAS.index(float(alpha)) + int(colour)) % 2:
        return file
    return goniometer.measure(plastic(float(alpha), COLOURS[int(colour)]), file.name, resolution=int(nodes))


def _misread_mask(bench: Bench, share: float) -> Found:
    """Files of both meanings of the bits: the largest share of cells that are read the wrong way round."""
    file = bench.file(MIDDLE)
    lost = lost_cells(file, share)
    known = file.measured_mask & ~lost
    misread = [np.mean(_marked(file, lost, version).measured_mask != known) for version in ((3, 1), (3, 2))]
    return Found(float(max(misread)))


def _rounded(file: BsdfFile, bits: float) -> BsdfFile:
    """The file with values of so many bits fewer than single precision has."""
    unit = np.uint32(1 << int(bits))
    stored = np.ascontiguousarray(file.spectra).view(np.uint32)
    return replace(file, spectra=((stored + unit // 2) & ~(unit - np.uint32(1))).view(np.float32))


MODES: tuple[Mode, ...] = (
    _unmeasured(
        "exact_zeros",
        "cells that were lost and hold zeros, though they count as measured",
        "share of the measured cells",
        _zeroed,
        "Look at `manifold info FILE` before importing; measure again what has large unmeasured areas.",
    ),
    _unmeasured(
        "masked_cells",
        "cells that are marked as not measured and hold half of their value",
        "share of the measured cells",
        _masked,
        "Keep the mask of the instrument in the file: marked cells are closed from their rims.",
    ),
    Mode(
        key="grazing",
        concerns="incidence near the horizon, where files interpolate towards 90 degrees",
        severity="incidence in degrees",
        severities=(60.0, 75.0, 80.0, 85.0, 87.0),
        number="relative error of the directional albedo",
        threshold=_LIGHT,
        methods={"file": _grazing_file, "prediction": _grazing_prediction},
        advice="Beyond 87 degrees trust silhouettes less, or measure more elevations.",
    ),
    Mode(
        key="sharp_lobe",
        concerns="nearly mirror-like materials on an outgoing grid of 32 x 32",
        severity="GGX roughness alpha",
        severities=(0.2, 0.05, 0.02, 0.01),
        number="relative error over the lobe, the worst of 0, 30 and 60 degrees",
        # A lobe that is off by less keeps the shape of its highlight; polished metals differ by more from each other.
        threshold=0.2,
        methods={"file": _sharp_file},
        advice="Files carry lobes down to alpha 0.01; take more incident elevations where highlights are compared.",
    ),
    Mode(
        key="mixed_resolution",
        concerns="a library half of whose files have a coarser outgoing grid",
        severity="nodes per axis of the coarse files",
        severities=(32.0, 16.0),
        number="relative difference to the result of a library of 32 nodes",
        threshold=_AS_A_FILE,
        methods={
            "prediction between materials": _predicted(_coarse, 0.5),
            "prediction at a material": _predicted(_coarse, 0.0),
        },
        advice="Mix resolutions freely from 16 nodes up; a prediction is as fine as the files around it.",
    ),
    Mode(
        key="mixed_versions",
        concerns="files of pipelines whose bits of `valid` mean measured, or not measured",
        severity="share of the measured cells that are marked as lost",
        severities=(0.0, 0.15, 0.3),
        number="share of the cells that are read the wrong way round",
        threshold=0.01,  # as many cells as real files disagree in anyway
        methods={"mask": _misread_mask},
        advice="Leave the version of a file as its pipeline wrote it; files of all versions share a library.",
    ),
    Mode(
        key="single_precision",
        concerns="values of fewer bits than single precision has (13 fewer are half precision)",
        severity="bits of the mantissa that are lost",
        severities=(1.0, 13.0),
        number="relative difference to the result of all bits (of the roughness for the fit)",
        threshold=0.01,  # instruments repeat themselves no better
        methods={
            "prediction between materials": _predicted(_rounded, 0.5),
            "embedding a file": _embedded(_rounded),
            "Principled fit": _fitted(_rounded),
        },
        advice="Single precision is more than measurements need; half precision is enough for storage.",
    ),
)
