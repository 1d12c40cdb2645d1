"""Estimates colour, slope and sparkle at every point of a surface, from pictures under several lamps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import dct, dctn, dst, idct, idctn, idst

from manifold.brdf.interface import EvaluableBRDF
from manifold.core.records import Array, Mask
from manifold.surface.lambertian import OUTLIER, fit_lambertian, tangents
from manifold.surface.lamp_pictures import SurfacePictures
from manifold.surface.response import SLOPE_STD, THIRD_STD, Response, gain_of

SPARKLE = 1.8
"""Smallest ratio of a glint's brightness to its surroundings."""

_SURROUNDINGS_PX = 9  # side of the square whose median a glint exceeds, three times as wide as a glint
_BRIGHTEST = 0.999  # quantile of points; brighter ones are glints and dust
_MIDDLE_COSINE = np.cos(np.deg2rad(50.0))  # lamps farther from the normal make relief sparkle, too
_ROUNDS = 3  # in which what no smooth relief explains is left out
_BLOCK_ROWS = 128  # that are fitted at once


@dataclass(frozen=True, eq=False)
class Surface:
    """The colour, slope and glints of a surface at each of H x W points.

    Columns point along x, rows against y.

    Attributes:
        name: name of the specimen.
        mean: mean diffuse colour in linear sRGB, 1 for a white diffuser, shape (3,).
        albedo: albedo of every point relative to the mean, shape (H, W, 3), above 0, with mean 1.
        slope: x and y components of the normal over its z component, shape (H, W, 2).
        slope_std: standard deviations of both components, shape (2,); the prior's if no lamp determines a
            component.
        third: third factor of the brightness, shape (H, W); see `response`.
        glints: whether a point is brighter in a picture than a smooth relief explains, bool, shape (J, H, W).
        gain: gain of the response to slope; see `response`.
        pictures: the pictures from which the surface was estimated.
        is_lambertian: whether it was fitted as a Lambertian, see `lambertian`, without a third factor.
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
    is_lambertian: bool = False

    def lit(self, lamp: Array, mean: Array) -> Array:
        """Render a picture under another lamp, linear sRGB, shape (H, W, 3).

        Args:
            lamp: unit vector towards the lamp, shape (3,); NaN for diffuse light.
            mean: mean of the picture in linear sRGB, shape (3,).
        """
        if self.is_lambertian:
            shading = self._normal_z * np.maximum(1.0 + self.slope @ tangents(lamp[None])[0], 0.0)
        else:
            shading = np.exp(self._state @ Response.of(lamp[None], mean[None], self.gain).factors[0])
        bright = self.albedo * shading[..., None]
        return np.asarray(bright / bright.mean(axis=(0, 1)) * mean)

    @property
    def is_middle(self) -> Mask:
        """Mask (J,) of the pictures in which glints are counted, those under lamps near the normal."""
        return _is_middle(self.pictures)

    @property
    def _normal_z(self) -> Array:
        return np.asarray(1.0 / np.sqrt(1.0 + np.sum(self.slope**2, axis=-1)))

    @property
    def _state(self) -> Array:
        return np.concatenate([self.slope, self.third[..., None]], axis=-1)

    @cached_property
    def height(self) -> Array:
        """Heights in pixels, with mean 0, from the slopes weighted by their uncertainty, shape (H, W)."""
        return integrated(self.slope, self.slope_std)

    @property
    def relief(self) -> Array:
        """Slopes of the heights, shape (H, W, 2); integrability determines components that no lamp determines."""
        return _slopes_of(self.height)


def estimate_surface(pictures: SurfacePictures, brdf: EvaluableBRDF | None = None) -> Surface:
    """Estimate the surface that best explains pictures under several lamps.

    The fit has Gaussian priors and is robust to glints and cast shadows.

    Args:
        pictures: pictures, three or more of them under lamps.
        brdf: mean BRDF, whose lobe sets the scale of the slopes. If None, pictures from above show a Lambertian, and
            others have the responses of `response` with the scale of a Lambertian under lamps at 30 degrees.
    """
    if brdf is None and pictures.is_from_above:
        lambertian = fit_lambertian(pictures)
        return _surface(
            pictures, lambertian.albedo, lambertian.slope, lambertian.slope_std,
            np.zeros(lambertian.slope.shape[:2]), lambertian.residual, is_lambertian=True,
        )  # fmt: skip
    gain = 1.0 if brdf is None else gain_of(brdf, pictures)
    response = Response.of_pictures(pictures, gain)
    values = pictures.values
    log_means = np.log(values.mean(axis=(1, 2)))
    prior = 1.0 / np.array([SLOPE_STD / gain, SLOPE_STD / gain, THIRD_STD]) ** 2
    trusted = np.full(values.shape[:3], True)
    for _ in range(_ROUNDS):
        state, albedo, residual, covariance = _fitted(values, log_means, response, trusted, prior)
        spread = [1.4826 * np.median(np.abs(picture)) + 1e-6 for picture in residual]
        for picture, is_trusted, s in zip(residual, trusted, spread, strict=True):
            is_trusted[...] = np.abs(picture) <= OUTLIER * s
        trusted[:, np.count_nonzero(trusted, axis=0) < 3] = True  # of what is left, a point needs three
    return _surface(
        pictures,
        np.exp(albedo),
        state[..., :2],
        np.sqrt(np.diagonal(covariance)[:2]),
        state[..., 2],
        residual,
        gain,
    )


def _surface(
    pictures: SurfacePictures, albedo: Array, slope: Array, slope_std: Array, third: Array, residual: Array,
    gain: float = 1.0, *, is_lambertian: bool = False,
) -> Surface:  # fmt: skip
    """Return the surface of a fit, with its mean colour and its glints."""
    values, factors, is_diffuse = pictures.values, pictures.factors, pictures.is_diffuse
    relative = albedo / albedo.mean(axis=(0, 1))
    colour = (values[is_diffuse] if is_diffuse.any() else values).mean(axis=(0, 1, 2))
    if np.isfinite(factors).any():
        colour = np.minimum(colour / np.nanmedian(factors, axis=0), 1.0)
    else:  # nothing says how bright it is: its brightest points are as bright as can be
        colour /= brightest(colour * relative)
    glints = _glints(values, residual, pictures)
    return Surface(
        pictures.name, colour, relative, slope, slope_std, third, glints, gain, pictures, is_lambertian
    )


def brightest(colours: Array) -> float:
    """Return the largest channel of the brightest point of a picture (H, W, 3), except glints and dust."""
    return float(np.max(np.quantile(colours, _BRIGHTEST, axis=(0, 1))))


def _fitted(
    values: Array, log_means: Array, response: Response, trusted: Mask, prior: Array
) -> tuple[Array, Array, Array, Array]:
    """Fit the logarithms of pictures (J, H, W, 3) relative to their means (J, 3), point by point.

    Returns:
        Slopes and third factor (H, W, 3), log albedo (H, W, 3), the residual of each picture, mean over its
        channels (J, H, W), and the mean covariance of slopes and third factor (3, 3).
    """
    J, H, W, _ = values.shape
    state, albedo, residual = np.empty((H, W, 3)), np.empty((H, W, 3)), np.empty((J, H, W))
    normal = np.zeros((3, 3))
    for first in range(0, H, _BLOCK_ROWS):
        rows = slice(first, first + _BLOCK_ROWS)
        logs = np.log(values[:, rows]) - log_means[:, None, None]
        state[rows], albedo[rows], own = _fitted_block(logs, response, trusted[:, rows], prior)
        modelled = np.moveaxis(state[rows] @ response.factors.T, 2, 0) + albedo[rows].mean(axis=-1)
        residual[:, rows] = logs.mean(axis=-1) - modelled
        normal += own / (H * W)
    return state, albedo, residual, np.linalg.inv(normal)


def _fitted_block(logs: Array, response: Response, trusted: Mask, prior: Array) -> tuple[Array, Array, Array]:
    """Return slopes and third factor (H, W, 3), log albedo (H, W, 3), and summed normal matrices (3, 3).

    The albedo of each channel is eliminated: what is left are normal equations of three unknowns a point. Points at
    which the same pictures are trusted share one linear map from logs to unknowns.
    """
    J, H, W, _ = logs.shape
    by_point = np.moveaxis(logs, 0, 2).reshape(H * W, 3 * J)
    patterns, which, counts = np.unique(
        np.packbits(trusted.reshape(J, H * W), axis=0), axis=1, return_inverse=True, return_counts=True
    )
    found, sum_normal = np.empty((H * W, 6)), np.zeros((3, 3))
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
        sum_normal += counts[k] * normal
    state, albedo = (part.reshape(H, W, 3) for part in np.split(found, 2, axis=1))
    return state, albedo, sum_normal


def _glints(values: Array, residual: Array, pictures: SurfacePictures) -> Mask:
    """Return a mask of points under lamps near the normal that are much brighter than surroundings and fit."""
    glints = (residual > np.log(SPARKLE) / 2.0) & _is_middle(pictures)[:, None, None]
    for found, picture in zip(glints, values.mean(axis=-1), strict=True):
        around = np.pad(picture, _SURROUNDINGS_PX // 2, mode="edge")
        windows = sliding_window_view(around, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))[found]
        found[found] = picture[found] > SPARKLE * np.median(windows.reshape(-1, _SURROUNDINGS_PX**2), axis=1)
    return np.asarray(glints)


def _is_middle(pictures: SurfacePictures) -> Mask:
    return np.asarray(np.nan_to_num(pictures.lamps[:, 2]) > _MIDDLE_COSINE)


def integrated(slope: Array, slope_std: Array) -> Array:
    """Return the heights whose slopes fit given slopes best, by least squares with mirrored edges.

    Args:
        slope: components of normals along x (columns) and y (against rows), shape (H, W, 2).
        slope_std: standard deviations of both components, shape (2,).

    Returns:
        Heights in pixels, with mean 0, shape (H, W); normals lean towards falling heights.
    Source: Frankot & Chellappa 1988, with weights; a mirrored surface is a sum of cosines, its slopes of sines.
    """
    h, w = slope.shape[:2]
    k_y, k_x = np.pi * np.arange(h)[:, None] / h, np.pi * np.arange(w) / w
    weight_x, weight_y = 1.0 / np.asarray(slope_std) ** 2
    centred = slope - slope.mean(axis=(0, 1))
    numerator = np.zeros((h, w))
    # A normal leans against the gradient: slope_x = -dh/dcolumn, slope_y = +dh/drow. Sines begin at frequency 1.
    numerator[:, 1:] = weight_x * k_x[1:] * dct(dst(centred[..., 0], axis=1), axis=0)[:, :-1]
    numerator[1:] -= weight_y * k_y[1:] * dct(dst(centred[..., 1], axis=0), axis=1)[:-1]
    denominator = weight_x * k_x**2 + weight_y * k_y**2
    denominator[0, 0] = 1.0
    return np.asarray(idctn(numerator / denominator))


def _slopes_of(height: Array) -> Array:
    """Return the slopes of heights, the derivatives of their sum of cosines, (H, W, 2); the inverse of `integrated`."""
    h, w = height.shape
    spectrum = dctn(height)
    of_x, of_y = np.zeros((h, w)), np.zeros((h, w))
    of_x[:, :-1] = np.pi * np.arange(1, w) / w * spectrum[:, 1:]
    of_y[:-1] = -np.pi * np.arange(1, h)[:, None] / h * spectrum[1:]
    return np.stack([idct(idst(of_x, axis=1), axis=0), idct(idst(of_y, axis=0), axis=1)], axis=-1)
