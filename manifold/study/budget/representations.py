"""Lists representations of a measured material, from a few parameters to the whole file, and measures their cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import interpolation_matrix, to_srgb
from manifold.core.records import Array, Bands, BsdfFile
from manifold.fit import fit_samples
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import FitResult, fit_bsdf
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.render import backend, images
from manifold.render.backend import Backend
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import principled
from manifold.study.budget import reduced_file
from manifold.study.budget.scene_survey import MaterialLighting, Survey

BANDS = (3, 5, 9, 17, 33)
ANGLES = ((16, 4, 32), (24, 6, 48), (32, 8, 64))
"""Coarser grids: nodes per axis of the outgoing grid, angles of incidence, nodes per axis of visible normals."""
FULL = "the whole file"

_FLOAT_BYTES = 4
_FITTED_BANDS = 33
_FIT_PAIRS = 1024
_ELSEWHERE = 0.05  # weight of directions that the pre-pass does not see


@dataclass(frozen=True, eq=False)
class Representation:
    """A representation of a material: a BSDF with a few parameters, or a file.

    Attributes:
        size: size in bytes of the parameters in single precision, or of the file.
        bsdf: Mitsuba's dictionary, in the kind of colour of the scene.
        predicted: predicted mean CIEDE2000 in direct light.
        path: path of the file; None if the parameters are in `bsdf`.
        numbers: number of parameters, if there is no file.
    """

    name: str
    size: int
    bsdf: Mapping[str, Any]
    predicted: float
    path: Path | None = None
    numbers: int | None = None

    @property
    def is_full(self) -> bool:
        """Return whether the representation is the whole file, the reference."""
        return self.name == FULL


class _Builder:
    """Builds the candidates of one material and predicts how each looks.

    Attributes:
        rows: indices of the lighting samples that contribute, shape (m,).
        found: the candidates so far.
    """

    def __init__(self, path: Path, lighting: MaterialLighting, survey: Survey, folder: Path) -> None:
        self.file, self.lighting = read_bsdf(path), lighting
        self.rows = np.flatnonzero(lighting.lit)
        self.found: list[Representation] = []
        self._survey, self._path, self._folder = survey, path, folder
        self._reference = self._appearance_of_file(self.file)

    def appearance(self, evaluate: Callable[[Array, Array], Array]) -> Array:
        """Display values (P, 1, 3) for a function from directions to f_cos (m, L)."""
        return self.appearance_of(evaluate(self.lighting.wi[self.rows], self.lighting.wo[self.rows]))

    def appearance_of(self, seen: Array) -> Array:
        """Display values (P, 1, 3) for f_cos (m, L) in the directions that the pre-pass sees."""
        f_cos = np.zeros((len(self.lighting.wi), self.lighting.bands.count))
        f_cos[self.rows] = seen
        return self._survey.display(self.lighting.radiance(f_cos))[:, None, :]

    def _appearance_of_file(self, file: BsdfFile) -> Array:
        brdf = MeasuredBRDF(file)
        return self.appearance(lambda wi, wo: self.in_light(brdf.eval_cos(wi, wo), file.bands))

    def in_light(self, values: Array, bands: Bands) -> Array:
        """Convert values (..., B) to the bands of the light, (..., L)."""
        if bands.is_rgb:
            return values
        return values @ interpolation_matrix(_nm(bands), _nm(self.lighting.bands)).T

    def few_bands(self, source: Bands, count: int) -> tuple[Array, Array]:
        """Return nodes and matrix from a spectrum to fewer bands under this light; see `reduced_file.few_bands`."""
        return reduced_file.few_bands(source, self.lighting.bands, self.lighting.spectrum, count)

    @cached_property
    def projections(self) -> list[tuple[Array, Array]]:
        """Nodes and matrices to the numbers of bands that are fewer than the file's."""
        bands = self.file.bands
        return [self.few_bands(bands, n) for n in BANDS if not bands.is_rgb and n < bands.count]

    def add_file(self, name: str, file: BsdfFile) -> None:
        """Add a candidate with a file, which is written."""
        kind = "rgb" if file.bands.is_rgb else "spec"
        path = self._folder / f"{self._path.name.removesuffix('.bsdf')}_{len(self.found)}_{kind}.bsdf"
        write_bsdf(path, file)
        self._add_path(name, path, self._predicted(self._appearance_of_file(file)))

    def add_whole_file(self) -> None:
        """Add the material's own file."""
        self._add_path(FULL, self._path.absolute(), 0.0)

    def add_numbers(self, name: str, bsdf: Mapping[str, Any], numbers: int, appearance: Array) -> None:
        """Add a candidate of a few numbers."""
        size = _FLOAT_BYTES * numbers
        self.found.append(Representation(name, size, bsdf, self._predicted(appearance), numbers=numbers))

    def _add_path(self, name: str, path: Path, predicted: float) -> None:
        bsdf = {"type": "measured", "filename": str(path)}
        self.found.append(Representation(name, path.stat().st_size, bsdf, predicted, path))

    def _predicted(self, appearance: Array) -> float:
        return float(images.ciede2000_map(self._reference, appearance).mean())


def candidates(path: Path, lighting: MaterialLighting, survey: Survey, folder: Path) -> list[Representation]:
    """Return all representations of a measured file, cheapest first, including the whole file.

    Reduced files are written to the folder.
    """
    folder.mkdir(exist_ok=True)
    builder = _Builder(path, lighting, survey, folder)
    file = builder.file
    _add_parameters(builder)
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
    builder.add_whole_file()
    return sorted(builder.found, key=lambda candidate: (candidate.size, candidate.predicted, candidate.name))


