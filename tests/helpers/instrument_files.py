"""One sample in every format of instruments, as small as the format allows, quick to write."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import colour_cxf
import numpy as np
import xlwt
from colour_cxf import cxf3

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.analytic.virtual_instruments import (
    MA_T12_BANDS,
    MINI_DIFF_BANDS,
    ma_t12_readings,
    write_mini_diff,
)
from manifold.core import disk
from manifold.core.directions import from_spherical
from manifold.core.records import Array, Bands
from manifold.formats import (
    astm,
    csv_table,
    fred,
    lighttools,
    ma_t12,
    mbsdf,
    merl,
    openmaterial,
    speos,
    utia,
    zemax,
)
from manifold.formats.csv_table import angles_deg
from manifold.formats.dense import DenseTable
from manifold.formats.readings import MA_T12_NAMES, Readings

RGB = Bands(None)


def smooth(bands: Bands) -> Plastic:
    """A rough, coloured BRDF."""
    colour = np.linspace(0.2, 0.7, bands.count)
    return Plastic(GGX.isotropic(0.4), np.array(1.5), colour, bands)


def dense(bands: Bands, coordinates: str, axes: tuple[Array, ...]) -> DenseTable:
    """`smooth` at the nodes of a table, NaN below the horizon."""
    shape = tuple(a.size for a in axes)
    table = DenseTable("smooth", "test", coordinates, axes, _nm(bands), np.zeros((*shape, bands.count)))
    wi, wo = table.directions()
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    values = np.full((len(wi), bands.count), np.nan)
    values[above] = smooth(bands).eval(wi[above], wo[above])
    return DenseTable("smooth", "test", coordinates, axes, _nm(bands), values.reshape(*shape, bands.count))


def _nm(bands: Bands) -> Array | None:
    return None if bands.wavelengths_nm is None else np.array(bands.wavelengths_nm)


def lighttools_axes() -> tuple[Array, ...]:
    """Incidences, one azimuth, elevations and azimuths in radians."""
    return tuple(
        np.deg2rad(a)
        for a in ([0.0, 30.0, 60.0], [180.0], np.arange(0.0, 90.0, 5.0), np.arange(0.0, 360.0, 30.0))
    )


def zemax_file(path: Path) -> Path:
    """`smooth` in linear sRGB about the mirror direction."""
    theta, azimuth, radial = (
        np.deg2rad(a) for a in ([0.0, 30.0, 60.0], np.arange(0.0, 361.0, 30.0), np.arange(0.0, 90.0, 5.0))
    )
    values = np.zeros((theta.size, azimuth.size, radial.size, 3))
    for k, t in enumerate(theta):
        wi, wo = zemax.directions(t, radial[None, :], azimuth[:, None])
        values[k] = smooth(RGB).eval(wi, wo)
    zemax.write(path, "smooth", theta, azimuth, radial, values)
    return path


def write_cxf(path: Path, readings: Readings) -> None:
    """Readings at the 12 geometries of an MA-T12 as CxF3; 10 nm steps are taken from the first two bands."""
    nm = readings.bands.wavelengths_nm or ()
    specifications, spectra = [], []
    for name, row in zip(MA_T12_NAMES, readings.values, strict=True):
        anchor, _, aspecular = name.partition("as")
        angle = cxf3.Brdfangle(
            illumination_angle=float(anchor), aspecular=float(aspecular),
            notation=name,
        )  # fmt: skip
        measurement = cxf3.MeasurementSpec(
            measurement_type=cxf3.MeasurementType(cxf3.EspectrumType.SPECTRUM_REFLECTANCE),
            geometry_choice=cxf3.GeometryChoice(choice=cxf3.MultiAngleType([angle])),
            wavelength_range=cxf3.WavelengthRange(start_wl=int(nm[0]), increment=int(nm[1] - nm[0])),
            device=cxf3.Device(model=readings.instrument),
        )
        specifications.append(cxf3.ColorSpecification(measurement_spec=measurement, id=f"M0_{name}"))
        spectra.append(
            cxf3.ReflectanceSpectrum(
                value=[float(v) for v in np.pi * row], color_specification=f"M0_{name}", start_wl=int(nm[0])
            )
        )
    item = cxf3.Object(
        color_values=cxf3.ColorValues(choice=list(spectra)),
        name=readings.name,
        id="o1",
        object_type="Standard",
    )
    document = cxf3.CxF(
        resources=cxf3.Resources(
            object_collection=cxf3.ObjectCollection([item]),
            color_specification_collection=cxf3.ColorSpecificationCollection(specifications),
        )
    )
    disk.write_text(path, colour_cxf.write_cxf(document).decode("utf-8"))


def write_pab_opto(path: Path, readings: Readings) -> None:
    """A pab-opto file of one band at one incidence, that of the first reading."""
    wi = readings.wi[0]
    rows = np.flatnonzero(np.isclose(readings.wi, wi).all(axis=1) & readings.measured[:, 0])
    theta_i, phi_i = angles_deg(readings)[0, :2]
    nm = (readings.bands.wavelengths_nm or (0.0,))[0]
    lines = [
        f"#sample_name {readings.name}", f"#incident_angle {theta_i:.9g} {phi_i:.9g}", f"#intheta {theta_i:.9g}",
        f"#inphi {phi_i:.9g}", f"#wavelength {nm:g}", f"#datapoints_in_file: {rows.size}",
        "#format: theta phi DSF",
    ]  # fmt: skip
    values = readings.values[rows, 0] * readings.wo[rows, 2]
    for (theta, phi), value in zip(angles_deg(readings)[rows, 2:], values, strict=True):
        lines.append(f"{theta:.9g}\t{phi:.9g}\t{value:.9g}")
    disk.write_text(path, "\n".join(lines) + "\n")


def write_rt300s(
    path: Path, brdf: Plastic, measured: list[tuple[float, float, float]], titles: int = 1
) -> None:
    """An RT-300S workbook of `titles` sheets and an empty one; (azimuth, incidence, receive) in degrees."""
    book = xlwt.Workbook()
    for sheet, own in enumerate(np.array_split(np.array(measured), titles)):
        table = book.add_sheet(f"Sheet{sheet + 1}")
        azimuth, incidence, receive = own.T
        wi = from_spherical(np.deg2rad(incidence), np.pi)
        wo = from_spherical(np.deg2rad(receive), np.deg2rad(90.0 + azimuth))
        signal = np.pi * brdf.eval(wi, wo)[:, 0] * wo[:, 2]
        rows = {" Method": ["BRDF_LD"] * len(own), " Model ID": [""] * len(own), " Azimuth": azimuth}
        rows |= {" Incidence": incidence, " Receive": receive, " L*": [""] * len(own), " RT": signal}
        for row, (head, cells) in enumerate(rows.items()):
            for column, cell in enumerate([head, *cells]):
                table.write(row, column, cell if isinstance(cell, str) else float(cell))
    book.add_sheet("empty")
    with disk.replacing(path) as partial:
        book.save(str(partial))


def write_coarse_mini_diff(path: Path) -> None:
    """A Mini-Diff's file of `smooth` at every second elevation and azimuth."""
    write_mini_diff(path, smooth(MINI_DIFF_BANDS), "smooth")
    lines = path.read_text().split("\n")
    first = next(k for k, line in enumerate(lines) if line.startswith("VARS")) + 1
    angles = np.rad2deg([[float(v) for v in line.split(",")[2:4]] for line in lines[first:] if line])
    even = np.flatnonzero((np.round(angles) % [2, 20] == 0).all(axis=1))
    head = [f"NUM_POINTS {even.size}" if "NUM_POINTS" in line else line for line in lines[:first]]
    disk.write_text(path, "\r\n".join([*head, *(lines[first + k] for k in even), ""]))


