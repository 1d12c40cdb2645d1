"""Fresnel reflectance of smooth interfaces in air: dielectrics, conductors, and a thin film on either.

All functions take the cosine of the angle to the facet's normal, shape (n,), and one index per band,
shape (B,) or (1,) for all, and return the reflectance, shape (n, B), in [0, 1], of unpolarised light
unless they say otherwise.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from manifold.records import Array
from manifold.threads import serialised


def fresnel_dielectric(cos_theta: Array, eta: Array) -> Array:
    """Reflectance of a transparent medium of index (B,) relative to air, at cosines (n,) in [0, 1]; 1 beyond the
    critical angle if eta < 1.
    """
    parallel, perpendicular = _dielectric(cos_theta, eta)
    return 0.5 * (perpendicular + parallel)


def _dielectric(cos_theta: Array, eta: Array) -> tuple[Array, Array]:
    """`fresnel_polarised` of a real index, in NumPy: fits call it for few cosines, many times.
    Source: Born & Wolf, section 1.5.2.
    """
    c = np.clip(np.asarray(cos_theta, float), 0.0, 1.0)[:, None]
    square = np.atleast_1d(np.asarray(eta, float)) ** 2
    inside = (
        square - 1.0 + c * c
    )  # squared, times the index, of the cosine inside; negative where all is reflected
    g, tiny = np.sqrt(np.maximum(inside, 0.0)), np.finfo(float).tiny
    is_all = (inside < 0.0) | (c + g == 0.0)  # the latter: index 1 at grazing
    parallel, perpendicular = (
        np.where(is_all, 1.0, ((x - g) / np.maximum(x + g, tiny)) ** 2) for x in (square * c, c)
    )
    return parallel, perpendicular


def fresnel_conductor(cos_theta: Array, eta: Array, k: Array) -> Array:
    """Reflectance of a medium of index eta + i k relative to air, (B,) or (1,), exact, at cosines (n,) in [0, 1].

    Source: Born & Wolf, Principles of Optics, section 14.2, in the real form of Lagarde 2013, "Memo on Fresnel
    equations".
    """
    parallel, perpendicular = fresnel_polarised(cos_theta, eta, k)
    return 0.5 * (perpendicular + parallel)


def fresnel_polarised(cos_theta: Array, eta: Array, k: Array) -> tuple[Array, Array]:
    """`fresnel_conductor` of light polarised parallel and perpendicular to the plane of incidence, (n, B) each."""
    if not np.any(k):
        return _dielectric(cos_theta, eta)
    eta, k = _same_shape(eta, k)
    parallel, perpendicular = _polarised(np.ascontiguousarray(cos_theta, float), eta, k)
    return parallel, perpendicular


def fresnel_thin_film(
    cos_theta: Array, wavelengths_nm: Array, film_eta: Array, thickness_nm: float, eta: Array, k: Array
) -> Array:
    """Reflectance (n, B) of a transparent film on a base of index eta + i k (B,), all internal reflections summed.
    Cosines (n,) are in [0, 1], wavelengths (B,) in air, the film's index (B,) at least 1; a thickness of 0 is the bare
    base.

    Source: Airy's summation for one film (Born & Wolf, section 7.6), evaluated per band and coherently; Belcour & Barla
    2017, whose spectral integration to RGB is not needed here.
    """
    wavelengths, film, eta, k = _same_shape(wavelengths_nm, film_eta, eta, k)
    phase = 2.0 * np.pi * thickness_nm / wavelengths
    return np.asarray(_thin_film(np.ascontiguousarray(cos_theta, float), phase, film, eta + 1j * k))


def _same_shape(*values: Array) -> list[Array]:
    """Values per band, (B,) or (1,), all as contiguous arrays (B,): the loops below do not broadcast. They are copies:
    a view is read-only, and read-only arrays are another type to compile for.
    """
    return [np.array(a, float, order="C") for a in np.broadcast_arrays(*map(np.atleast_1d, values))]


@serialised
@njit(cache=True, parallel=True)
def _polarised(cos_theta, eta, k):
    parallel = np.empty((cos_theta.size, eta.size))
    perpendicular = np.empty((cos_theta.size, eta.size))
    for i in prange(cos_theta.size):
        c = min(max(cos_theta[i], 0.0), 1.0)
        c2 = c * c
        s2 = 1.0 - c2
        for b in range(eta.size):
            t0 = eta[b] * eta[b] - k[b] * k[b] - s2
            a2b2 = np.sqrt(t0 * t0 + 4.0 * eta[b] * eta[b] * k[b] * k[b])
            t1 = a2b2 + c2
            t2 = 2.0 * c * np.sqrt(max(0.5 * (a2b2 + t0), 0.0))
            if t1 + t2 == 0.0:  # index 1 at grazing: the limit is an interface that is not there
                parallel[i, b] = perpendicular[i, b] = 1.0
                continue
            rs = (t1 - t2) / (t1 + t2)
            t3 = c2 * a2b2 + s2 * s2
            t4 = t2 * s2
            perpendicular[i, b] = rs
            parallel[i, b] = rs * (t3 - t4) / (t3 + t4) if t3 + t4 > 0.0 else rs
    return parallel, perpendicular


@serialised
@njit(cache=True, parallel=True)
def _thin_film(cos_theta, phase, film, base):
    """`phase` is 2 pi thickness / wavelength, (B,); `film` at least 1; `base` the complex index, (B,)."""
    out = np.empty((cos_theta.size, film.size))
    for i in prange(cos_theta.size):
        c0 = min(max(cos_theta[i], 0.0), 1.0)
        s2 = 1.0 - c0 * c0
        for b in range(film.size):
            e1, e2 = film[b] * film[b], base[b] * base[b]
            # q is index times cosine of refraction, with the decaying branch (imaginary part >= 0).
            q1 = np.sqrt(max(e1 - s2, 0.0))
            q2 = np.sqrt(e2 - s2)
            if q2.imag < 0.0:
                q2 = -q2
            turn = complex(np.cos(2.0 * phase[b] * q1), np.sin(2.0 * phase[b] * q1))
            s01 = (c0 - q1) / (c0 + q1) if c0 + q1 > 0.0 else -1.0
            p01 = (e1 * c0 - q1) / (e1 * c0 + q1) if c0 + q1 > 0.0 else -1.0
            s12 = (q1 - q2) / (q1 + q2) * turn
            p12 = (e2 * q1 - e1 * q2) / (e2 * q1 + e1 * q2) * turn
            rs = (s01 + s12) / (1.0 + s01 * s12)
            rp = (p01 + p12) / (1.0 + p01 * p12)
            mean = 0.5 * (rs.real**2 + rs.imag**2 + rp.real**2 + rp.imag**2)
            out[i, b] = min(mean, 1.0)
    return out
