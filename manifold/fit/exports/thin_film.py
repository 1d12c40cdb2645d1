"""Computes the reflectance of a thin film on a surface in linear sRGB, integrated over wavelengths in Fourier space.

Source: Belcour & Barla 2017, section 4, as implemented in KHR_materials_iridescence, MaterialX 1.39 and Cycles 5.0.
The first two use two orders of interference and Gaussians as colour matching functions; Cycles uses three orders and
the true functions. MaterialX uses the reflectances of red, green and blue for X, Y and Z, and converts the sum.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, TypeVar, cast

import numpy as np

from manifold.analytic.fresnel import fresnel_polarised
from manifold.colour.conversion import SRGB_TO_XYZ, sensor_responses, xyz_to_srgb
from manifold.colour.illuminants import Illuminant
from manifold.core.records import Array
from manifold.fit.exports.lobes import artistic_index, cubic, fresnel_f82, schlick

Reflectance = TypeVar("Reflectance", bound=Callable[..., Array])
Sensitivity = Callable[[Array, Array], Array]
"""A function of path differences in nm (P,) and phase shifts, (3,) or (P, 3), that returns mean RGB or XYZ (P, 3)."""

_HEIGHT = np.array([5.4856e-13, 4.4201e-13, 5.2481e-13, 9.7470e-14])  # of Gaussians for X, Y, Z, and X again
_WAVE_NUMBER = np.array([1.6810e6, 1.7953e6, 2.2084e6, 2.2399e6])  # 1/m
_VARIANCE = np.array([4.3278e9, 9.3046e9, 6.6121e9, 4.5282e9])
_NORM = 1.0685e-7
# glTF's, of D65; and MaterialX's, of CIE 1931 RGB and illuminant E
_FROM_XYZ_GLTF = np.linalg.inv(SRGB_TO_XYZ)
_FROM_XYZ_MATERIALX = np.array(
    [
        [2.3706743, -0.9000405, -0.4706338],
        [-0.5138850, 1.4253036, 0.0885814],
        [0.0052982, -0.0146949, 1.0093968],
    ]
)


_NODES = 257  # of tables by the cosine


def _tabulated(reflectance: Reflectance) -> Reflectance:
    """Interpolate a function in the cosine, its last argument, by cubics between nodes.

    It is off by a few 1e-6 in the mean, and by 1e-3 where values are clipped. Splines of SciPy take as long as films.
    """

    @wraps(reflectance)
    def interpolated(*arguments: Any) -> Array:
        *film, cosine = arguments
        if len(cosine) <= 2 * _NODES:
            return reflectance(*film, cosine)
        table = reflectance(*film, np.linspace(0.0, 1.0, _NODES))
        first, weights = cubic(cosine * (_NODES - 1), _NODES)
        return np.asarray(sum(weight[:, None] * table[first + k] for k, weight in enumerate(weights)))

    return cast(Reflectance, interpolated)


@_tabulated
def film_over_f0(ior: float, thickness_nm: float, f0: Array, cosine: Array) -> Array:
    """Return the reflectance (P, 3) of a film on a surface that reflects `f0` at normal incidence.

    Args:
        ior: refractive index of the film, at least 1; the outside has 1.
        thickness_nm: thickness of the film.
        f0: reflectance of the surface without the film, shape (3,).
        cosine: cosine of the angle of incidence, shape (P,).
    Source: KHR_materials_iridescence: Schlick's term at both interfaces, no polarisation.
    """
    root = np.sqrt(np.clip(f0, 0.0, 0.9999))
    below = (1.0 + root) / (1.0 - root)
    inside = _refracted(cosine, ior)
    first = schlick(((ior - 1.0) / (ior + 1.0)) ** 2, 1.0, cosine)
    second = schlick(((below - ior) / (below + ior)) ** 2, 1.0, inside)
    shift = np.pi + np.where(below < ior, np.pi, 0.0)
    path_nm = 2.0 * ior * thickness_nm * inside
    product = np.clip(first * second, 1e-5, 0.9999)
    return np.maximum(_interference(first, second, product, path_nm, shift, _gltf), 0.0)


@_tabulated
def film_over_index(ior: float, thickness_nm: float, n: Array, k: Array, cosine: Array) -> Array:
    """Return the reflectance of a film on a surface of indices n + i k (3,), shape (P, 3), in [0, 1].

    Args:
        ior, thickness_nm, cosine: as in `film_over_f0`.
        n, k: indices of the surface, relative to the outside, shape (3,).
    Source: MaterialX 1.39, mx_fresnel_airy: Fresnel's equations and phases of both polarisations.
    """
    inside = _refracted(cosine, ior)
    below, phases = fresnel_polarised(inside, n / ior, k / ior), _phases(inside, ior, n, k)
    return _from_xyz(_airy(ior, thickness_nm, below, phases, cosine, _xyz))


@_tabulated
def film_over_f82_materialx(ior: float, thickness_nm: float, f0: Array, edge: Array, cosine: Array) -> Array:
    """Return the reflectance of a film on a metal of F82-tint, shape (P, 3), in [0, 1].

    Args:
        ior, thickness_nm, cosine: as in `film_over_f0`.
        f0, edge: F82-tint colours of the metal without the film, shape (3,).
    Source: MaterialX 1.39, mx_fresnel_airy, which assigns half of the metal's reflectance to each polarisation.
    """
    inside = _refracted(cosine, ior)
    below = 0.5 * fresnel_f82(f0, edge, inside)
    root = np.sqrt(np.clip(f0, 0.01, 0.99))
    phase = np.where((1.0 + root) / (1.0 - root) < ior, np.pi, 0.0)
    return _from_xyz(_airy(ior, thickness_nm, (below, below), (phase, phase), cosine, _xyz))


@_tabulated
def film_at_wavelengths(
    wavelengths_nm: tuple[float, ...], outside: float, ior: float, thickness_nm: float, n: Array, k: Array,
    cosine: Array,
) -> Array:  # fmt: skip
    """Return the reflectance of a film at single wavelengths, shape (P, B), in [0, 1].

    Args:
        wavelengths_nm: B wavelengths.
        outside: index of the medium above the film; beyond the critical angle, all light is reflected.
        ior, thickness_nm, cosine: as in `film_over_f0`.
        n, k: indices of the surface, shape (B,).
    Source: Born & Wolf, section 7.6, both polarisations, all orders; OpenPBR 1.1, "Thin-film iridescence", which
    takes indices of metals by Gulbrandsen 2014.
    """
    across = (outside * np.sqrt(1.0 - cosine**2))[:, None]  # index times sine, the same in all media
    above, film = np.maximum(outside * cosine, 1e-9)[:, None], np.emath.sqrt(ior**2 - across**2)
    below = np.sqrt(
        (n + 1j * k) ** 2 - across**2
    )  # the index times the cosine; it decays, as numpy's root has it
    turn = np.exp(4j * np.pi * film * thickness_nm / np.asarray(wavelengths_nm))
    total = np.zeros((len(cosine), len(n)))
    for power in (
        0.0,
        2.0,
    ):  # perpendicular: index times cosine, and parallel: that over the square of the index
        a, b, c = above / outside**power, film / ior**power, below / (n + 1j * k) ** power
        first, second = (a - b) / (a + b), (b - c) / (b + c)
        total += 0.5 * np.abs((first + second * turn) / (1.0 + first * second * turn)) ** 2
    return np.where(across >= ior, 1.0, np.clip(total, 0.0, 1.0))


@_tabulated
def film_over_index_cycles(ior: float, thickness_nm: float, n: float, cosine: Array) -> Array:
    """Return the reflectance of a film on a dielectric of index n, shape (P, 3), in [0, 1].

    Args:
        ior, thickness_nm, cosine: as in `film_over_f0`.
        n: index of the dielectric, relative to the outside.
    Source: Cycles 5.0, bsdf_util.h.
    """
    index, none = np.full(3, n), np.zeros(3)
    inside = _refracted(cosine, ior)
    below, phases = fresnel_polarised(inside, index / ior, none), _phases(inside, ior, index, none)
    return np.clip(_airy(ior, thickness_nm, below, phases, cosine, _cycles, orders=3), 0.0, 1.0)


@_tabulated
def film_over_f82(ior: float, thickness_nm: float, f0: Array, edge: Array, cosine: Array) -> Array:
    """Return the reflectance of a film on a metal of F82-tint, shape (P, 3), in [0, 1].

    Args:
        ior, thickness_nm, cosine: as in `film_over_f0`.
        f0, edge: F82-tint colours of the metal without the film, shape (3,).
    Source: Cycles 5.0: the reflectance of the metal below the film by F82, the phases by indices (Gulbrandsen 2014).
    """
    at = np.full(1, 1.0 / 7.0)
    g = np.clip(fresnel_f82(f0, edge, at)[0], 0.0, 1.0)
    n, k = artistic_index(f0, g, most=0.999)
    inner = ((n - ior) ** 2 + k**2) / ((n + ior) ** 2 + k**2)
    inside = _refracted(cosine, ior)
    below = np.clip(fresnel_f82(inner, g / schlick(inner, 1.0, at)[0], inside), 0.0, 1.0)
    phases = _phases(inside, ior, n, k)
    return np.clip(_airy(ior, thickness_nm, (below, below), phases, cosine, _cycles, orders=3), 0.0, 1.0)


def _airy(
    ior: float, thickness_nm: float, below: tuple[Array, Array], phases: tuple[Array, Array], cosine: Array,
    sensitivity: Sensitivity, orders: int = 2,
) -> Array:  # fmt: skip
    """Return the mean of both polarisations, (P, 3), from reflectances and phases `below` the film."""
    path_nm = 2.0 * ior * thickness_nm * _refracted(cosine, ior)
    outer = (np.where(cosine < np.cos(np.arctan(ior)), 0.0, np.pi), np.full(len(cosine), np.pi))
    above = fresnel_polarised(cosine, np.array([ior]), np.zeros(1))
    total = sum(
        _interference(
            first, second, np.clip(first * second, 0.0, 1.0 - 1e-9), path_nm, inner + shift[:, None],
            sensitivity, orders,
        )
        for first, second, inner, shift in zip(above, below, phases, outer, strict=True)
    )  # fmt: skip
    return np.asarray(0.5 * total)


def _refracted(cosine: Array, ior: float) -> Array:
    """Return the cosine of the angle inside the film, (P,)."""
    return np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)


def _interference(
    first: Array, second: Array, product: Array, path_nm: Array, shift: Array, sensitivity: Sensitivity,
    orders: int = 2,
) -> Array:  # fmt: skip
    """Return the reflectance (P, 3) of two interfaces.

    Args:
        first, second, product: reflectances (P, 1) and (P, 3), and their product.
        path_nm: difference of path, shape (P,).
        shift: of the phase, shape (3,) or (P, 3).
        sensitivity: of the colour space.
        orders: of interference.
    """
    passed = 1.0 - first
    inner = passed**2 * second / (1.0 - product)
    total, term = first + inner, inner - passed
    for order in range(1, orders + 1):
        term = term * np.sqrt(product)
        total = total + 2.0 * term * sensitivity(order * path_nm, order * shift)
    return total


def _gltf(path_nm: Array, shift: Array) -> Array:
    return _xyz(path_nm, shift) @ _FROM_XYZ_GLTF.T


def _from_xyz(xyz: Array) -> Array:
    """Return MaterialX's RGB of reflectances (P, 3)."""
    return np.clip(xyz @ _FROM_XYZ_MATERIALX.T, 0.0, 1.0)


