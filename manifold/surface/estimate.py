"""Colour, slope and sparkle of every point of a surface, from pictures under several lamps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from manifold.brdf.measured import EvaluableBRDF
from manifold.records import Array, Mask
from manifold.surface.lamp_pictures import SurfacePictures
from manifold.surface.response import SLOPE_STD, THIRD_STD, Response, gain_of

SPARKLE = 1.8
"""A glint is so many times as bright as its surroundings."""

_SURROUNDINGS_PX = 9
_MIDDLE_COSINE = np.cos(np.deg2rad(50.0))  # lamps farther from the normal make relief sparkle, too
_ROUNDS = 3  # in which what no smooth relief explains is left out
_OUTLIER = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface, point by point; H rows, W columns. Columns point along x, rows against y.

    Attributes:
        name: of the sample.
        mean: linear sRGB of its diffuse colour, a white diffuser being 1, shape (3,).
        albedo: of every point relative to the mean, shape (H, W, 3), above 0, of mean 1.
        slope: x and y components of the normal over its z component, shape (H, W, 2).
        slope_std: standard deviations of both components, shape (2,); that of the prior where no lamp tells.
        third: third factor of the response, shape (H, W); see `response`.
        glints: pictures in which a point is brighter than a smooth relief explains, shape (J, H, W).
        gain: of the response to slope; see `response`.
        pictures: what it was made from.
    """

    name: str
    mean: Array
    albedo: Array
    slope: Array
    slope_std: Array
    third: Array
    glints: Mask
    gain: float
    pictures: SurfacePictures

    def lit(self, lamp: Array, mean: Array) -> Array:
        """A picture under another lamp, linear sRGB, shape (H, W, 3).

        Args:
            lamp: unit vector towards it, shape (3,); NaN for diffuse light.
            mean: linear sRGB that the picture has in the mean, shape (3,).
        """
        factors = Response.of(lamp[None], mean[None], self.gain).factors[0]
        bright = self.albedo * np.exp(self._state @ factors)[..., None]
        return np.asarray(bright / bright.mean(axis=(0, 1)) * mean)

    @property
    def is_middle(self) -> Mask:
        """Pictures in which glints are sought, those under lamps near the normal, shape (J,)."""
        return _is_middle(self.pictures)

    @property
    def _state(self) -> Array:
        return np.concatenate([self.slope, self.third[..., None]], axis=-1)

    @cached_property
    def height(self) -> Array:
        """Heights in pixels, of mean 0, shape (H, W): the surface whose slopes agree best, each as it is known."""
        return integrated(self.slope, self.slope_std)

    @property
    def relief(self) -> Array:
        """Slopes of the heights, shape (H, W, 2): where lamps do not tell, those that integrability leaves."""
        return _slopes_of(self.height)


def estimate_surface(pictures: SurfacePictures, brdf: EvaluableBRDF | None = None) -> Surface:
    """The surface that explains pictures best: Gaussian priors, robust to glints and cast shadows.

    Args:
        pictures: three or more under lamps.
        brdf: of the mean, whose lobe says how steep slopes are; if None, they are as steep as those of a Lambertian
            under lamps at 30 degrees.
    """
    gain = 1.0 if brdf is None else gain_of(brdf, pictures)
    response = Response.of_pictures(pictures, gain)
    values = pictures.values
    logs = np.log(values / values.mean(axis=(1, 2), keepdims=True))
    prior = 1.0 / np.array([SLOPE_STD / gain, SLOPE_STD / gain, THIRD_STD]) ** 2
    trusted = np.ones(values.shape[:3])
    for _ in range(_ROUNDS):
        state, albedo, covariance = _fitted(logs, response, trusted, prior)
        residual = (logs - albedo - (state @ response.factors.T).transpose(2, 0, 1)[..., None]).mean(axis=-1)
        spread = 1.4826 * np.median(np.abs(residual), axis=(1, 2), keepdims=True) + 1e-6
        trusted = np.where(np.abs(residual) > _OUTLIER * spread, 0.0, 1.0)
        trusted[:, np.sum(trusted, axis=0) < 3] = 1.0  # of what is left, a point needs three
    made = np.exp(albedo)
    factors = pictures.factors
    is_diffuse = pictures.is_diffuse
    scale = np.nanmedian(factors, axis=0) if np.isfinite(factors).any() else np.max(values.mean(axis=(1, 2)))
    colour = (values[is_diffuse] if is_diffuse.any() else values).mean(axis=(0, 1, 2)) / scale
    return Surface(
        pictures.name, np.minimum(colour, 1.0), made / made.mean(axis=(0, 1)), state[..., :2],
        np.sqrt(np.diagonal(covariance)[:2]), state[..., 2], _glints(values, residual, pictures), gain,
        pictures,
    )  # fmt: skip