def milliseconds(bsdf: Mapping[str, Any], is_rgb: bool) -> float:
    """Return the time in ms of a million evaluations of a BSDF on this backend: the best of three runs."""
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


def _fit(builder: _Builder) -> FitResult:
    """Fit `principled`, mainly to the directions that the scene shows; spectral files in `_FITTED_BANDS`."""
    file, lighting = builder.file, builder.lighting
    rows = builder.rows[np.unique(np.linspace(0, len(builder.rows) - 1, _FIT_PAIRS).astype(int))]
    elsewhere = fit_samples.from_brdf(MeasuredBRDF(file)).subsample(_FIT_PAIRS // 2)
    wi = np.concatenate([lighting.wi[rows], elsewhere.wi])
    wo = np.concatenate([lighting.wo[rows], elsewhere.wo])
    f, bands = np.maximum(MeasuredBRDF(file).eval(wi, wo), 0.0), file.bands
    steep = (wi[:, 2] > 0.05) & (wo[:, 2] > 0.05)
    power = lighting.light[rows].mean(axis=1)
    weight = np.concatenate([power / power.mean(), np.full(len(elsewhere), _ELSEWHERE)])
    if not bands.is_rgb:
        nodes, projection = builder.few_bands(bands, _FITTED_BANDS)
        f, bands = np.maximum(f @ projection.T, 0.0), Bands.from_array(nodes)
    samples = FitSamples.from_arrays(wi[steep], wo[steep], f[steep], bands=bands, weight=weight[steep])
    return fit_bsdf(samples, principled())


def _diffuse_albedo(builder: _Builder) -> Array:
    """Return the albedo in the file's bands that gives the mean light of the material, shape (B,)."""
    lighting, rows = builder.lighting, builder.rows
    power = lighting.light[rows].mean(axis=1)
    f_cos = MeasuredBRDF(builder.file).eval_cos(lighting.wi[rows], lighting.wo[rows])
    return np.clip(np.pi * (power @ f_cos) / (power @ lighting.wo[rows, 2]), 0.0, 1.0)


def _add_parameters(builder: _Builder) -> None:
    """Add diffuse and principled BSDFs, in RGB, and for spectral files in a few bands."""
    lighting, bands = builder.lighting, builder.file.bands
    fitted, albedo = _fit(builder), _diffuse_albedo(builder)
    colour = _rgb(albedo if bands.is_rgb else to_srgb(albedo, bands))
    in_light = albedo if bands.is_rgb else _upsampled(colour, lighting.bands)
    builder.add_numbers(
        "diffuse, RGB", {"type": "diffuse", "reflectance": colour}, 3, builder.appearance(_lambert(in_light))
    )
    for nodes, projection in builder.projections:
        values = np.clip(projection @ albedo, 0.0, 1.0)
        appearance = builder.appearance(_lambert(builder.in_light(values, Bands.from_array(nodes))))
        bsdf = {"type": "diffuse", "reflectance": _irregular(nodes, values)}
        builder.add_numbers(f"diffuse, {len(nodes)} bands", bsdf, 2 * len(nodes), appearance)
    colours = {"RGB": (_rgb(fitted.values["base_color"]), 3)}
    if not bands.is_rgb:
        base = builder.in_light(np.clip(fitted.spectra["base_color"], 0.0, 1.0), fitted.bands)
        for count in BANDS:
            nodes, projection = builder.few_bands(lighting.bands, count)
            values = np.clip(projection @ base, 0.0, 1.0)
            colours[f"{count} bands"] = _irregular(nodes, values), 2 * count
    _add_principled(builder, fitted, colours)


def _add_principled(
    builder: _Builder, fitted: FitResult, colours: Mapping[str, tuple[dict[str, Any], int]]
) -> None:
    """Add the fit in base colours, each with its number of values."""
    shared = {name: float(v) for name, v in fitted.values.items() if not isinstance(v, list)}
    lighting, rows = builder.lighting, builder.rows
    made = evaluator(fitted.family, lighting.wi[rows], lighting.wo[rows], 3)
    # Without tints it is affine in the base colour, band by band: two values tell all bands.
    ends = made.values(made.layout.join({**shared, "base_color": (0.0, 1.0, 1.0)}))[0]
    black, white = ends[:, :1], ends[:, 1:2]
    for what, (colour, numbers) in colours.items():
        values = black + (white - black) * _upsampled(colour, lighting.bands)
        bsdf = {"type": "principled", "base_color": colour, **shared}
        appearance = builder.appearance_of(values)
        builder.add_numbers(f"principled, {what}", bsdf, numbers + len(shared), appearance)


def _lambert(albedo: Array) -> Callable[[Array, Array], Array]:
    return lambda _wi, wo: np.maximum(wo[:, 2:], 0.0) / np.pi * albedo


def _nm(bands: Bands) -> Array:
    return np.array(bands.wavelengths_nm, dtype=np.float64)


def _rgb(colour: Any) -> dict[str, Any]:
    """Return a colour as Mitsuba takes it: within Rec. 709."""
    return {"type": "rgb", "value": [float(v) for v in np.clip(colour, 0.0, 1.0)]}


def _irregular(nodes: Array, values: Array) -> dict[str, Any]:
    """Return a spectrum as Mitsuba takes it, constant beyond its nodes."""
    nm = np.concatenate([[300.0], nodes, [1000.0]])
    padded = np.pad(values, 1, mode="edge")
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{v:.7g}" for v in nm),
        "values": ", ".join(f"{v:.7g}" for v in padded),
    }


def _upsampled(texture: Mapping[str, Any], bands: Bands) -> Array:
    """Return the values of a uniform texture in Mitsuba, shape (L,)."""
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
