"""Finds the azimuth by which an anisotropic specimen was turned when it was measured, from its normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.core.directions import from_spherical, u_to_phi, u_to_theta
from manifold.core.records import Array, BsdfFile

_LEAST_ANISOTROPY = 0.05  # anisotropy of second moments; weaves, whose two threads cross, are below 0.01
_DIGITS = 1  # decimals of degrees


def aligned(file: BsdfFile) -> BsdfFile:
    """Return the file turned so that its normals spread most along x, or unchanged if no rotation is found."""
    rotation = rotation_of(file)
    return file if rotation is None else replace(file, rotation_rad=rotation)


def rotation_of(file: BsdfFile) -> float | None:
    """Return the azimuth in radians by which the specimen of a file is turned, or None.

    At azimuth 0 the normals spread most along x, so that highlights are wide along x, as `principled` and game
    engines expect along the tangent. The result is above -90 and up to 90 degrees, because the second moments of the
    normals repeat after half a turn; its precision is a tenth of a degree. None means that the file is isotropic, or
    that its normals spread equally in two or all directions.
    """
    if file.is_isotropic:
        return None
    u, v = (np.linspace(0.0, 1.0, n) for n in file.ndf.shape[::-1])
    theta, phi = u_to_theta(u), u_to_phi(v)
    # both ends of the azimuths are one direction
    return _widest((file.ndf * u)[:-1], theta, phi[:-1])


def rotation_of_brdf(brdf: EvaluableBRDF) -> float | None:
    """Return the azimuth in radians along which a BRDF's normals spread most, or None.

    The normals follow from retro-reflection, `4 cos^2 f(w, w)`, up to masking.
    """
    if brdf.is_isotropic:
        return None
    theta, phi = np.deg2rad(np.arange(1.0, 80.0, 2.0)), np.deg2rad(np.arange(0.0, 360.0, 5.0))
    w = from_spherical(*np.meshgrid(theta, phi))
    return _widest(brdf.eval(w, w).mean(axis=-1) * np.cos(theta) ** 2, theta, phi)


def _widest(density: Array, theta: Array, phi: Array) -> float | None:
    """Return the azimuth along which normals of a density (P, T), over steps in theta, spread most."""
    # sin^2 of the polar angle, over projected solid angles
    weight = (density * (np.sin(theta) ** 3 * np.cos(theta))).sum(axis=1)
    moment = np.sum(weight * np.exp(2j * phi)) / max(float(np.sum(weight)), np.finfo(float).tiny)
    if np.abs(moment) < _LEAST_ANISOTROPY:
        return None
    degrees = np.round(np.rad2deg(0.5 * np.angle(moment)), _DIGITS)
    return float(np.deg2rad(90.0 if degrees == -90.0 else degrees))
