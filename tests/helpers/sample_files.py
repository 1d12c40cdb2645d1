"""Small RGL files with random content, quick to write and to read."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from manifold.core.records import Array, BsdfFile
from manifold.io_rgl import write_bsdf

WAVELENGTHS_NM = np.linspace(358.63, 1001.89, 70, dtype=np.float32)  # 70 bands: two chunks


def sample_file(
    name: str,
    seed: int = 0,
    *,
    wavelengths_nm: Array | None = WAVELENGTHS_NM,
    azimuths: int = 1,
    size: int = 4,
) -> BsdfFile:
    """A valid file of 3 incident elevations; without wavelengths it is an RGB file.

    Args:
        name: of the material.
        seed: two files with different seeds differ.
        wavelengths_nm: shape (B,).
        azimuths: P.
        size: H and W.
    """
    rng = np.random.default_rng(seed)
    bands = 3 if wavelengths_nm is None else len(wavelengths_nm)

    def positive(*shape: int) -> Array:
        return rng.random(shape, dtype=np.float32) + np.float32(0.1)

    rows = 2 if azimuths <= 2 else 8
    spectra = positive(azimuths, 3, bands, size, size)
    spectra[..., 0, 0] = 0  # unmeasured cells
    return BsdfFile(
        name=name,
        description=f"synthetic sample {seed}: naïve",
        version=(1, 0) if wavelengths_nm is None else (3, 1),
        phi_i_rad=np.linspace(-np.pi, np.pi, azimuths, dtype=np.float32)
        if azimuths > 1
        else np.zeros(1, np.float32),
        theta_i_rad=np.array([0, 0.7, np.pi / 2], np.float32),
        wavelengths_nm=wavelengths_nm,
        sigma=positive(rows, 8),
        ndf=positive(rows, 16),
        vndf=positive(azimuths, 3, 6, 6),
        luminance=positive(azimuths, 3, size, size),
        spectra=spectra,
        jacobian=True,
        valid=rng.integers(0, 256, -(-azimuths * 3 * size * size // 8), dtype=np.uint8),
        extra={"note": np.arange(5, dtype=np.int16), "path/../odd": np.array([[2.5]])},
    )


def write_samples(folder: Path, count: int, **options: object) -> list[Path]:
    """Write samples `m00_spec.bsdf`, `m01_spec.bsdf`, ... (or `_rgb`), and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for seed in range(count):
        file = sample_file(f"m{seed:02d}", seed, **options)  # type: ignore[arg-type]
        paths.append(folder / f"{file.name}_{'rgb' if file.wavelengths_nm is None else 'spec'}.bsdf")
        write_bsdf(paths[-1], file)
    return paths


def assert_same(found: BsdfFile, expected: BsdfFile) -> None:
    """Every field equal: arrays in dtype, shape and bytes."""
    for field in dataclasses.fields(BsdfFile):
        left, right = getattr(found, field.name), getattr(expected, field.name)
        if field.name == "extra":
            assert list(left) == list(right)
            for key in left:
                assert_same_array(left[key], right[key], f"extra {key}")
        elif isinstance(right, np.ndarray):
            assert_same_array(left, right, field.name)
        else:
            assert left == right, field.name


def assert_same_array(found: Array, expected: Array, what: str) -> None:
    """Equal in dtype, shape and bytes."""
    assert found.dtype == expected.dtype, what
    assert found.shape == expected.shape, what
    assert found.tobytes() == expected.tobytes(), what
