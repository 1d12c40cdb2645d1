"""Adds surfaces to the page: the mean BRDF as a further material, and small textures."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from manifold.brdf.interface import BRDF
from manifold.brdf.wrapper import WrappedBRDF
from manifold.colour.conversion import encode_srgb, interpolation_matrix, to_srgb
from manifold.core.directions import normalize
from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands
from manifold.model.location import locate_brdf
from manifold.model.manifold import Manifold
from manifold.page.tabulated_pairs import TabulatedPairs
from manifold.surface.sparkle import DrawnFlakes
from manifold.surface.tiling import Textures
from manifold.surface.written import WrittenSurface

SIZE = 512
"""Largest side of textures in a page, in pixels; a surface then takes about 0.6 MB."""

_QUALITY = 95  # of WebP, which colours are written in: 2 in 255 off
_SIDES = ([1.0, 1.0, 1.0], [1.0, -1.0, 1.0])  # of the plane of wi and the normal


class _InBands(WrappedBRDF):
    """A BRDF in the bands of a map: linear sRGB, or interpolated between its own wavelengths, constant beyond."""

    def __init__(self, brdf: BRDF, bands: Bands) -> None:
        super().__init__(brdf)
        own = brdf.bands
        if own.wavelengths_nm is None and bands.wavelengths_nm is not None:
            raise UsageError(
                "this surface is RGB but the map is spectral; open a map of an RGB library (--model)"
            )
        self.bands = bands
        nm = (own.wavelengths_nm, bands.wavelengths_nm)
        self._matrix = None if None in nm else interpolation_matrix(*map(np.array, nm))

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B)."""
        values = self._brdf.eval(wi, wo)
        if self._matrix is None:
            return to_srgb(values, self._brdf.bands)
        return np.asarray(values @ self._matrix.T)


def components_of(
    surface: WrittenSurface, bands: Bands, pairs: TabulatedPairs, basis: Array
) -> NDArray[np.float32]:
    """Return the cube roots (R, P) of a surface's mean BRDF at the pairs of a page, in its spectral basis (J, R).

    The mean is converted to `bands`.
    """
    brdf = _InBands(surface.brdf, bands)
    roots = [np.cbrt(np.maximum(brdf.eval(pairs.wi * side, pairs.wo * side), 0.0)) for side in _SIDES]
    weighted = np.mean(roots, axis=0) * pairs.amplitude[:, None]  # [P, J]
    return np.asarray(np.linalg.pinv(basis) @ weighted.T, dtype=np.float32)


def surface_document(surface: WrittenSurface, model: Manifold) -> dict[str, Any]:
    """Return a surface's point on the map, and its textures, as JSON."""
    located = locate_brdf(model, _InBands(surface.brdf, model.bands))
    return {
        "name": surface.name,
        "latent": located.latent.tolist(),
        "expected": surface.expected_ball,  # error of the mean
        "apart": float(located.errors.ball),  # the map's prediction from the mean, CIEDE2000 of the ball
        **_textures(surface.textures),
        "flakes": None if surface.flakes is None else _flakes(surface.flakes),
    }


def _textures(textures: Textures) -> dict[str, Any]:
    """Return colours over the brightest of each channel, sRGB, and normals, as `manifold surface` writes them."""
    brightest = textures.albedo.max(axis=(0, 1))
    slope = _reduced(textures.slope)
    normal = normalize(np.concatenate([slope, np.ones((*slope.shape[:2], 1))], axis=-1))
    return {
        "colours": _picture(encode_srgb(_reduced(textures.albedo / brightest)), "WEBP"),
        "brightest": brightest.tolist(),
        "normals": _picture(0.5 + 0.5 * normal, "PNG"),
    }


def _flakes(drawn: DrawnFlakes) -> dict[str, Any]:
    """Return the parameters of flakes, and a picture of their normals (x, y) and of their share of each pixel."""
    nearest = distance_transform_edt(~drawn.mask, return_distances=False, return_indices=True)
    size = len(drawn.mask)
    at = ((np.arange(min(size, SIZE)) + 0.5) * size / min(size, SIZE)).astype(int)
    normal = drawn.normal[tuple(nearest)][np.ix_(at, at)]
    covered = _reduced(drawn.mask[..., None].astype(float))
    return {
        "roughness": drawn.flakes.roughness,
        "reflectance": drawn.facet.reflectance,
        "share": drawn.share,
        "texture": _picture(
            np.concatenate([0.5 + 0.5 * normal[..., :2] * (covered > 0.0), covered], axis=-1), "PNG"
        ),
    }


def _reduced(values: Array) -> Array:
    """Average values (S, S, C) to at most `SIZE` pixels a side."""
    from PIL import Image

    size = (min(len(values), SIZE),) * 2
    planes = [Image.fromarray(plane.astype(np.float32)) for plane in np.moveaxis(values, -1, 0)]
    return np.stack([np.asarray(plane.resize(size, Image.Resampling.BOX)) for plane in planes], axis=-1)


def _picture(values: Array, kind: str) -> str:
    """Return values in [0, 1], (S, S, 3), as a picture in text."""
    from PIL import Image

    stream = io.BytesIO()
    picture = Image.fromarray(np.round(255.0 * values).astype(np.uint8))
    picture.save(stream, kind, quality=_QUALITY, method=6, optimize=True)
    return base64.b64encode(stream.getvalue()).decode()
