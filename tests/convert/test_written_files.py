"""What `convert` writes of an RGL file, by readers of this test's own: values node by node, horizon included, and sums.

Each reader knows its format by the format's own description, and nothing of the package's readers.
"""

from __future__ import annotations

import csv
import json
import re
import struct
from typing import NamedTuple

import numpy as np
import pytest

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import luminance, to_srgb
from manifold.colour.narrow_bands import SPECTRUM, estimate_spectra
from manifold.convert.conversion import convert
from manifold.core.records import Bands
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.registries import CONVERTED

BANDS = Bands((450.0, 520.0, 590.0, 650.0))
XYZ_OF_SRGB = np.array(  # IEC 61966-2-1
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
LOWEST_DEG = 88.0  # of a direction of which an RGL file says f


class Written(NamedTuple):
    """A table as it stands in a file: angles in degrees about the normal, and what a file says that it reflects.

    `wi`, `wo` (P, 3); `values` (P, B) in `kind`; `sums` are (wi, fraction of light said, band).
    """

    kind: str
    wi: np.ndarray
    wo: np.ndarray
    values: np.ndarray
    sums: tuple[tuple[float, float, int], ...] = ()


def spherical(theta_deg, phi_deg):
    theta, phi = np.broadcast_arrays(np.deg2rad(theta_deg), np.deg2rad(phi_deg))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def numbers(line):
    return np.array([float(word) for word in line.split()])


def read_zemax(path):
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    found = {
        line.split()[0]: numbers(lines[k + 1])
        for k, line in enumerate(lines)
        if re.match("Scatter(A|R)|Angle", line)
    }
    azimuth, radial, incidences = (
        np.deg2rad(found[key]) for key in ("ScatterAzimuth", "ScatterRadial", "AngleOfIncidence")
    )
    at = [k for k, line in enumerate(lines) if line.startswith("TIS")]
    tables = np.array([[numbers(row) for row in lines[k + 1 : k + 1 + azimuth.size]] for k in at])
    values = np.moveaxis(tables.reshape(3, incidences.size, -1), 0, -1)
    wi, wo = [], []
    for theta in incidences:
        mirror, across = np.array([np.sin(theta), 0.0, np.cos(theta)]), np.array([0.0, 1.0, 0.0])
        to_normal = np.array([-np.cos(theta), 0.0, np.sin(theta)])
        a, r = (angle[..., None] for angle in np.meshgrid(azimuth, radial, indexing="ij"))
        wo.append(np.cos(r) * mirror + np.sin(r) * (np.cos(a) * to_normal + np.sin(a) * across))
        wi.append(np.broadcast_to([-np.sin(theta), 0.0, np.cos(theta)], wo[-1].shape))
    said = [float(lines[k].split()[1]) for k in at]
    sums = [
        (np.rad2deg(t), s, b)
        for (b, t), s in zip(((b, t) for b in range(3) for t in incidences), said, strict=True)
    ]
    return Written(
        "XYZ", np.reshape(wi, (-1, 3)), np.reshape(wo, (-1, 3)), values.reshape(-1, 3), tuple(sums)
    )


def read_lighttools(path):
    """Monochrome blocks; the light comes from azimuth 90."""
    lines = path.read_text().splitlines()
    found = {
        line.split()[0]: numbers(lines[k + 1])
        for k, line in enumerate(lines)
        if re.match("Scatter(A|R)", line)
    }
    azimuth, radial = found["ScatterAzimuth"], found["ScatterRadial"]
    blocks, sums, said = {}, [], {}
    for k, line in enumerate(lines):
        key, _, value = line.partition(" ")
        said[key] = value
        if key == "TIS":
            theta, band = float(said["AOI"]), BANDS.wavelengths_nm.index(float(said["Wavelength"]))
            blocks[theta, band] = np.array([numbers(row) for row in lines[k + 1 : k + 1 + azimuth.size]])
            sums.append((theta, float(value), band))
    incidences = sorted({theta for theta, _ in blocks})
    wo = spherical(radial, azimuth[:, None]).reshape(-1, 3)
    values = [np.stack([blocks[t, b].reshape(-1) for b in range(4)], axis=-1) for t in incidences]
    wi = np.repeat(spherical(incidences, 90.0), len(wo), axis=0)
    return Written("spectral", wi, np.tile(wo, (len(incidences), 1)), np.concatenate(values), tuple(sums))


def read_fred(path):
    """Incidences name the mirror direction at azimuth 0, so that the light comes from 180."""
    rows, theta = [], None
    for line in path.read_text().splitlines()[2:]:
        cells = numbers(line)
        if cells.size == 2:
            theta = cells[0]
        else:
            rows.append([theta, *cells])
    theta_i, theta_o, phi_o, f = np.array(rows).T
    return Written("luminance", spherical(theta_i, 180.0), spherical(theta_o, phi_o), f[:, None])


def speos_table(words):
    n_theta, n_phi = int(next(words)), int(next(words))
    phi = np.array([float(next(words)) for _ in range(n_phi)])
    rows = np.array([[float(next(words)) for _ in range(n_phi + 1)] for _ in range(n_theta)])
    return spherical(rows[:, :1], phi).reshape(-1, 3), rows[:, 1:].reshape(-1)


def read_speos(path):
    """Light comes from azimuth 180; values are as they stand, with percentages beside them."""
    lines = path.read_text().splitlines()
    assert lines[5:7] == ["1\t0", "1"]  # reflection only, values of a BSDF
    words = iter(" ".join(lines[7:-1]).split())
    n_theta, n_nm = int(next(words)), int(next(words))
    incidences = [float(next(words)) for _ in range(n_theta)]
    assert [float(next(words)) for _ in range(n_nm)] == list(BANDS.wavelengths_nm)
    wi, wo, values, sums = [], [], [], []
    for theta in incidences:
        columns = []
        for band in range(n_nm):
            sums.append((theta, float(next(words)) / 100.0, band))
            out, f = speos_table(words)
            columns.append(f)
        wi.append(np.broadcast_to(spherical(theta, 180.0), out.shape))
        wo.append(out)
        values.append(np.stack(columns, axis=-1))
    return Written("spectral", *map(np.concatenate, (wi, wo, values)), tuple(sums))


def read_speos_anisotropic(path):
    """One anisotropy angle; the percentage is that of the first incidence."""
    lines = path.read_text().splitlines()
    assert lines[5:10] == ["1\t0\t0", "1\t0", "1", "1", "0"]  # reflection only, a BSDF, one angle
    incidences = numbers(lines[11])
    at, title, _, *rest = lines[12:-1]
    assert title == "Reflection"
    words = iter(" ".join(rest).split())
    (_, first), (_, last) = ((next(words), float(next(words))) for _ in range(2))
    assert first == last
    tables = [speos_table(words) for _ in incidences]
    wi = np.concatenate(
        [np.broadcast_to(spherical(t, 180.0), w.shape) for t, (w, _) in zip(incidences, tables, strict=True)]
    )
    wo, f = (np.concatenate(arrays) for arrays in zip(*tables, strict=True))
    return Written("luminance", wi, wo, f[:, None], ((numbers(at)[0], first / 100.0, 0),))


def read_openmaterial(path):
    """Rows of wavelength in metres and radians; the mirror direction lies at pi from the light."""
    rows = np.array(json.loads(path.read_text())["brdf"]["lookupTable"])
    bands = [rows[np.isclose(1e9 * rows[:, 0], nm)] for nm in BANDS.wavelengths_nm]
    _, theta_i, theta_o, phi_o, _ = bands[0].T
    assert all(np.array_equal(band[:, 1:4], bands[0][:, 1:4]) for band in bands)
    angles = np.rad2deg([theta_i, theta_o, phi_o])
    values = np.stack([band[:, 4] for band in bands], axis=-1)
    return Written("spectral", spherical(angles[0], 0.0), spherical(angles[1], angles[2]), values)


def read_astm(path):
    lines = path.read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("VARS"))
    assert lines[start] == "VARS theta_i,phi_i,theta_s,phi_s,450nm,520nm,590nm,650nm"
    table = np.loadtxt(lines[start + 1 :], delimiter=",")
    angles = np.rad2deg(table[:, :4].T)
    return Written("spectral", spherical(*angles[:2]), spherical(*angles[2:]), table[:, 4:])


