"""MBSDF files against bytes that are laid out here as NVIDIA's MDL SDK reads them."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from manifold.convert.conversion import convert
from manifold.convert.tabulated import DenseBRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError
from manifold.formats import mbsdf, registry, speos
from manifold.formats.dense import DenseTable

HEAD = b'NVIDIA ARC MBSDF V1\nproducer="a lab, \\"north\\""\n'


def block(kind, thetas, phis, value, mark=b"MBSDF_DATA=\n"):
    """A block of data: `value` of the indices of both elevations, of the azimuth, and of the channel."""
    channels = 3 if kind == 1 else 1
    values = [
        value(i, o, p, c)
        for i in range(thetas)
        for o in range(thetas)
        for p in range(phis)
        for c in range(channels)
    ]
    return mark + struct.pack("<3I", kind, thetas, phis) + struct.pack(f"<{len(values)}f", *values)


def numbered(i, o, p, c):
    return 1.0 + 0.01 * (min(i, o) + 3 * max(i, o)) + 0.1 * p + c


@pytest.mark.parametrize("mark", [b"MBSDF_DATA=\n", b"MBSDF_DATA_REFLECTION=\n"])
def test_values_lie_at_the_centres_of_cells_and_mirror_beyond_180_degrees(tmp_path, mark):
    path = tmp_path / "lab.mbsdf"
    path.write_bytes(HEAD + block(1, 3, 4, numbered, mark))
    table = registry.read(path)
    assert registry.identify(path).name == "MBSDF (.mbsdf)"
    assert (table.is_isotropic, table.bands.is_rgb, table.notes) == (True, True, ())
    brdf = DenseBRDF(table)
    for i, o, p in [(0, 2, 3), (1, 1, 0), (2, 0, 2)]:
        wi = from_spherical(np.deg2rad(15.0 + 30.0 * i), 0.7)
        for side in (-1.0, 1.0):
            wo = from_spherical(np.deg2rad(15.0 + 30.0 * o), 0.7 + side * np.deg2rad(22.5 + 45.0 * p))
            np.testing.assert_allclose(brdf.eval(wi, wo), [numbered(i, o, p, c) for c in range(3)], rtol=1e-6)


def test_one_band_is_550_nm_and_transmission_is_left_out(tmp_path):
    path = tmp_path / "grey.mbsdf"
    transmission = block(0, 2, 2, lambda *_: 9.0, b"MBSDF_DATA_TRANSMISSION=\n")
    path.write_bytes(HEAD + block(0, 2, 2, numbered) + transmission)
    table = registry.read(path)
    assert table.bands.wavelengths_nm == (550.0,)
    assert table.values.max() < 9.0
    assert table.notes == ("the transmission is left out",)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (HEAD, "no line MBSDF_DATA_REFLECTION="),
        (HEAD + block(0, 2, 2, numbered, b"MBSDF_DATA_TRANSMISSION=\n"), "transmission alone"),
        (HEAD + block(0, 2, 2, numbered)[:-3], "lacks 3 of 32 bytes"),
        (HEAD + b"MBSDF_DATA=\n\0\0", "before its counts"),
        (HEAD + b"MBSDF_DATA=\n" + struct.pack("<3I", 2, 2, 2), "kind 2 and 2 x 2 angles"),
        (HEAD + block(0, 2, 2, lambda *_: float("nan")), r"the value at \(0, 0, 0, 0\) is not finite"),
    ],
)
def test_a_file_that_is_no_whole_table_is_refused(tmp_path, content, message):
    path = tmp_path / "bad.mbsdf"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=message):
        registry.read(path)


def test_rotations_of_an_anisotropic_sample_are_averaged(tmp_path, monkeypatch):
    monkeypatch.setattr(mbsdf, "SHAPE", (9, 9, 18))  # ten degrees each
    angles = (
        [0.0, 30.0, 60.0, 85.0],
        np.arange(0.0, 360.0, 45.0),
        [0.0, 30.0, 60.0, 89.0],
        np.arange(0.0, 360.0, 15.0),
    )
    axes = tuple(np.deg2rad(a) for a in angles)
    values = np.zeros((*(a.size for a in axes), 1))
    values += 0.2 + 0.1 * np.cos(2.0 * axes[1])[:, None, None, None]
    table = DenseTable("brushed", "x", "incident-outgoing", axes, np.array([550.0]), values)
    speos.write_anisotropic(tmp_path / "brushed.anisotropicbsdf", table)
    made = convert([tmp_path / "brushed.anisotropicbsdf"], tmp_path / "made.mbsdf")
    assert "MBSDF is isotropic: 8 rotations of the sample are averaged" in made.notes
    between = registry.read(tmp_path / "made.mbsdf").values[3:6, :, 3:6]  # 35 to 55 degrees
    np.testing.assert_allclose(between, 0.2, rtol=0.01)
