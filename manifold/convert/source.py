"""Opens inputs of `manifold convert` as a BRDF, and as values at their own nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import LEAST_COSINE, cells_of, fill_unmeasured
from manifold.brdf.wrapper import WrappedBRDF
from manifold.colour.conversion import file_to_srgb, luminance, to_srgb
from manifold.colour.correction import ColourCorrection
from manifold.colour.narrow_bands import (
    SPECTRUM,
    as_spectra,
    estimate_spectra,
    in_daylight,
    is_coarse,
    is_narrow,
)
from manifold.convert.tabulated import DenseBRDF, ReadingsBRDF
from manifold.core.errors import UsageError
from manifold.core.names import first_few
from manifold.core.records import Array, Bands, BsdfFile, evenly_spaced
from manifold.estimate.instruments import correct_colours
from manifold.formats import registry
from manifold.formats.dense import DenseTable
from manifold.formats.readings import DAYLIGHT, Readings
from manifold.formats.recognition import Kind, kind_of
from manifold.io_rgl import read_bsdf
from manifold.model.output_file import EXPECTED_ERROR
from manifold.model.prediction import ClippedBRDF

MOST_NODES = 100_000
"""Largest number of nodes at which the error of a conversion is measured.

If a file has more, evenly spaced nodes are used.
"""
_LUMINANCE = Bands((550.0,))


@dataclass(frozen=True, eq=False)
class ConversionSource:
    """A BRDF to be converted.

    Attributes:
        nodes: values at the file's own nodes, at most `MOST_NODES` of them.
        interpolated: the BRDF that interpolates the nodes, or the error that says why these readings cannot be
            interpolated.
        theta_i_rad: the incidences of the file, increasing; empty if its nodes have no common incidences.
        is_readings: whether the file holds only readings, which are the nodes.
    """

    nodes: Readings
    interpolated: BRDF | UsageError
    theta_i_rad: Array
    is_readings: bool
    file: BsdfFile | None = None

    @property
    def expected_error(self) -> float | None:
        """Return the relative expected error of cube roots of an estimated material; None for a measured one."""
        kept = None if self.file is None else self.file.extra.get(EXPECTED_ERROR)
        return (
            float(kept[0]) if kept is not None and kept.shape == (1,) and kept.dtype == np.float32 else None
        )

    @property
    def brdf(self) -> BRDF:
        """The BRDF. Raises UsageError if the readings cannot be interpolated to a BRDF."""
        if isinstance(self.interpolated, UsageError):
            raise self.interpolated
        return self.interpolated


class SrgbBRDF(WrappedBRDF):
    """A spectral BRDF converted to linear sRGB under D65."""

    def __init__(self, brdf: BRDF) -> None:
        """Wrap a spectral BRDF."""
        super().__init__(brdf)
        self.bands = Bands(None)

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., 3)."""
        return to_srgb(self._brdf.eval(wi, wo), self._brdf.bands)


class LuminanceBRDF(WrappedBRDF):
    """The luminance (CIE Y under D65) of a BRDF in linear sRGB, as one band."""

    def __init__(self, brdf: BRDF) -> None:
        """Wrap a BRDF in linear sRGB."""
        super().__init__(brdf)
        self.bands = _LUMINANCE

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., 1)."""
        return luminance(self._brdf.eval(wi, wo), self._brdf.bands)[..., None]


class EstimatedSpectraBRDF(WrappedBRDF):
    """A BRDF in narrow or coarse bands converted to estimated spectra (see `colour.narrow_bands`)."""

    def __init__(self, brdf: BRDF) -> None:
        """Wrap a BRDF in narrow or coarse bands."""
        super().__init__(brdf)
        self.bands = SPECTRUM

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, at least 0, shape (..., 31)."""
        return estimate_spectra(self._brdf.eval(wi, wo), self._brdf.bands)