def read_csv(path):
    rows = csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#"))
    head = "theta_i (deg),phi_i (deg),theta_o (deg),phi_o (deg),450nm,520nm,590nm,650nm"
    assert next(rows) == head.split(",")
    table = np.array([[float(cell) for cell in row] for row in rows])
    return Written("spectral", spherical(*table[:, :2].T), spherical(*table[:, 2:4].T), table[:, 4:])


def read_merl(path):
    """Every seventh theta_d and phi_d; nodes that are -1 are not measured."""
    planes = np.fromfile(path, "<f8", offset=12).reshape(3, 90, 90, 180)
    h, d, p = (
        a.ravel() for a in np.meshgrid(range(90), (*range(0, 84, 7), 88, 89), range(0, 180, 7), indexing="ij")
    )
    values = (planes[:, h, d, p] * np.array([[1.0], [1.15], [1.66]]) / 1500.0).T
    theta_h = np.pi / 2 * (h / 90.0) ** 2
    x, y, z = spherical(d.astype(float), p.astype(float)).T
    s, c = np.sin(theta_h), np.cos(theta_h)
    wi, wo = (np.stack([c * a * x + s * z, a * y, c * z - s * a * x], axis=-1) for a in (1.0, -1.0))
    kept = values[:, 0] >= 0.0
    assert not np.any(kept & (np.minimum(wi[:, 2], wo[:, 2]) < -1e-9))
    return Written("sRGB", wi[kept], wo[kept], values[kept])


