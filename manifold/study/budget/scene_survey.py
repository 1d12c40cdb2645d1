"""Surveys a scene: the pixels, directions and illumination of its measured materials.

The survey traces primary rays and direct light in Mitsuba's scalar variants, which is faster than compiling a kernel.
It ignores indirect light, and materials that are only visible in mirrors or through glass. A surface that blends
several materials is counted for each of them as if it were the only one. The verifying renderings include all of
this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import qmc

from manifold.colour.conversion import SRGB_TO_XYZ, sensor_responses, xyz_to_srgb, xyz_weights
from manifold.colour.illuminants import Illuminant
from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands
from manifold.render import backend, images
from manifold.render.backend import Backend
from manifold.study.budget.scene_document import SceneDocument

LIGHT_SAMPLES = 16
MOST_PIXELS = 400  # pixels of one material whose light is sampled

_WAVELENGTHS_NM = np.arange(360.0, 831.0, 5.0)
_WHITE_QUANTILE = 0.95


@dataclass(frozen=True, eq=False)
class MaterialLighting:
    """Light and view of one material in a scene, at P pixels with `LIGHT_SAMPLES` directions of light each.

    Attributes:
        mask: mask of the pixels that show the material, bool, shape (height, width).
        wi: unit vectors towards the camera in the local frame, shape (M, 3), with M = P * LIGHT_SAMPLES.
        wo: unit vectors towards the light in the local frame, shape (M, 3).
        light: radiance over density of direct light in each band, shape (M, L); 0 if the light is hidden.
        bands: L wavelengths, or linear sRGB.
    """

    mask: Array
    wi: Array
    wo: Array
    light: Array
    bands: Bands

    @property
    def share(self) -> float:
        """Share of the picture that shows the material."""
        return float(np.mean(self.mask))

    @property
    def lit(self) -> Array:
        """Mask (M,) of the samples with both directions above the surface and with light."""
        return (self.wi[:, 2] > 0.0) & (self.wo[:, 2] > 0.0) & np.any(self.light > 0.0, axis=1)

    def angles_deg(self, directions: Array) -> tuple[float, float]:
        """Return the 5th and 95th percentile of the angles of directions (M, 3) from the normal, in degrees."""
        theta = np.rad2deg(np.arccos(np.clip(directions[self.lit, 2], 0.0, 1.0)))
        return (0.0, 0.0) if theta.size == 0 else tuple(np.quantile(theta, (0.05, 0.95)).tolist())

    def radiance(self, f_cos: Array) -> Array:
        """Return colours of the pixels for f_cos (M, L) in 1/sr, as XYZ or linear sRGB, shape (P, 3)."""
        seen = (self.light * f_cos).reshape(-1, LIGHT_SAMPLES, self.bands.count).mean(axis=1)
        return seen if self.bands.is_rgb else seen @ xyz_weights(self.bands, "E")

    @property
    def white(self) -> Array:
        """Colours of the pixels for a perfect diffuser in place of the material, shape (P, 3)."""
        return self.radiance(np.repeat(np.maximum(self.wo[:, 2:], 0.0) / np.pi, self.bands.count, axis=1))

    @property
    def spectrum(self) -> Array:
        """Mean irradiance in each band, scaled so that the largest value is 1, shape (L,)."""
        total = np.sum(self.light * np.maximum(self.wo[:, 2:], 0.0), axis=0)
        return total / max(float(total.max()), 1e-30)


@dataclass(frozen=True, eq=False)
class Survey:
    """Light and view of all measured materials of a scene.

    Attributes:
        lighting: lighting by key of the material, without materials that no pixel shows.
        white: the exposure: XYZ or linear sRGB that becomes display white. It is that of a perfect diffuser at the
            brightest 5 % of the materials' pixels.
        size: width and height of the analysed picture.
    """

    lighting: Mapping[str, MaterialLighting]
    white: Array
    size: tuple[int, int]

    @property
    def bands(self) -> Bands:
        """Return the bands in which light was sampled."""
        return next(iter(self.lighting.values())).bands

    def display(self, radiance: Array) -> Array:
        """Convert XYZ or linear sRGB (..., 3) to exposed, white-adapted, tone-mapped display values in [0, 1]."""
        if self.bands.is_rgb:
            return images.tone_map(radiance / self.white)
        return images.tone_map(xyz_to_srgb(radiance / self.white[1], self.white / self.white[1]))

    def film(self) -> dict[str, Any]:
        """Return the film for renders whose first three channels `display` takes: linear sRGB, or X, Y, Z.

        Spectral films have a fourth channel, which only directs the sampling of wavelengths to those at which the
        light has power, such as the emission lines of fluorescent lamps.
        """
        width, height = self.size
        common = {"width": width, "height": height, "rfilter": {"type": "box"}}
        if self.bands.is_rgb:
            return {"type": "hdrfilm", "pixel_format": "rgb", **common}
        nm, matching = sensor_responses(Illuminant.named("E"))
        light = np.mean([lighting.spectrum for lighting in self.lighting.values()], axis=0)
        steering = np.interp(nm, _WAVELENGTHS_NM, light, left=0.0, right=0.0) * matching.sum(axis=1)
        steering *= 30.0 * matching.sum() / steering.sum()
        inside = (nm >= 360.0) & (nm <= 830.0)
        columns = zip(("X", "Y", "Z", "Z_steering"), [*matching.T, steering], strict=True)
        ends = {"wavelength_min": float(nm[inside][0]), "wavelength_max": float(nm[inside][-1])}
        channels = {
            name: {"type": "regular", **ends, "values": ", ".join(f"{v:.9g}" for v in values[inside])}
            for name, values in columns
        }
        return {"type": "specfilm", **common, **channels}


def survey(document: SceneDocument, files: Mapping[str, Path], is_rgb: bool, size: int) -> Survey:
    """Survey the light and views of a scene's materials, given their measured files.

    The picture has `size` pixels on the longer side.
    """
    mi = backend.mitsuba("rgb" if is_rgb else "spectral", Backend("scalar"))
    width, height = document.film_size
    scale = size / max(width, height)
    width, height = max(round(width * scale), 1), max(round(height * scale), 1)
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        # Mitsuba's description of a `measured` BSDF holds the file's name: one that is found again.
        names = {key: f"surveyed_{k}_.bsdf" for k, key in enumerate(files)}
        for key, name in names.items():
            (folder / name).symlink_to(files[key].absolute())
        bsdfs = {k: {"type": "measured", "filename": str(folder / name)} for k, name in names.items()}
        scene = document.load(mi, bsdfs, film)
        hits = _primary_hits(mi, scene, width, height, {name: key for key, name in names.items()})
        bands = Bands(None) if is_rgb else Bands.from_array(_WAVELENGTHS_NM)
        lighting = {
            key: _lighting_at(mi, scene, hits[key], (height, width), bands) for key in files if key in hits
        }
    lit = {key: one for key, one in lighting.items() if np.any(one.lit)}
    if not lit:
        raise UsageError(
            f"{document.origin}: no pixel shows a measured material in direct light; check camera and lights"
        )
    whites = np.concatenate([one.white for one in lit.values()])
    level = whites @ SRGB_TO_XYZ[1] if is_rgb else whites[:, 1]
    white = whites.mean(axis=0) * np.quantile(level, _WHITE_QUANTILE) / max(float(level.mean()), 1e-30)
    return Survey(lit, np.full(3, white @ SRGB_TO_XYZ[1]) if is_rgb else white, (width, height))


def _primary_hits(
    mi: Any, scene: Any, width: int, height: int, names: Mapping[str, str]
) -> dict[str, list[tuple[int, int, Any]]]:
    """Return the pixels that show a material, by its key: column, row, and the interaction."""
    sensor = scene.sensors()[0]
    keys: dict[tuple[int, bool], list[str]] = {}
    alive = []  # BSDFs whose identities are in `keys`
    hits: dict[str, list[tuple[int, int, Any]]] = {}
    for y, x in np.ndindex(height, width):
        position = mi.Point2f((x + 0.5) / width, (y + 0.5) / height)
        ray, _ = sensor.sample_ray(0.0, 0.5, position, mi.Point2f(0.5, 0.5))
        si = scene.ray_intersect(ray)
        if not si.is_valid():
            continue
        bsdf, is_front = si.shape.bsdf(), si.wi.z >= 0.0
        if (id(bsdf), is_front) not in keys:
            alive.append(bsdf)
            text = _side(str(bsdf), is_front)
            keys[id(bsdf), is_front] = [key for name, key in names.items() if name in text]
        for key in keys[id(bsdf), is_front]:
            hits.setdefault(key, []).append((x, y, si))
    return hits


def _side(description: str, is_front: bool) -> str:
    """Return the part of Mitsuba's description of a two-sided BSDF that concerns one side."""
    front, back, rest = description.partition("\n  brdf[1] = ")
    return rest if back and not is_front else front


