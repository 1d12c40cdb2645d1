"""Candidate representations of a measured material, from a handful of numbers to the whole file, and their cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import interpolation_matrix, to_srgb
from manifold.errors import UsageError
from manifold.experiments.budget import reduced_file
from manifold.experiments.budget.scene_survey import MaterialLighting, Survey
from manifold.fitting import fit_samples
from manifold.fitting.bsdf_evaluation import evaluator
from manifold.fitting.bsdf_parameters import principled
from manifold.fitting.fit_samples import FitSamples
from manifold.fitting.principled import FitResult, fit_bsdf
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.records import Array, Bands, BsdfFile
from manifold.rendering import backend, image_metrics
from manifold.rendering.backend import Backend

BANDS = (3, 5, 9, 17, 33)
ANGLES = ((16, 4, 32), (24, 6, 48), (32, 8, 64))
"""Coarser directions: nodes of the outgoing grid, incident elevations, nodes of the visible normals; per axis."""
FULL = "the whole file"

_FLOAT_BYTES = 4
_FITTED_BANDS = 33
_FIT_PAIRS = 1024
_ELSEWHERE = 0.05  # weight of directions that the pre-pass does not see


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to represent a material.

    Attributes:
        name: in words.
        size: bytes of its numbers in single precision, or of its file.
        bsdf: dictionary of Mitsuba, in the scene's kind of colour.
        predicted: mean CIEDE2000 in direct light.
        path: its file; None where its numbers are in `bsdf`.
        numbers: how many of them, where there is no file.
    """

    name: str
    size: int
    bsdf: Mapping[str, Any]
    predicted: float
    path: Path | None = None
    numbers: int | None = None

    @property
    def is_full(self) -> bool:
        """Whether it is the reference itself."""
        return self.name == FULL


@dataclass(eq=False)
class _Builder:
    """The data that the candidates of one material share."""

    file: BsdfFile
    lighting: MaterialLighting
    survey: Survey
    folder: Path
    stem: str
    found: list[Candidate] = field(default_factory=list)
    _ends: tuple[Array, Array] | None = None

    def __post_init__(self) -> None:
        self.rows = np.flatnonzero(self.lighting.lit)
        self.reference = self.seen_of(self.file)

    # -- predicting ------------------------------------------------------------------------------------------

    def seen(self, evaluate: Callable[[Array, Array], Array]) -> Array:
        """Display values (P, 1, 3) for a function from directions to f_cos (m, L)."""
        f_cos = np.zeros((len(self.lighting.wi), self.lighting.bands.count))
        f_cos[self.rows] = evaluate(self.lighting.wi[self.rows], self.lighting.wo[self.rows])
        return self.survey.display(self.lighting.radiance(f_cos))[:, None, :]

    def seen_of(self, file: BsdfFile) -> Array:
        """Display values of a measured file."""
        brdf = MeasuredBRDF(file)
        return self.seen(lambda wi, wo: self.in_light(brdf.eval_cos(wi, wo), file.bands))

    def in_light(self, values: Array, bands: Bands) -> Array:
        """Values (..., B) in the bands of the light, (..., L)."""
        if bands.is_rgb:
            return values
        return values @ interpolation_matrix(_nm(bands), _nm(self.lighting.bands)).T

    def difference(self, seen: Array) -> float:
        """Mean CIEDE2000 to the reference."""
        return float(image_metrics.ciede2000_map(self.reference, seen).mean())

    @cached_property
    def projections(self) -> list[tuple[Array, Array]]:
        """Nodes and matrices to the numbers of bands that are fewer than the file's."""
        bands, lighting = self.file.bands, self.lighting
        found = []
        for count in () if bands.is_rgb else BANDS:
            if count < bands.count:
                nodes = reduced_file.band_nodes(lighting.bands, lighting.spectrum, count)
                found.append(
                    (
                        nodes,
                        reduced_file.band_projection(_nm(bands), nodes, lighting.bands, lighting.spectrum),
                    )
                )
        return found

    def principled_ends(self, fitted: FitResult, shared: Mapping[str, float]) -> tuple[Array, Array]:
        """f_cos with a black and with a white base colour where light falls, each (m, 1)."""
        if self._ends is None:
            made = evaluator(fitted.family, self.lighting.wi[self.rows], self.lighting.wo[self.rows], 3)
            values = made.values(made.layout.join({**shared, "base_color": (0.0, 1.0, 1.0)}))[0]
            self._ends = values[:, :1], values[:, 1:2]
        return self._ends

    # -- adding ----------------------------------------------------------------------------------------------

    def add_file(self, name: str, file: BsdfFile) -> None:
        """A candidate with a file, which is written."""
        kind = "rgb" if file.bands.is_rgb else "spec"
        path = self.folder / f"{self.stem}_{len(self.found)}_{kind}.bsdf"
        write_bsdf(path, file)
        bsdf = {"type": "measured", "filename": str(path)}
        self.found.append(
            Candidate(name, path.stat().st_size, bsdf, self.difference(self.seen_of(file)), path)
        )

    def add_numbers(self, name: str, bsdf: Mapping[str, Any], numbers: int, seen: Array) -> None:
        """A candidate of a few numbers."""
        self.found.append(
            Candidate(name, _FLOAT_BYTES * numbers, bsdf, self.difference(seen), numbers=numbers)
        )