def open_source(
    paths: Sequence[Path],
    sample: str | None = None,
    correction: ColourCorrection | None = None,
    *,
    rgb: bool = False,
    merge: bool = False,
    unit: str | None = None,
) -> ConversionSource:
    """Read the input of a conversion: one file, or the files of one specimen (pab-opto: one per incidence).

    `correction` is applied to the colours of readings first. With `rgb`, RGL files are converted to linear sRGB
    before they are interpolated, which is faster. With `merge`, the files are treated as one specimen even if they
    name it differently. `unit` is the unit of values in files that name none, see `registry.read`.
    """
    of_rgl = [path for path in paths if kind_of(path) is Kind.RGL]
    if of_rgl and len(paths) > 1:
        raise UsageError(f"{of_rgl[0]}: an RGL file among {len(paths)} files; convert it alone")
    if of_rgl and unit is not None:
        raise UsageError(f"{paths[0]}: an RGL file states its unit; leave --unit {unit} out")
    if of_rgl and sample is not None:
        raise UsageError(f"{paths[0]}: an RGL file holds one material; leave --sample out")
    record: BsdfFile | registry.Record
    if of_rgl:
        record = read_bsdf(paths[0])
    else:
        parts = [_in_daylight(registry.read(path, sample, unit=unit)) for path in paths]
        names = list(dict.fromkeys(part.name for part in parts))
        if len(names) > 1 and not merge:
            raise UsageError(
                f"{len(paths)} files of different samples, {first_few(names)}; convert them into a folder, or add "
                "--merge if they belong to one sample"
            )
        record = registry.merge(parts)
    if correction is not None and not isinstance(record, Readings):
        raise UsageError(f"{paths[0]}: a table of a BRDF, expected an instrument's readings to correct")
    if isinstance(record, BsdfFile):
        if rgb and is_coarse(record.bands):
            return replace(_in_srgb(_of_rgl(record)), file=file_to_srgb(record))
        return _of_rgl(file_to_srgb(record) if rgb else record)
    if isinstance(record, DenseTable):
        theta_i = record.axes[0] if record.coordinates == "incident-outgoing" else np.zeros(0)
        source = ConversionSource(record.readings(MOST_NODES), DenseBRDF(record), theta_i, is_readings=False)
    else:
        source = _of_readings(record if correction is None else correct_colours(record, correction))
    return _in_srgb(source) if rgb else source


def _in_daylight(record: registry.Record) -> registry.Record:
    return in_daylight(record) if isinstance(record, Readings) else record


def source_of_prediction(brdf: BRDF, file: BsdfFile, *, rgb: bool = False) -> ConversionSource:
    """Return a model's prediction as a source, at the nodes of a file that was measured from it."""
    of_file = _of_rgl(file)
    clipped = ClippedBRDF(brdf)
    nodes = replace(of_file.nodes, values=clipped.eval(of_file.nodes.wi, of_file.nodes.wo))
    source = replace(of_file, nodes=nodes, interpolated=clipped)
    return replace(_in_srgb(source), file=file_to_srgb(file)) if rgb else source


def in_luminance(source: ConversionSource) -> ConversionSource:
    """Return the luminance of a source in linear sRGB, as one band."""
    nodes, brdf = source.nodes, source.interpolated
    values = luminance(nodes.values, nodes.bands)[:, None]
    nodes = replace(nodes, wavelengths_nm=np.array(_LUMINANCE.wavelengths_nm), values=values)
    return replace(
        source, nodes=nodes, interpolated=brdf if isinstance(brdf, UsageError) else LuminanceBRDF(brdf)
    )


def with_estimated_spectra(source: ConversionSource) -> ConversionSource:
    """Return a source in three narrow bands converted to spectra, with a note; other sources are returned unchanged."""
    return _estimated(source) if is_narrow(source.nodes.bands) else source


def _estimated(source: ConversionSource) -> ConversionSource:
    brdf = source.interpolated
    estimated = brdf if isinstance(brdf, UsageError) else EstimatedSpectraBRDF(brdf)
    return replace(source, nodes=as_spectra(source.nodes), interpolated=estimated)


def _in_srgb(source: ConversionSource) -> ConversionSource:
    bands = source.nodes.bands
    if bands.is_rgb:
        return source
    if is_narrow(bands) or is_coarse(bands):
        source = _estimated(source)
    values = to_srgb(source.nodes.values, source.nodes.bands)
    nodes = replace(source.nodes, wavelengths_nm=None, values=values, viewing=DAYLIGHT)
    brdf = source.interpolated
    return replace(source, nodes=nodes, interpolated=brdf if isinstance(brdf, UsageError) else SrgbBRDF(brdf))


def _of_rgl(file: BsdfFile) -> ConversionSource:
    brdf = MeasuredBRDF(fill_unmeasured(file))
    wi, wo = [], []
    for p, t, cells in cells_of(file):
        keep = cells.is_above & file.measured_mask[p, t] & (cells.wo[..., 2] > LEAST_COSINE)
        keep &= cells.wi[2] > LEAST_COSINE
        wo.append(cells.wo[keep])
        wi.append(np.broadcast_to(cells.wi, wo[-1].shape))
    all_wi, all_wo = np.concatenate(wi), np.concatenate(wo)
    chosen = evenly_spaced(len(all_wi), MOST_NODES)
    nodes = Readings(
        file.name, "RGL goniometer", all_wi[chosen], all_wo[chosen], file.wavelengths_nm,
        brdf.eval(all_wi[chosen], all_wo[chosen]),
    )  # fmt: skip
    return ConversionSource(nodes, brdf, file.theta_i_rad.astype(np.float64), is_readings=False, file=file)


def _of_readings(readings: Readings) -> ConversionSource:
    theta = np.unique(np.round(np.arccos(np.clip(readings.wi[:, 2], 0.0, 1.0)), 5))
    try:
        brdf: BRDF | UsageError = ReadingsBRDF(readings)
    except UsageError as error:
        brdf = error
    return ConversionSource(readings, brdf, np.asarray(theta, dtype=np.float64), is_readings=True)
