"""Thin films of exports: against Airy's formula wavelength by wavelength, and where they have to vanish."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from manifold.brdf.synthetic.fresnel import fresnel_conductor
from manifold.colour.conversion import xyz_to_srgb
from manifold.fitting.exports import lobes
from manifold.fitting.exports.thin_film import (
    _FROM_XYZ_MATERIALX,
    film_over_f0,
    film_over_f82,
    film_over_index,
    film_over_index_cycles,
)

COSINES = np.linspace(0.2, 1.0, 9)
WAVELENGTHS_NM = np.arange(380.0, 781.0, 2.0)
METAL_N, METAL_K = np.array([0.2, 0.9, 1.3]), np.array([3.9, 2.5, 1.9])


def airy(ior, thickness_nm, base, cosine):
    """Reflectance of a film of index `ior` on a complex index, (P, W)."""
    c1 = cosine[:, None]
    c2 = np.sqrt(1.0 - (1.0 - c1**2) / ior**2)
    c3 = np.sqrt(1.0 - (1.0 - c1**2) / base**2 + 0j)
    turn = np.exp(1j * 4.0 * np.pi * ior * thickness_nm * c2 / WAVELENGTHS_NM)
    found = []
    for outer, inner in (
        ((c1 - ior * c2) / (c1 + ior * c2), (ior * c2 - base * c3) / (ior * c2 + base * c3)),
        ((ior * c1 - c2) / (ior * c1 + c2), (base * c2 - ior * c3) / (base * c2 + ior * c3)),
    ):
        found.append(np.abs((outer + inner * turn) / (1.0 + outer * inner * turn)) ** 2)
    return 0.5 * (found[0] + found[1])


def reference(ior, thickness_nm, n, k, cosine):
    """The same in the RGB of MaterialX, (P, 3): every channel by the index that it has."""
    matching = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    weight = np.stack(
        [np.interp(WAVELENGTHS_NM, matching.wavelengths, matching.values[:, i]) for i in range(3)]
    )
    weight /= weight.sum(axis=1, keepdims=True)  # illuminant E
    # The model takes an index per XYZ channel.
    xyz = [airy(ior, thickness_nm, n[i] + 1j * k[i], cosine) @ weight[i] for i in range(3)]
    return np.stack(xyz, axis=1) @ _FROM_XYZ_MATERIALX.T


@pytest.mark.parametrize("thickness_nm", [100.0, 250.0, 400.0, 700.0])
@pytest.mark.parametrize(("n", "k", "most"), [(1.5, 0.0, 0.03), (1.2, 2.0, 0.05)], ids=["glass", "metal"])
def test_a_film_reflects_what_airy_s_formula_gives(n, k, most, thickness_nm):
    # Two orders of interference, of which a metal needs more, and Gaussians for the observer.
    n, k = np.full(3, n), np.full(3, k)
    found = film_over_index(1.8, thickness_nm, n, k, COSINES)
    expected = np.clip(reference(1.8, thickness_nm, n, k, COSINES), 0.0, 1.0)
    np.testing.assert_allclose(found, expected, atol=most)


def test_cycles_film_is_airy_s_formula_with_the_observer(rng):
    # Three orders of interference: what is left is less than that of two.
    index = 1.5
    matching = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    weight = np.stack(
        [np.interp(WAVELENGTHS_NM, matching.wavelengths, matching.values[:, i]) for i in range(3)], axis=1
    )
    rgb = xyz_to_srgb(weight)
    for thickness_nm in (100.0, 250.0, 400.0, 700.0):
        expected = airy(1.8, thickness_nm, index, COSINES) @ (rgb / rgb.sum(axis=0))
        found = film_over_index_cycles(1.8, thickness_nm, index, COSINES)
        np.testing.assert_allclose(found, np.clip(expected, 0.0, 1.0), atol=0.01)


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
    found = film_over_index(1.0, 400.0, METAL_N, METAL_K, COSINES)
    np.testing.assert_allclose(found, fresnel_conductor(COSINES, METAL_N, METAL_K), atol=1e-9)
    f0 = np.array([0.04, 0.3, 0.9])
    np.testing.assert_allclose(film_over_f0(1.0, 400.0, f0, np.ones(1))[0], f0, atol=0.01)


def test_a_film_reflects_no_more_than_there_is(rng):
    for _ in range(50):
        ior, thickness_nm, f0 = rng.uniform(1.0, 2.5), rng.uniform(50.0, 1200.0), rng.uniform(0.0, 1.0, 3)
        n, k = rng.uniform(0.1, 3.0, 3), rng.uniform(0.0, 4.0, 3)
        exact = film_over_index(ior, thickness_nm, n, k, COSINES)
        assert exact.min() >= 0.0
        assert exact.max() <= 1.0
        assert film_over_f0(ior, thickness_nm, f0, COSINES).min() >= 0.0