def candidates(path: Path, lighting: MaterialLighting, survey: Survey, folder: Path) -> list[Candidate]:
    """All representations of a measured file, cheapest first; the whole file is among them.

    Args:
        path: the file.
        lighting, survey: where and by what light the scene shows it.
        folder: where reduced files are written.
    """
    file = read_bsdf(path)
    builder = _Builder(file, lighting, survey, folder, path.name.removesuffix(".bsdf"))
    fitted = _fit(file, lighting)
    if file.bands.is_rgb:
        _add_rgb_parameters(builder, fitted, _diffuse_albedo(builder))
    else:
        _add_spectral_parameters(builder, fitted, _diffuse_albedo(builder))
    theta = np.arccos(np.clip(lighting.wi[builder.rows, 2], -1.0, 1.0))
    all_bands = "RGB" if file.bands.is_rgb else f"{file.bands.count} bands"
    bases = {"all angles": file}
    for resolution, incidences, warp_nodes in ANGLES:
        kept = reduced_file.kept_elevations(file, theta, min(incidences, len(file.theta_i_rad)))
        n = min(resolution, file.spectra.shape[3])
        coarse = reduced_file.with_angles(file, kept, resolution=n, warp_nodes=warp_nodes)
        name = f"{n}x{n}x{len(kept)}"
        bases[name] = coarse
        builder.add_file(f"{all_bands}, {name}", coarse)
    for name, base in bases.items():
        for nodes, projection in builder.projections:
            builder.add_file(f"{len(nodes)} bands, {name}", reduced_file.with_bands(base, nodes, projection))
    bsdf = {"type": "measured", "filename": str(path.absolute())}
    builder.found.append(Candidate(FULL, path.stat().st_size, bsdf, 0.0, path))
    return sorted(builder.found, key=lambda candidate: (candidate.size, candidate.predicted, candidate.name))


def milliseconds(bsdf: Mapping[str, Any], is_rgb: bool) -> float:
    """Time of a million evaluations of a BSDF on the backend at hand, in ms: the best of three runs."""
    mi = backend.mitsuba("rgb" if is_rgb else "spectral")
    made = mi.load_dict(dict(bsdf))
    context, best = mi.BSDFContext(), np.inf
    if not backend.choose().is_llvm:
        evaluations = 2000
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(0.6, 0.0, 0.8)
        wo = mi.Vector3f(0.0, 0.6, 0.8)
        for _ in range(3):
            start = time.perf_counter()
            for _ in range(evaluations):
                made.eval(context, si, wo)
            best = min(best, time.perf_counter() - start)
        return 1e9 * best / evaluations
    dr, evaluations = backend.drjit(), 1 << 18
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, evaluations)
    si = dr.zeros(mi.SurfaceInteraction3f, evaluations)
    si.wi = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    if not is_rgb:
        si.wavelengths = mi.sample_rgb_spectrum(mi.sample_shifted(sampler.next_1d()))[0]
    dr.eval(si, wo)
    dr.sync_thread()
    for _ in range(4):  # the first one compiles
        start = time.perf_counter()
        dr.eval(made.eval(context, si, wo))
        dr.sync_thread()
        best = min(best, time.perf_counter() - start)
    return 1e9 * best / evaluations


# -- parameters -----------------------------------------------------------------------------------------------