def _xyz(path_nm: Array, shift: Array) -> Array:
    phase = 2e-9 * np.pi * path_nm[:, None]
    shifts = np.concatenate([shift, shift[..., :1]], axis=-1)
    waves: Array = _HEIGHT * np.sqrt(2.0 * np.pi * _VARIANCE) * np.cos(_WAVE_NUMBER * phase + shifts)
    waves = waves * np.exp(-_VARIANCE * phase**2) / _NORM
    waves[:, 0] += waves[:, 3]
    return waves[:, :3]


def _cycles(path_nm: Array, shift: Array) -> Array:
    nodes, response = _observer_table()
    at = np.stack([np.interp(path_nm, nodes, channel) for channel in response], axis=1)
    return np.real(at * np.exp(1j * shift))


@lru_cache(maxsize=1)
def _observer_table() -> tuple[Array, Array]:
    """Return the mean of `exp(2 pi i path / wavelength)` over the channels of linear sRGB, (3, K).

    Also return the paths in nm (K,).
    """
    wavelengths, responses = sensor_responses(Illuminant.named("E"))
    weight = xyz_to_srgb(responses)
    step = 60000.0 / (2.0 * np.pi * 511.0)  # of Cycles, which interpolates between these nodes
    nodes = np.arange(0.0, 20000.0, step)
    waves = np.exp(2j * np.pi * nodes[:, None] / wavelengths)
    return nodes, ((waves @ weight) / weight.sum(axis=0)).T


def _phases(cosine: Array, outside: float, n: Array, k: Array) -> tuple[Array, Array]:
    """Return the phases of reflection at an interface to n + i k (3,), parallel and perpendicular, (P, 3) each."""
    c = cosine[:, None]
    ratio = k / n
    a = n * n * (1.0 - ratio * ratio) - outside**2 * (1.0 - c * c)
    b = np.sqrt(a * a + (2.0 * n * n * ratio) ** 2)
    u, v = np.sqrt((a + b) / 2.0), np.sqrt(np.maximum((b - a) / 2.0, 0.0))
    perpendicular = np.arctan2(2.0 * outside * v * c, u * u + v * v - (outside * c) ** 2)
    parallel = np.arctan2(
        2.0 * outside * n * n * c * (2.0 * ratio * u - (1.0 - ratio * ratio) * v),
        (n * n * (1.0 + ratio * ratio) * c) ** 2 - outside**2 * (u * u + v * v),
    )
    return parallel, perpendicular
