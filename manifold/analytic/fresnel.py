"""Fresnel reflectance of smooth interfaces in air: dielectrics, conductors, and thin films on them.

All functions take the cosines of the angle to the facet's normal, shape (n,), and indices of refraction, one per band
(B,) or one for all (1,). They return the reflectance, shape (n, B), in [0, 1], of unpolarised light unless stated
otherwise.
"""

from __future__ import annotations

import numpy as np

from manifold.core.compiled import loops
from manifold.core.records import Array
from manifold.core.threads import share_rows

_FEW = 512  # cosines of a block: fewer take less time than starting a thread


def fresnel_dielectric(cos_theta: Array, eta: Array) -> Array:
    """Return the reflectance of a transparent medium of index (B,) relative to air, at cosines (n,) in [0, 1].

    It is 1 beyond the critical angle if eta < 1.
    """
    parallel, perpendicular = _dielectric(cos_theta, eta)
    return 0.5 * (perpendicular + parallel)


def _dielectric(cos_theta: Array, eta: Array) -> tuple[Array, Array]:
    """Return `fresnel_polarised` of a real index, in NumPy, because fits call it for few cosines, many times.

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
    """Return the reflectance at cosines (n,) of a medium with the relative index eta + i k, each (B,) or (1,).

    Source: Born & Wolf, Principles of Optics, section 14.2, in the real form of Lagarde 2013, "Memo on Fresnel
    equations".
    """
    parallel, perpendicular = fresnel_polarised(cos_theta, eta, k)
    return 0.5 * (perpendicular + parallel)


def fresnel_polarised(cos_theta: Array, eta: Array, k: Array) -> tuple[Array, Array]:
    """Return `fresnel_conductor` for light polarised parallel and perpendicular to the plane of incidence.

    Both have the shape (n, B).
    """
    if not np.any(k):
        return _dielectric(cos_theta, eta)
    eta, k = _same_shape(eta, k)
    parallel, perpendicular = np.empty((2, len(cos_theta), len(eta)))
    share_rows(
        lambda i: loops.reflect_conductor(cos_theta[i], eta, k, parallel[i], perpendicular[i]),
        len(cos_theta),
        _FEW,
    )
    return parallel, perpendicular


def fresnel_thin_film(
    cos_theta: Array, wavelengths_nm: Array, film_eta: Array, thickness_nm: float, eta: Array, k: Array
) -> Array:
    """Return the reflectance (n, B) of a transparent film on a base of index eta + i k (B,).

    All internal reflections are summed. The cosines (n,) are in [0, 1], the wavelengths (B,) refer to air, and the
    film's index (B,) is at least 1; a thickness of 0 gives the bare base.

    Source: Airy's summation for one film (Born & Wolf, section 7.6), evaluated per band and coherently; Belcour &
    Barla 2017, whose spectral integration to RGB is not needed here.
    """
    wavelengths, film, eta, k = _same_shape(wavelengths_nm, film_eta, eta, k)
    phase = 2.0 * np.pi * thickness_nm / wavelengths
    out = np.empty((len(cos_theta), len(eta)))
    share_rows(lambda i: loops.reflect_film(cos_theta[i], phase, film, eta, k, out[i]), len(cos_theta), _FEW)
    return out


def _same_shape(*values: Array) -> list[Array]:
    """Return values per band, (B,) or (1,), as contiguous arrays (B,)."""
    return [np.ascontiguousarray(a, float) for a in np.broadcast_arrays(*map(np.atleast_1d, values))]