def read_utia(path):
    planes = np.fromfile(path, "<f8").reshape(3, 288, 288)
    w = spherical(15.0 * np.arange(6)[:, None], 7.5 * np.arange(48)).reshape(-1, 3)
    wi, wo = np.repeat(w, 288, axis=0)[::5], np.tile(w, (288, 1))[::5]
    return Written("sRGB", wi, wo, planes.reshape(3, -1).T[::5])


def read_mbsdf(path):
    """Every seventh elevation and azimuth."""
    content = path.read_bytes()
    mark = b"\nMBSDF_DATA_REFLECTION=\n"
    head, data = content.split(mark, 1)
    assert head.split(b"\n")[0] == b"NVIDIA ARC MBSDF V1"
    assert all(len(line) < 1023 for line in head.split(b"\n"))  # the longest line that the SDK reads
    kind, thetas, phis = struct.unpack_from("<3I", data)
    assert (kind, thetas, phis, len(data)) == (1, 45, 90, 12 + 4 * 45 * 45 * 90 * 3)
    i, o, p = (a.ravel() for a in np.meshgrid(*(range(0, n, 7) for n in (45, 45, 90)), indexing="ij"))
    values = np.frombuffer(data, "<f4", offset=12).reshape(-1, 3)[i * (phis * thetas) + o * phis + p]
    return Written("sRGB", spherical(2.0 * i + 1.0, 0.0), spherical(2.0 * o + 1.0, 2.0 * p + 1.0), values)


def read_bird(path):
    data = json.loads(path.read_text())["data"]
    rows = {key: np.array(one["values"]) for key, one in data.items()}
    count = len(np.unique(rows["wavelength_i"]))
    wi, wo = (spherical(rows[f"theta_{w}"], rows[f"phi_{w}"])[::count] for w in "ir")
    return Written("spectral", wi, wo, rows["BRDF"].reshape(-1, count))