def _fit(file: BsdfFile, lighting: MaterialLighting) -> FitResult:
    """Principled, fitted where the scene looks, and a little everywhere; spectral ones in `_FITTED_BANDS`."""
    rows = np.flatnonzero(lighting.lit)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, _FIT_PAIRS).astype(int))]
    elsewhere = fit_samples.from_file(file, max_pairs=_FIT_PAIRS // 2)
    wi, wo = (
        np.concatenate([lighting.wi[rows], elsewhere.wi]),
        np.concatenate([lighting.wo[rows], elsewhere.wo]),
    )
    f, bands = np.maximum(MeasuredBRDF(file).eval(wi, wo), 0.0), file.bands
    steep = (wi[:, 2] > 0.05) & (wo[:, 2] > 0.05)
    power = lighting.light[rows].mean(axis=1)
    weight = np.concatenate([power / power.mean(), np.full(len(elsewhere), _ELSEWHERE)])
    if not bands.is_rgb:
        nodes = reduced_file.band_nodes(lighting.bands, lighting.spectrum, _FITTED_BANDS)
        f = np.maximum(
            f @ reduced_file.band_projection(_nm(bands), nodes, lighting.bands, lighting.spectrum).T, 0.0
        )
        bands = Bands.from_array(nodes)
    samples = FitSamples.from_arrays(wi[steep], wo[steep], f[steep], bands=bands, weight=weight[steep])
    return fit_bsdf(samples, principled())


def _diffuse_albedo(builder: _Builder) -> Array:
    """The albedo in the file's bands that gives the mean light of the material, shape (B,)."""
    lighting, rows = builder.lighting, builder.rows
    cosine = lighting.wo[rows, 2]
    power = lighting.light[rows].mean(axis=1)
    f_cos = MeasuredBRDF(builder.file).eval_cos(lighting.wi[rows], lighting.wo[rows])
    return np.clip(np.pi * (power @ f_cos) / (power @ cosine), 0.0, 1.0)


def _add_rgb_parameters(builder: _Builder, fitted: FitResult, albedo: Array) -> None:
    builder.add_numbers(
        "diffuse, RGB", {"type": "diffuse", "reflectance": _rgb(albedo)}, 3, builder.seen(_lambert(albedo))
    )
    _add_principled(builder, fitted, "RGB", _rgb(fitted.values["base_color"]), 3)


def _add_spectral_parameters(builder: _Builder, fitted: FitResult, albedo: Array) -> None:
    lighting, bands = builder.lighting, builder.file.bands
    colour = _rgb(to_srgb(albedo, bands))
    in_light = _upsampled(colour, lighting.bands)
    builder.add_numbers(
        "diffuse, RGB", {"type": "diffuse", "reflectance": colour}, 3, builder.seen(_lambert(in_light))
    )
    for nodes, projection in builder.projections:
        values = np.clip(projection @ albedo, 0.0, 1.0)
        seen = builder.seen(_lambert(builder.in_light(values, Bands.from_array(nodes))))
        bsdf = {"type": "diffuse", "reflectance": _irregular(nodes, values)}
        builder.add_numbers(f"diffuse, {len(nodes)} bands", bsdf, 2 * len(nodes), seen)
    base = builder.in_light(np.clip(fitted.spectra["base_color"], 0.0, 1.0), fitted.bands)
    _add_principled(builder, fitted, "RGB", _rgb(fitted.values["base_color"]), 3)
    for count in BANDS:
        nodes = reduced_file.band_nodes(lighting.bands, lighting.spectrum, count)
        projection = reduced_file.band_projection(
            _nm(lighting.bands), nodes, lighting.bands, lighting.spectrum
        )
        values = np.clip(projection @ base, 0.0, 1.0)
        _add_principled(builder, fitted, f"{count} bands", _irregular(nodes, values), 2 * count)


def _add_principled(
    builder: _Builder, fitted: FitResult, what: str, colour: dict[str, Any], numbers: int
) -> None:
    shared = {name: float(v) for name, v in fitted.values.items() if not isinstance(v, list)}
    # Without tints it is affine in the base colour, band by band: two values tell all bands.
    black, white = builder.principled_ends(fitted, shared)
    values = black + (white - black) * _upsampled(colour, builder.lighting.bands)
    bsdf = {"type": "principled", "base_color": colour, **shared}
    builder.add_numbers(
        f"principled, {what}", bsdf, numbers + len(shared), builder.seen(lambda _wi, _wo: values)
    )


def _lambert(albedo: Array) -> Callable[[Array, Array], Array]:
    return lambda _wi, wo: np.maximum(wo[:, 2:], 0.0) / np.pi * albedo


def _nm(bands: Bands) -> Array:
    if bands.wavelengths_nm is None:
        raise UsageError("found linear sRGB, expected wavelengths")
    return np.array(bands.wavelengths_nm)


def _rgb(colour: Any) -> dict[str, Any]:
    """A colour as Mitsuba takes it: within Rec. 709."""
    return {"type": "rgb", "value": [float(v) for v in np.clip(colour, 0.0, 1.0)]}


def _irregular(nodes: Array, values: Array) -> dict[str, Any]:
    """A spectrum as Mitsuba takes it, constant beyond its nodes."""
    nm = np.concatenate([[300.0], nodes, [1000.0]])
    padded = np.pad(values, 1, mode="edge")
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{v:.7g}" for v in nm),
        "values": ", ".join(f"{v:.7g}" for v in padded),
    }


def _upsampled(texture: Mapping[str, Any], bands: Bands) -> Array:
    """Values of a uniform texture in Mitsuba, shape (L,)."""
    if bands.is_rgb:
        return np.asarray(texture["value"])
    mi = backend.mitsuba("spectral", Backend("scalar"))
    made, si = mi.load_dict({"type": "diffuse", "reflectance": dict(texture)}), mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    values = []
    for wavelength in _nm(bands):
        si.wavelengths = mi.Spectrum(float(wavelength))
        values.append(np.pi * float(made.eval(mi.BSDFContext(), si, mi.Vector3f(0.0, 0.0, 1.0))[0]))
    return np.array(values)
