"""Mitsuba's plugin `measured` as it is loaded: isotropic files are neither turned nor mirrored."""

from __future__ import annotations

import ctypes
import sys
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from helpers.mitsuba_reference import measured

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.render import backend, measured_plugin, thumbnails
from manifold.render.measured_plugin import MOST_INSTANCES, folds, load_bsdf

SIDES = {m.name: m for m in corpus.isotropic_materials()}["syn_iridescent_green"]  # with noise on both sides


@pytest.fixture(scope="module")
def noisy_file(tmp_path_factory):
    """An isotropic file whose two sides of the plane of incidence differ by the noise of the measurement."""
    path = tmp_path_factory.mktemp("noisy") / "noisy_rgb.bsdf"
    write_bsdf(path, corpus.measure(SIDES, rgb=True))
    return path


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_no_instance_of_an_isotropic_file_is_folded(noisy_file, variant):
    if variant not in mi.variants():
        pytest.skip(f"no variant {variant}")
    mi.set_variant(variant)
    content = {"type": "measured", "filename": str(noisy_file)}
    instances = [load_bsdf(mi, content) for _ in range(12)]  # together: their memory is not used again
    assert not any(folds(mi, one) for one in instances)


def test_an_instance_that_folds_azimuths_is_recognised(tmp_path):
    mi.set_variant("scalar_rgb")
    by_name = {m.name: m for m in corpus.anisotropic_materials()}
    path = tmp_path / "brushed_rgb.bsdf"
    write_bsdf(path, corpus.measure(by_name["syn_brushed_gold"], rgb=True))
    assert read_bsdf(path).azimuth_repeats == 2
    assert folds(mi, mi.load_dict({"type": "measured", "filename": str(path)}))


def fill_free_memory(value: int) -> None:
    """Leave a number everywhere in memory that is allocated next."""
    libc = ctypes.CDLL(None)
    libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = (
        ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p],
    )  # fmt: skip
    blocks = []
    for size in range(256, 4096, 16):
        for _ in range(4):
            blocks.append(libc.malloc(size))
            (ctypes.c_int * (size // 4)).from_address(blocks[-1])[:] = [value] * (size // 4)
    for block in blocks:
        libc.free(block)


@pytest.mark.skipif(sys.platform != "linux", reason="fills memory by the C library of Linux")
@pytest.mark.parametrize("repeats", [0, 2, 4])
def test_files_evaluate_as_ours_whatever_the_memory_held(noisy_file, repeats):
    rng = np.random.default_rng(4)
    cos, azimuth = rng.uniform(0.1, 1.0, (2, 200)), rng.uniform(-np.pi, np.pi, (2, 200))
    sin = np.sqrt(1.0 - cos**2)
    wi, wo = np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), cos], axis=-1)
    expected = MeasuredBRDF(read_bsdf(noisy_file)).eval_cos(wi, wo)
    for _ in range(3):
        fill_free_memory(
            repeats
        )  # 4 mirrors directions in the plugin as it is: half of the values are off by 1 %
        np.testing.assert_allclose(measured(noisy_file, wi, wo, None)[0], expected, rtol=1e-3, atol=1e-5)


def test_a_black_file_is_loaded_after_a_limited_number_of_instances(noisy_file, tmp_path, monkeypatch):
    mi.set_variant("scalar_rgb")
    file = read_bsdf(noisy_file)
    path = tmp_path / "black_rgb.bsdf"
    write_bsdf(path, replace(file, spectra=0 * file.spectra))
    tried = []
    monkeypatch.setattr(measured_plugin, "folds", lambda mi, bsdf: tried.append(bsdf) or folds(mi, bsdf))
    assert folds(mi, load_bsdf(mi, {"type": "measured", "filename": str(path)}))
    assert len(tried) == MOST_INSTANCES


def test_balls_of_a_file_are_equal_to_the_last_bit(noisy_file):
    if not backend.choose().is_llvm:
        pytest.skip("needs a libLLVM that Dr.Jit can use")
    before = backend.drjit().thread_count()
    first, *others = (thumbnails.of_file(noisy_file) for _ in range(5))
    assert all(np.array_equal(first, other) for other in others)
    assert backend.drjit().thread_count() == before