READERS = {
    "zemax": read_zemax, "lighttools": read_lighttools, "fred": read_fred, "speos": read_speos,
    "speos-anisotropic": read_speos_anisotropic, "openmaterial": read_openmaterial, "bird": read_bird,
    "astm": read_astm, "csv": read_csv, "merl": read_merl, "utia": read_utia, "mbsdf": read_mbsdf,
}  # fmt: skip


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A satin whose file, as those of instruments, has an f_cos at the horizon that is not 0."""
    path = tmp_path_factory.mktemp("source") / "satin.bsdf"
    satin = Plastic(GGX.isotropic(0.4), np.array(1.5), np.array([0.1, 0.3, 0.5, 0.4]), BANDS)
    write_bsdf(path, goniometer.measure(satin, "satin", n_theta_i=5, resolution=24, compensate=False))
    return path


@pytest.fixture(scope="module")
def brdf(source):
    return MeasuredBRDF(read_bsdf(source))


def as_written(kind, f):
    """Values (..., 4) of the bands in what a format holds."""
    if kind == "spectral":
        return f
    rgb = to_srgb(estimate_spectra(f, BANDS), SPECTRUM)  # the bands are coarse
    if kind == "luminance":
        return luminance(rgb, Bands(None))[..., None]
    return rgb @ XYZ_OF_SRGB.T if kind == "XYZ" else rgb


def lifted(w):
    """Directions that are not nearer to the horizon than what an RGL file says."""
    theta = np.rad2deg(np.arccos(np.clip(w[:, 2], -1.0, 1.0)))
    return spherical(np.minimum(theta, LOWEST_DEG), np.rad2deg(np.arctan2(w[:, 1], w[:, 0])))


def test_every_format_but_the_source_s_own_is_read_here():
    assert set(READERS) | {"rgl"} == set(CONVERTED)


@pytest.mark.parametrize("name", READERS)
def test_written_values_equal_the_brdf_at_every_node_and_in_sum(name, source, brdf, tmp_path):
    convert([source], tmp_path / "out.dat", to=name)
    found = READERS[name](tmp_path / "out.dat")
    above = np.minimum(found.wi[:, 2], found.wo[:, 2]) > -1e-6
    assert np.all(found.values[~above] == 0.0)
    wi, wo, values = found.wi[above], found.wo[above], found.values[above]
    f = brdf.eval(lifted(wi), lifted(wo))  # nodes at the horizon are no brighter than their neighbours
    expected = as_written(found.kind, f)
    if name in {"merl", "mbsdf"}:  # one node stands for both orders
        expected = 0.5 * (expected + as_written(found.kind, brdf.eval(lifted(wo), lifted(wi))))
    expected = np.maximum(expected, 0.0)
    # Angles of six digits, values of seven, tables in single precision; matrices of XYZ of four digits.
    rtol = 1e-3 if found.kind == "XYZ" else 1e-4
    # At the horizon itself six digits of angles decide whether a node is above or below it.
    expected[(wo[:, 2] < 1e-6) & np.all(values == 0.0, axis=1)] = 0.0
    np.testing.assert_allclose(values, expected, rtol=rtol, atol=rtol * np.median(expected))
    for theta, said, band in found.sums:
        albedo = as_written(found.kind, brdf.albedo(spherical(theta, 180.0)))[band]
        assert said == pytest.approx(albedo, rel=0.02), (theta, band)  # steps of 1 x 5 degrees
    if name in {"fred", "openmaterial", "bird", "astm", "csv"}:
        rings_reflect_the_albedo(found, brdf)


def rings_reflect_the_albedo(found, brdf):
    """Values over azimuth, then trapezoids over elevation."""
    at = np.round(found.wi[:, 2], 6)
    for z in np.unique(at):
        rows = at == z
        theta = np.round(np.arccos(np.clip(found.wo[rows, 2], 0.0, 1.0)), 4)
        rings = np.unique(theta)
        means = np.array([found.values[rows][theta == t].mean(axis=0) for t in rings])
        rings, means = np.append(rings, np.pi / 2), np.vstack([means, means[-1:]])
        sums = np.pi * np.trapezoid(means * np.sin(2.0 * rings)[:, None], rings, axis=0)
        albedo = as_written(found.kind, brdf.albedo(found.wi[rows][:1]))[0]
        np.testing.assert_allclose(sums, albedo, rtol=0.02)  # steps of 2 x 10 degrees


def test_f_of_an_rgl_file_is_0_at_the_horizon(brdf):
    """A right angle rounds to a cosine of 6e-17, by which f_cos would be divided."""
    for pair in ((45.0, 90.0), (90.0, 45.0)):
        assert np.all(brdf.eval(spherical(pair[0], 0.0), spherical(pair[1], 2.0)) == 0.0)
    assert np.all(brdf.eval(spherical(45.0, 0.0), spherical(89.0, 2.0)) > 0.0)