def write_every_format(folder: Path, *, is_coarse: bool = False) -> dict[str, Path]:
    """A file of each format, by its name; that of a goniometer is long unless it `is_coarse`."""
    _, paths = _every_format(is_coarse)
    return {name: Path(shutil.copy(path, folder)) for name, path in paths.items()}


@cache
def _every_format(is_coarse: bool) -> tuple[TemporaryDirectory[str], dict[str, Path]]:
    """A folder with these files, until the session ends."""
    made = TemporaryDirectory()
    folder = Path(made.name)
    spectro = ma_t12_readings(smooth(MA_T12_BANDS), "smooth")
    paths = {name: folder / f"smooth{suffix}" for name, suffix in SUFFIXES.items()}
    ma_t12.write(paths["ma-t12"], spectro)
    csv_table.write(paths["csv"], spectro)
    write_cxf(paths["cxf"], spectro)
    astm.write(paths["astm"], spectro)
    if is_coarse:
        write_coarse_mini_diff(paths["mini-diff"])
    else:
        write_mini_diff(paths["mini-diff"], smooth(MINI_DIFF_BANDS), "smooth")
    write_pab_opto(paths["pab-opto"], spectro.select_bands([10]))
    lighttools.write(paths["lighttools"], dense(MINI_DIFF_BANDS, "incident-outgoing", lighttools_axes()))
    zemax_file(paths["zemax"])
    one_band = dense(Bands((550.0,)), "incident-outgoing", lighttools_axes())
    fred.write(paths["fred"], one_band)
    speos.write(paths["speos"], dense(MINI_DIFF_BANDS, "incident-outgoing", lighttools_axes()))
    speos.write_anisotropic(paths["speos-anisotropic"], one_band)
    openmaterial.write(paths["openmaterial"], dense(MINI_DIFF_BANDS, "incident-outgoing", lighttools_axes()))
    angles = [
        (a, i, r) for a in (-90.0, -45.0, 0.0) for i in (20.0, 50.0) for r in np.arange(-70.0, 71.0, 20.0)
    ]
    write_rt300s(paths["rt-300s"], smooth(Bands((550.0,))), angles)
    mbsdf.write(paths["mbsdf"], dense(RGB, "incident-outgoing", mbsdf.axes()))
    merl.write(paths["merl"], dense(RGB, "half-difference", merl.axes()))
    utia.write(paths["utia"], dense(RGB, "incident-outgoing", utia.axes()))
    return made, paths


SUFFIXES = {
    "ma-t12": ".xlsx", "csv": ".csv", "cxf": ".cxf", "astm": "_table.astm", "mini-diff": ".astm", "pab-opto": ".txt",
    "lighttools": "_lt.bsdf", "zemax": "_zemax.bsdf", "merl": ".binary", "utia": ".bin", "mbsdf": ".mbsdf",
    "fred": "_fred.txt", "speos": ".brdf", "speos-anisotropic": ".anisotropicbsdf", "openmaterial": ".xompt",
    "rt-300s": ".xls",
}  # fmt: skip
TITLES = {
    "ma-t12": "spectrophotometer workbook (.xlsx)", "csv": "CSV table", "cxf": "CxF3", "astm": "ASTM table",
    "mini-diff": "ASTM table", "pab-opto": "pab-opto text", "lighttools": "LightTools BSDF text",
    "zemax": "Zemax BSDF text", "merl": "MERL", "utia": "UTIA", "mbsdf": "MBSDF (.mbsdf)",
    "fred": "FRED table", "speos": "Ansys Speos text", "speos-anisotropic": "Ansys Speos text",
    "openmaterial": "OpenMATERIAL 3D (.xompt)", "rt-300s": "RT-300S workbook (.xls)",
}  # fmt: skip
