"""One sample in every format of instruments, as small as the format allows, quick to write."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from manifold.brdf.synthetic.ggx import GGX
from manifold.brdf.synthetic.instruments import (
    MA_T12_BANDS,
    MINI_DIFF_BANDS,
    ma_t12_readings,
    write_mini_diff,
)
from manifold.brdf.synthetic.microfacet import Plastic
from manifold.formats import astm, csv_table, cxf, lighttools, ma_t12, merl, pab_opto, utia, zemax
from manifold.formats.dense import DenseTable
from manifold.records import Array, Bands

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


def write_every_format(folder: Path) -> dict[str, Path]:
    """A file of each format, by its name."""
    spectro = ma_t12_readings(smooth(MA_T12_BANDS), "smooth")
    paths = {name: folder / f"smooth{suffix}" for name, suffix in SUFFIXES.items()}
    ma_t12.write(paths["ma-t12"], spectro)
    csv_table.write(paths["csv"], spectro)
    cxf.write(paths["cxf"], spectro)
    astm.write(paths["astm"], spectro)
    write_mini_diff(paths["mini-diff"], smooth(MINI_DIFF_BANDS), "smooth")
    pab_opto.write(paths["pab-opto"], spectro.select_bands([10]), dsf=True)
    lighttools.write(paths["lighttools"], dense(MINI_DIFF_BANDS, "incident-outgoing", lighttools_axes()))
    zemax_file(paths["zemax"])
    merl.write(paths["merl"], dense(RGB, "half-difference", merl.axes()))
    utia.write(paths["utia"], dense(RGB, "incident-outgoing", utia.axes()))
    return paths


SUFFIXES = {
    "ma-t12": ".xlsx", "csv": ".csv", "cxf": ".cxf", "astm": "_table.astm", "mini-diff": ".astm", "pab-opto": ".txt",
    "lighttools": "_lt.bsdf", "zemax": "_zemax.bsdf", "merl": ".binary", "utia": ".bin",
}  # fmt: skip
TITLES = {
    "ma-t12": "spectrophotometer workbook (.xlsx)", "csv": "CSV table", "cxf": "CxF3", "astm": "ASTM table",
    "mini-diff": "ASTM table", "pab-opto": "pab-opto text", "lighttools": "LightTools BSDF text",
    "zemax": "Zemax BSDF text", "merl": "MERL", "utia": "UTIA",
}  # fmt: skip
