"""Models how the brightness of a point depends on its slope and the angle of the lamp, from measured paints.

    ln N_j = ln a + s(lamp_j) . slope + t(lamp_j) u

with `a` the albedo of a point in each channel, `slope` the components of its normal along x and y, and `u` a third
factor, which stands for occlusion and gloss. A Lambertian would have s = tan of the lamp's angle: real surfaces
respond less to lamps on the side of the mirror direction, and more to grazing ones on the opposite side, where the
relief casts shadows. `benchmarks/bench_surface.py --learn` fitted the table to workbooks of mineral paints, seen
from 15 degrees. Pictures do not determine the scale of slopes, because glossier paints respond more; `gain` sets it
from the mean BRDF.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.colour.conversion import to_srgb
from manifold.core.defaults import DARKEST
from manifold.core.records import Array
from manifold.surface.lamp_pictures import SurfacePictures

_ANGLES_DEG = np.array([-65.0, -30.0, 0.0, 30.0, 45.0, 60.0])  # positive on the mirror's side
_SLOPE = np.array([-1.74, -0.636, -0.131, 0.519, 0.876, 1.395])
_THIRD = np.array([1.29, -0.651, -0.926, -0.338, 0.22, 1.064])
_NOISE = np.array([0.177, 0.129, 0.095, 0.111, 0.105, 0.138])  # of ln N, standard deviation
_SLOPE_DIFFUSE, _THIRD_DIFFUSE, _NOISE_DIFFUSE = -0.126, -0.495, 0.081
_REFERENCE_NOISE = 0.08  # of ln N, of the noise above in a bright channel
_NODES = 15  # of quadrature, along each component of slope
_GAINS = (0.5, 4.0)  # range of gains, which keeps slopes of a mirror-like completion finite

CODE_NOISE = 0.012
"""Standard deviation of linear values, which stands for 8 bits and the camera."""

SLOPE_STD = 0.13
"""Standard deviation of the paints' slopes, which is the prior of each component."""

THIRD_STD = 0.071
"""Standard deviation of the third factor."""


@dataclass(frozen=True, eq=False)
class Response:
    """The responses of J pictures to slope and to the third factor.

    Attributes:
        factors: derivatives of ln N with respect to slope along x, slope along y, and the third factor, shape (J, 3).
        weights: inverse variance of ln N in each channel, shape (J, 3).
    """

    factors: Array
    weights: Array

    @classmethod
    def of(cls, lamps: Array, means: Array, gain: float = 1.0) -> Response:
        """Return the responses under lamps.

        Args:
            lamps: unit vectors to the lamps, shape (J, 3); NaN for diffuse light. Lamps in the plane of y and z have
                the measured response of their side, lamps in other planes the mean of both sides.
            means: mean linear sRGB of the pictures, shape (J, 3); dark channels are noisier.
            gain: factor of the response to slope.
        """
        is_diffuse = np.isnan(lamps[:, 0])
        x, y, z = np.where(is_diffuse[:, None], [0.0, 0.0, 1.0], lamps).T
        across = np.hypot(x, y)
        angle = np.rad2deg(np.arctan2(across, z))
        share = np.divide(
            -y, across, out=np.ones_like(y), where=across > 0.0
        )  # of the mirror's side: 1, opposite: -1
        slope, third, noise = (
            0.5 * (1.0 + share) * np.interp(angle, _ANGLES_DEG, table)
            + 0.5 * (1.0 - share) * sign * np.interp(-angle, _ANGLES_DEG, table)
            for table, sign in ((_SLOPE, -1.0), (_THIRD, 1.0), (_NOISE, 1.0))
        )
        slope, third, noise = (
            np.where(is_diffuse, diffuse, lit)
            for diffuse, lit in ((0.0, slope), (_THIRD_DIFFUSE, third), (_NOISE_DIFFUSE, noise))
        )
        along_x = np.divide(x, across, out=np.zeros_like(x), where=across > 0.0)
        along_y = np.divide(y, across, out=-np.ones_like(y), where=across > 0.0)
        factors = np.stack([slope * along_x, slope * along_y, third], axis=-1)
        factors[is_diffuse, 1] = -_SLOPE_DIFFUSE
        factors[:, :2] *= gain
        relative = CODE_NOISE / means
        weights = (_REFERENCE_NOISE / noise[:, None]) ** 2 / (_REFERENCE_NOISE**2 + relative**2)
        return cls(factors, weights)

    @classmethod
    def of_pictures(cls, pictures: SurfacePictures, gain: float = 1.0) -> Response:
        """Return the responses of all pictures."""
        return cls.of(pictures.lamps, pictures.values.mean(axis=(1, 2)), gain)


def gain_of(brdf: EvaluableBRDF, pictures: SurfacePictures) -> float:
    """Return the factor, by least squares over the lamps, from the tabulated response to slope to that of a BRDF.

    The response of the BRDF is the mean of d ln N / d slope over the slopes of the paints (Stein's lemma, Gaussian
    quadrature).
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    slope = SLOPE_STD * np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1)
    weights = np.outer(weights, weights) / np.sum(weights) ** 2
    lamps = pictures.lamps[~pictures.is_diffuse]
    logs = [
        np.log(np.maximum(shaded(brdf, slope, lamp, pictures.camera), DARKEST)).mean(axis=-1)
        for lamp in lamps
    ]
    own = np.einsum("ab,jab,abk->jk", weights, logs, slope) / SLOPE_STD**2
    table = Response.of(lamps, np.ones((len(lamps), 3))).factors[:, :2]
    return float(np.clip(np.sum(own * table) / np.sum(table**2), *_GAINS))


def shaded(brdf: EvaluableBRDF, slope: Array, lamp: Array, camera: Array) -> Array:
    """Return the colours of facets under a lamp, linear sRGB (..., 3), where 1 is a white diffuser that lies flat.

    Args:
        brdf: BRDF of the facets, isotropic.
        slope: x and y components of the facets' normals over the z component, shape (..., 2).
        lamp, camera: unit vectors to the lamp and to the camera, shape (3,).
    """
    normal = np.concatenate([slope, np.ones((*slope.shape[:-1], 1))], axis=-1).reshape(-1, 3)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    tangent = np.stack([normal[:, 2], 0.0 * normal[:, 0], -normal[:, 0]], axis=-1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    to_lamp, to_camera = frame @ lamp, frame @ camera
    radiance = np.pi * to_srgb(brdf.eval(to_camera, to_lamp), brdf.bands)
    return np.asarray(radiance * np.maximum(to_lamp[:, 2:], 0.0) / lamp[2]).reshape(*slope.shape[:-1], 3)
