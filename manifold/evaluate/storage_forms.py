"""Forms in which measured files can be stored: complete, compact, float16, few bands, or few angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from manifold.colour.conversion import interpolation_matrix
from manifold.colour.illuminants import illuminant_power
from manifold.core.records import Array, Bands, BsdfFile
from manifold.library.compacting import encode
from manifold.study.budget import reduced_file

_FLOAT_BYTES = 4


@dataclass(frozen=True)
class Storage:
    """A form in which measured files are stored.

    Attributes:
        key, title: parts of the key and the title of a setting.
        reduce: function that returns a file in its stored form.
        bands: number of stored bands; None means all.
        stored_bytes: function that returns the size of a stored file in bytes; None means the size of its arrays.
    """

    key: str
    title: str
    reduce: Callable[[BsdfFile], BsdfFile]
    bands: int | None = None
    number_bytes: int = _FLOAT_BYTES
    stored_bytes: Callable[[BsdfFile], int] | None = None

    def file_bytes(self, stored: BsdfFile, band_share: float = 1.0) -> int:
        """Return the bytes of a stored file that evaluation reads: distributions, and values in a share of bands."""
        if self.stored_bytes is not None:
            return self.stored_bytes(stored)
        tables = stored.ndf.size + stored.sigma.size + stored.vndf.size
        return round((tables + band_share * stored.spectra.size) * self.number_bytes)


WHOLE = Storage("", "", lambda file: file)
"""The complete file as measured, in float32."""


def compact() -> Storage:
    """Return storage in the compact form of libraries, at its default tolerance; files are read as a whole."""
    sizes: dict[str, int] = {}

    def reduce(file: BsdfFile) -> BsdfFile:
        found = encode(file)
        sizes[file.name] = found.stored_bytes
        return replace(file, **found.decode())

    return Storage("compact", "compact", reduce, stored_bytes=lambda file: sizes[file.name])


def half() -> Storage:
    """Return storage of all tables as float16; values above its range become its largest number."""
    return Storage("half", "float16", _halved, number_bytes=2)


def few_bands(count: int) -> Storage:
    """Return a storage form that keeps `count` wavelengths, chosen for D65; the others are interpolated linearly."""

    def reduce(file: BsdfFile) -> BsdfFile:
        nodes, projection = _projection(file.bands, count)
        return reduced_file.with_bands(file, nodes, projection)

    return Storage(f"{count}_of_bands", f"{count} bands kept", reduce, bands=count)


def few_angles(*, outgoing: int, incident: int) -> Storage:
    """Return storage of every `outgoing`-th row and column of the outgoing grid and `incident`-th incidence."""

    def reduce(file: BsdfFile) -> BsdfFile:
        T = len(file.theta_i_rad)
        resolution = -(-file.spectra.shape[3] // outgoing)
        kept = np.unique(np.append(np.arange(0, T, incident), T - 1))
        warp = -(-file.vndf.shape[2] // outgoing)
        return reduced_file.with_angles(file, kept, resolution=resolution, warp_nodes=warp)

    what = {(True, False): "outgoing grid", (False, True): "incidences"}.get(
        (outgoing > 1, incident > 1), "both grids"
    )
    return Storage(f"angles_{outgoing}_{incident}", f"1/{max(outgoing, incident)} {what}", reduce)


def interpolation(bands: Bands, count: int) -> Array:
    """Return the matrix (B, r) that interpolates r stored bands to all B bands."""
    nodes, _ = _projection(bands, count)
    return interpolation_matrix(nodes, np.asarray(bands.wavelengths_nm))


def _projection(bands: Bands, count: int) -> tuple[Array, Array]:
    return reduced_file.few_bands(bands, bands, illuminant_power(bands, "D65"), count)


def _halved(file: BsdfFile) -> BsdfFile:
    most = np.finfo(np.float16).max

    def half(values: Array) -> Array:
        return np.clip(values, -most, most).astype(np.float16).astype(np.float32)

    return replace(
        file,
        spectra=half(file.spectra), ndf=half(file.ndf), sigma=half(file.sigma), vndf=half(file.vndf),
    )  # fmt: skip
