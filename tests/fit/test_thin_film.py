"""Thin films of exports: against Airy's formula wavelength by wavelength, and where they have to vanish."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from manifold.analytic.fresnel import fresnel_conductor, fresnel_thin_film
from manifold.colour.conversion import xyz_to_srgb
from manifold.fit.exports import lobes
from manifold.fit.exports.thin_film import (
    _FROM_XYZ_MATERIALX,
    film_over_f0,
    film_over_f82,
    film_over_index,
    film_over_index_cycles,
)

COSINES = np.linspace(0.2, 1.0, 9)
WAVELENGTHS_NM = np.arange(380.0, 781.0, 2.0)
METAL_N, METAL_K = np.array([0.2, 0.9, 1.3]), np.array([3.9, 2.5, 1.9])


def exact(ior, thickness_nm, n, k):
    """Reflectance of a film on the index n + i k wavelength by wavelength, (P, W)."""
    return fresnel_thin_film(
        COSINES, WAVELENGTHS_NM, np.array([ior]), thickness_nm, np.array([n]), np.array([k])
    )


def matching():
    """The observer's functions, whose sums are 1, (W, 3)."""
    functions = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    weight = np.stack(
        [np.interp(WAVELENGTHS_NM, functions.wavelengths, v) for v in functions.values.T], axis=1
    )
    return weight / weight.sum(axis=0)  # illuminant E


@pytest.mark.parametrize("thickness_nm", [100.0, 250.0, 400.0, 700.0])
@pytest.mark.parametrize(("n", "k", "most"), [(1.5, 0.0, 0.03), (1.2, 2.0, 0.05)], ids=["glass", "metal"])
def test_a_film_reflects_what_airy_s_formula_gives(n, k, most, thickness_nm):
    # Two orders of interference, of which a metal needs more, and Gaussians for the observer.
    found = film_over_index(1.8, thickness_nm, np.full(3, n), np.full(3, k), COSINES)
    expected = exact(1.8, thickness_nm, n, k) @ matching() @ _FROM_XYZ_MATERIALX.T
    np.testing.assert_allclose(found, np.clip(expected, 0.0, 1.0), atol=most)


def test_cycles_film_is_airy_s_formula_with_the_observer(rng):
    # Three orders of interference: what is left is less than that of two.
    rgb = xyz_to_srgb(matching())
    for _ in range(20):
        ior, thickness_nm, n = rng.uniform(1.0, 2.0), rng.uniform(50.0, 1200.0), rng.uniform(1.3, 2.0)
        expected = exact(ior, thickness_nm, n, 0.0) @ (rgb / rgb.sum(axis=0))
        found = film_over_index_cycles(ior, thickness_nm, n, COSINES)
        np.testing.assert_allclose(found, np.clip(expected, 0.0, 1.0), atol=0.01)


def test_materialx_takes_a_coloured_metal_below_a_film_for_x_y_and_z():
    found = film_over_index(1.0, 400.0, METAL_N, METAL_K, COSINES)
    bare = fresnel_conductor(COSINES, METAL_N, METAL_K)
    np.testing.assert_allclose(found, np.clip(bare @ _FROM_XYZ_MATERIALX.T, 0.0, 1.0), atol=1e-9)


def test_a_film_of_the_index_of_air_leaves_cycles_metal():
    f0, edge = np.array([0.9, 0.6, 0.3]), np.array([0.8, 0.9, 1.0])
    found = film_over_f82(1.0, 400.0, f0, edge, COSINES)
    np.testing.assert_allclose(found, lobes.fresnel_f82(f0, edge, COSINES), atol=1e-6)


def test_schlick_s_form_is_near_fresnel_s_on_a_dielectric():
    f0 = np.full(3, (0.5 / 2.5) ** 2)
    found = film_over_f0(1.8, 300.0, f0, COSINES)
    exact = film_over_index(1.8, 300.0, np.full(3, 1.5), np.zeros(3), COSINES)
    np.testing.assert_allclose(
        found[COSINES > 0.5], exact[COSINES > 0.5], atol=0.04
    )  # two RGB spaces as well


def test_a_film_of_the_index_of_air_is_none():
    n, k = np.full(3, METAL_N[0]), np.full(3, METAL_K[0])
    found = film_over_index(1.0, 400.0, n, k, COSINES)
    np.testing.assert_allclose(found, fresnel_conductor(COSINES, n, k), atol=1e-7)  # of its matrix
    f0 = np.array([0.04, 0.3, 0.9])
    np.testing.assert_allclose(film_over_f0(1.0, 400.0, f0, np.ones(1))[0], f0, atol=0.01)


def test_many_cosines_are_interpolated_to_what_each_gives(rng):
    cosines = rng.uniform(0.0, 1.0, 1000)
    f0, edge = np.array([0.9, 0.6, 0.3]), np.array([0.8, 0.9, 1.0])
    for film in (film_over_f0, film_over_f82, film_over_index, film_over_index_cycles):
        below = {film_over_f0: (f0,), film_over_index_cycles: (1.5,)}.get(film, (f0, edge))
        exact = film.__wrapped__(1.6, 700.0, *below, cosines)
        off = np.abs(film(1.6, 700.0, *below, cosines) - exact)
        assert off.mean() < 1e-5
        assert off.max() < 2e-3  # beside values that are clipped