def _lighting_at(
    mi: Any, scene: Any, hits: Sequence[tuple[int, int, Any]], shape: tuple[int, int], bands: Bands
) -> MaterialLighting:
    """Return the light at the hits of one material."""
    mask = np.zeros(shape, dtype=bool)
    for x, y, _ in hits:
        mask[y, x] = True
    chosen = [hits[k] for k in np.unique(np.linspace(0, len(hits) - 1, MOST_PIXELS).astype(int))]
    n = len(chosen) * LIGHT_SAMPLES
    wi, wo, light = np.empty((n, 3)), np.empty((n, 3)), np.zeros((n, bands.count))
    wo[:] = (0.0, 0.0, -1.0)
    points = qmc.Sobol(2, seed=0).random(1 << (n - 1).bit_length())[:n]
    chunks = [None] if bands.is_rgb else _chunks(np.asarray(bands.wavelengths_nm))
    for k in range(n):
        si = chosen[k // LIGHT_SAMPLES][2]
        sample = mi.Point2f(float(points[k, 0]), float(points[k, 1]))
        side = 1.0 if si.wi.z >= 0.0 else -1.0  # side of two-sided surfaces
        wi[k] = si.wi.x, si.wi.y, side * si.wi.z
        for j, chunk in enumerate(chunks):
            if chunk is not None:
                si.wavelengths = mi.Spectrum(*chunk)
            sampled, weight = scene.sample_emitter_direction(si, sample, False)
            if j == 0:
                local = si.to_local(sampled.d)
                wo[k] = local.x, local.y, side * local.z
                if wo[k, 2] <= 0.0 or sampled.pdf == 0.0 or scene.ray_test(si.spawn_ray_to(sampled.p)):
                    break
            values = np.array(weight, dtype=float)
            light[k, 4 * j : 4 * j + 4] = values[: bands.count - 4 * j]
    return MaterialLighting(mask, wi, wo, light, bands)


def _chunks(wavelengths_nm: Array) -> list[list[float] | None]:
    """Return wavelengths in groups of four, the last one padded."""
    padded = np.pad(wavelengths_nm, (0, -len(wavelengths_nm) % 4), mode="edge")
    return [[float(v) for v in four] for four in padded.reshape(-1, 4)]
