"""Sources of `manifold convert`: an RGL file or an instrument's, as a BRDF and as values at its own nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from manifold.brdf.cells import cells_of
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.tabulated import DenseBRDF, ReadingsBRDF
from manifold.brdf.unmeasured import fill_unmeasured
from manifold.brdf.wrapped import WrappedBRDF
from manifold.colour.conversion import file_to_srgb, to_srgb
from manifold.errors import UsageError
from manifold.formats import registry
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings
from manifold.formats.tensor_file import MAGIC
from manifold.io_rgl import read_bsdf
from manifold.model.completion.hybrid import InstrumentCorrection, corrected
from manifold.records import Array, Bands, BsdfFile, evenly_spaced
from manifold.system.small_files import begins_with

MOST_NODES = 100_000
"""Nodes at which the error of a conversion is measured; an even choice where a file has more."""
LEAST_COSINE = float(np.sin(np.deg2rad(2.0)))
"""Of both directions: f = f_cos / cos of RGL files says nothing nearer to the horizon."""


@dataclass(frozen=True, eq=False)
class Source:
    """A BRDF to be converted.

    Attributes:
        nodes: values at the file's own nodes, at most `MOST_NODES` of them.
        brdf: what interpolates them; None where they do not cover hemispheres.
        why_not: what to say where there is no BRDF.
        theta_i_rad: the file's own incidences, increasing; none where it has no such nodes.
        is_readings: whether the nodes are all that the file holds.
    """

    nodes: Readings
    brdf: BRDF | None
    why_not: str
    theta_i_rad: Array
    is_readings: bool

    def require_brdf(self) -> BRDF:
        """The BRDF. Raises UsageError where readings do not make one."""
        if self.brdf is None:
            raise UsageError(self.why_not)
        return self.brdf


class SrgbBRDF(WrappedBRDF):
    """A spectral BRDF in linear sRGB under D65, through colour-science."""

    @property
    def bands(self) -> Bands:
        """The three channels."""
        return Bands(None)

    def eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, shape (..., 3)."""
        return to_srgb(self._brdf.eval(wi, wo), self._brdf.bands)


def open_source(
    paths: Sequence[Path],
    sample: str | None = None,
    correction: InstrumentCorrection | None = None,
    *,
    rgb: bool = False,
) -> Source:
    """Read what is to be converted.

    Args:
        paths: one file, or the files of one sample (pab-opto's, one per incidence).
        sample: which of a file's samples.
        correction: of colours of readings, before anything else.
        rgb: in linear sRGB; RGL files are then converted before they are interpolated, which is quicker.
    Raises:
        UsageError, FileFormatError: as `registry.read` and `read_bsdf`; or what is to be corrected is no readings.
        BandMismatchError: the correction was learned in other bands.
    """
    if len(paths) == 1 and begins_with(paths[0], MAGIC):
        if correction is not None:
            raise _not_corrected(paths[0])
        if sample is not None:
            raise UsageError(f"{paths[0]} holds one material; leave --sample out")
        file = read_bsdf(paths[0])
        return _of_rgl(file_to_srgb(file) if rgb else file)
    for path in paths:
        if begins_with(path, MAGIC):
            raise UsageError(f"{path}: an RGL file among {len(paths)} files; convert it alone")
    record = registry.merge([registry.read(path, sample) for path in paths])
    if correction is not None:
        if isinstance(record, DenseTable):
            raise _not_corrected(paths[0])
        record = corrected(record, correction)
    source = _of_table(record) if isinstance(record, DenseTable) else _of_readings(record)
    return _in_srgb(source) if rgb else source


def _not_corrected(path: Path) -> UsageError:
    return UsageError(
        f"{path}: a table of a BRDF, expected an instrument's readings to correct; leave --correction out"
    )


def _in_srgb(source: Source) -> Source:
    if source.nodes.bands.is_rgb:
        return source
    values = to_srgb(source.nodes.values, source.nodes.bands)
    nodes = replace(source.nodes, wavelengths_nm=None, values=values)
    return replace(source, nodes=nodes, brdf=None if source.brdf is None else SrgbBRDF(source.brdf))


def _of_rgl(file: BsdfFile) -> Source:
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
    return Source(nodes, brdf, "", np.asarray(file.theta_i_rad, dtype=float), is_readings=False)


def _of_table(table: DenseTable) -> Source:
    theta_i = table.axes[0] if table.coordinates == "incident-outgoing" else np.zeros(0)
    return Source(table.readings(MOST_NODES), DenseBRDF(table), "", theta_i, is_readings=False)


def _of_readings(readings: Readings) -> Source:
    theta = np.unique(np.round(np.arccos(np.clip(readings.wi[:, 2], 0.0, 1.0)), 5))
    try:
        return Source(readings, ReadingsBRDF(readings), "", theta, is_readings=True)
    except UsageError as error:
        return Source(readings, None, str(error), theta, is_readings=True)