def _fitted(logs: Array, response: Response, trusted: Array, prior: Array) -> tuple[Array, Array, Array]:
    """Slopes and third factor (H, W, 3), log albedo (H, W, 3), and the mean covariance of the former (3, 3).

    The albedo of each channel is eliminated: what is left are normal equations of three unknowns a point. Points at
    which the same pictures are trusted share one linear map from logs to unknowns.
    """
    J, H, W, _ = logs.shape
    by_point = np.moveaxis(logs, 0, 2).reshape(H * W, 3 * J)
    patterns, which, counts = np.unique(
        np.packbits(trusted.reshape(J, H * W) > 0.0, axis=0), axis=1, return_inverse=True, return_counts=True
    )
    found, mean_normal = np.empty((H * W, 6)), np.zeros((3, 3))
    for k, pattern in enumerate(np.unpackbits(patterns, axis=0, count=J).T):
        weights = response.weights * pattern[:, None]  # [J, channel]
        shares = weights / weights.sum(axis=0)
        apart = response.factors[:, None] - (shares.T @ response.factors)  # [J, channel, factor]
        normal = np.diag(prior) + np.einsum("jc,jck,jcl->kl", weights, apart, apart)
        of_state = np.linalg.solve(normal, (weights[..., None] * apart).reshape(3 * J, 3).T)
        of_albedo = np.einsum("jc,cd->djc", shares, np.eye(3)).reshape(3, 3 * J)
        of_albedo -= shares.T @ response.factors @ of_state
        at = which == k
        found[at] = by_point[at] @ np.concatenate([of_state, of_albedo]).T
        mean_normal += counts[k] / (H * W) * normal
    state, albedo = (part.reshape(H, W, 3) for part in np.split(found, 2, axis=1))
    return state, albedo, np.linalg.inv(mean_normal)


def _glints(values: Array, residual: Array, pictures: SurfacePictures) -> Mask:
    """Points under lamps near the normal that are much brighter than their surroundings and than the fit."""
    glints = (residual > np.log(SPARKLE) / 2.0) & _is_middle(pictures)[:, None, None]
    for found, picture in zip(glints, values.mean(axis=-1), strict=True):
        around = np.pad(picture, _SURROUNDINGS_PX // 2, mode="edge")
        windows = sliding_window_view(around, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))[found]
        found[found] = picture[found] > SPARKLE * np.median(windows.reshape(-1, _SURROUNDINGS_PX**2), axis=1)
    return np.asarray(glints)


def _is_middle(pictures: SurfacePictures) -> Mask:
    return np.asarray(np.nan_to_num(pictures.lamps[:, 2]) > _MIDDLE_COSINE)


def integrated(slope: Array, slope_std: Array) -> Array:
    """Heights whose slopes agree best with given ones, by least squares in the Fourier domain.

    Args:
        slope: components of normals along x (columns) and y (against rows), shape (H, W, 2).
        slope_std: their standard deviations, shape (2,).
    Returns:
        Heights in pixels, of mean 0, shape (H, W); the normal leans towards where it falls.
    Source: Frankot & Chellappa 1988, with weights.
    """
    h, w = slope.shape[:2]
    padded = np.pad(slope - slope.mean(axis=(0, 1)), ((0, h), (0, w), (0, 0)), mode="symmetric")
    padded[h:, :, 1] *= -1.0  # slopes of the mirrored surface
    padded[:, w:, 0] *= -1.0
    k_y = 2j * np.pi * np.fft.fftfreq(2 * h)[:, None]
    k_x = 2j * np.pi * np.fft.rfftfreq(2 * w)[None, :]
    weight_x, weight_y = 1.0 / np.asarray(slope_std) ** 2
    along_x, along_y = (np.fft.rfft2(padded[..., axis]) for axis in range(2))
    # A normal leans against the gradient: slope_x = -dh/dcolumn, slope_y = +dh/drow.
    numerator = weight_x * np.conj(-k_x) * along_x + weight_y * np.conj(k_y) * along_y
    denominator = weight_x * np.abs(k_x) ** 2 + weight_y * np.abs(k_y) ** 2
    denominator[0, 0] = 1.0
    heights = np.fft.irfft2(numerator / denominator, s=(2 * h, 2 * w))[:h, :w]
    return np.asarray(heights - heights.mean())


def _slopes_of(height: Array) -> Array:
    rows, columns = np.gradient(height)
    return np.stack([-columns, rows], axis=-1)
