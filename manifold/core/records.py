"""Immutable records that many modules share."""

from __future__ import annotations

import copyreg
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manifold.core import shipped
from manifold.core.errors import BandMismatchError, ShapeError

Array = NDArray[np.floating[Any]]
AnyArray = NDArray[Any]  # a field of a file, of whatever type
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]


def _read_only(fields: dict[str, Any]) -> MappingProxyType[str, Any]:
    return MappingProxyType(fields)


# Python pickles neither the read-only mappings of some records nor their class: they travel as copies, by a function.
copyreg.pickle(MappingProxyType, lambda fields: (_read_only, (dict(fields),)))

RGB_NAMES = ("R", "G", "B")


@dataclass(frozen=True)
class Bands:
    """The spectral axis of a BRDF: B wavelengths, or the three channels of linear sRGB.

    Attributes:
        wavelengths_nm: band centres in nm, strictly increasing, a sequence or array of shape (B,); None for RGB.

    Raises:
        ShapeError: there are no wavelengths, or they are not finite or do not increase.
    """

    wavelengths_nm: tuple[float, ...] | None

    def __post_init__(self) -> None:
        if self.wavelengths_nm is None:
            return
        nm = np.asarray(self.wavelengths_nm, dtype=np.float64)
        if nm.ndim != 1 or nm.size == 0 or not np.all(np.isfinite(nm)) or np.any(np.diff(nm) <= 0):
            raise ShapeError(
                f"wavelengths have shape {nm.shape}, expected (B,), finite and increasing, in nm"
            )
        object.__setattr__(self, "wavelengths_nm", tuple(nm.tolist()))

    @classmethod
    def from_array(cls, wavelengths_nm: Array | None) -> Bands:
        """Return the bands of a wavelength array in nm, shape (B,), or of RGB for None."""
        return cls(wavelengths_nm)  # type: ignore[arg-type]

    @property
    def is_rgb(self) -> bool:
        """Return whether the bands are the three channels of linear sRGB."""
        return self.wavelengths_nm is None

    @property
    def count(self) -> int:
        """Number of bands, B."""
        return 3 if self.wavelengths_nm is None else len(self.wavelengths_nm)

    @property
    def labels(self) -> tuple[str, ...]:
        """One name per band: `R`, `G`, `B`, or the wavelength with its unit."""
        if self.wavelengths_nm is None:
            return RGB_NAMES
        return tuple(f"{w:.1f} nm" for w in self.wavelengths_nm)

    def __str__(self) -> str:
        if self.wavelengths_nm is None:
            return "RGB"
        if self.count == 1:
            return f"1 band, {self.wavelengths_nm[0]:.1f} nm"
        return f"{self.count} bands, {self.wavelengths_nm[0]:.1f} to {self.wavelengths_nm[-1]:.1f} nm"

    def select(self, indices: Iterable[int]) -> Bands:
        """Return the bands with these increasing indices; linear sRGB must keep all three channels."""
        nm = self.wavelengths_nm
        return self if nm is None else Bands(tuple(nm[b] for b in indices))

    def require_same(self, other: Bands, where: str, remedy: str = "") -> None:
        """Raise BandMismatchError unless `other` has exactly the same bands.

        By default the message advises to use a library of the same bands, or to turn spectra into RGB.
        """
        if self != other:
            if not remedy:
                remedy = "use a library of the same bands"
                if self.is_rgb:
                    remedy += (
                        ", or turn it into RGB: manifold convert NAME.bsdf -o NAME.binary, then "
                        "manifold convert NAME.binary -o NAME_rgb.bsdf"
                    )
            raise BandMismatchError(f"{where}: found {other}, expected {self}; {remedy}")


_ORIGINS = {
    "Predicted at": "predicted",
    "Predicted from": "predicted",
    "Completed from": "completed",
    "A dielectric coat": "completed",
    "Found in": "completed",
    "Photographed, at": "predicted",
    "Reconstruction of": "reconstructed",
}


def origin_of(description: str) -> str:
    """Return the origin of a file's values from its description: `measured`, unless this package wrote it."""
    return next((word for start, word in _ORIGINS.items() if description.startswith(start)), "measured")


@dataclass(frozen=True, eq=False)
class BsdfFile:
    """The content of an RGL file with P incident azimuths, T angles of incidence, and B bands.

    Attributes:
        name: the material's name (the file name without `_spec.bsdf` or `_rgb.bsdf`).
        description: free text of the file.
        version: version of the pipeline that wrote a spectral file; RGB files say (1, 0).
        phi_i_rad: incident azimuths in radians, float32, shape (P,); P = 1 is isotropic.
        theta_i_rad: angles of incidence in radians, float32, increasing, shape (T,).
        wavelengths_nm: band centres in nm, float32, increasing, shape (B,); None in an RGB file.
        sigma: projected microfacet area, float32, shape (rows = phi, columns = theta).
        ndf: normal distribution, float32, shape (rows = phi, columns = theta).
        vndf: distribution of visible normals, float32, shape (P, T, rows, columns).
        luminance: relative luminance on the warped grid, float32, shape (P, T, H, W).
        spectra: measured values on the warped grid, float32, shape (P, T, B, H, W); `rgb` in an RGB file.
        jacobian: whether values are multiplied by ndf / (4 sigma) to give f_cos in 1/sr.
        valid: the mask in the form of the file (uint8, usually packed bits); see `measured_mask`.
        extra: fields that this package does not interpret, by name.
        rotation_rad: azimuth by which the specimen was turned when it was measured, which evaluation reverses;
            libraries store it, files do not.
    """

    name: str
    description: str
    version: tuple[int, ...]
    phi_i_rad: Array
    theta_i_rad: Array
    wavelengths_nm: Array | None
    sigma: Array
    ndf: Array
    vndf: Array
    luminance: Array
    spectra: Array
    jacobian: bool
    valid: NDArray[np.uint8]
    extra: Mapping[str, AnyArray] = field(default_factory=lambda: MappingProxyType({}))
    rotation_rad: float = 0.0

    def __repr__(self) -> str:
        kind = "isotropic" if self.is_isotropic else "anisotropic"
        shape = " x ".join(map(str, self.spectra.shape))
        return f"<BsdfFile: {self.name}, {self.bands}, {kind}, spectra {shape}>"

    @cached_property
    def bands(self) -> Bands:
        """The spectral axis."""
        return Bands.from_array(self.wavelengths_nm)

    @property
    def is_isotropic(self) -> bool:
        """Return whether the file is isotropic: it has at most two incident azimuths (Mitsuba's rule)."""
        return self.phi_i_rad.shape[0] <= 2

    @property
    def azimuth_repeats(self) -> int:
        """Return how often the azimuths of an anisotropic file repeat in a turn: 1, or by symmetry 2 or 4."""
        return round(2.0 * np.pi / float(self.phi_i_rad[-1] - self.phi_i_rad[0]))

    @property
    def origin(self) -> str:
        """`measured`, `predicted`, `completed` or `reconstructed`; see `origin_of`."""
        return origin_of(self.description)

    @cached_property
    def measured_mask(self) -> Mask:
        """Return a mask of the cells that were measured, bool, shape (P, T, H, W).

        A bit means "measured" in files of pipeline versions up to 3.1 and "unmeasured" from 3.2 on; RGB files do not
        state the version. Non-zero cells were measured, except for a few per cent at the rim that the database
        filled. Therefore the meaning that keeps more non-zero cells is used; zeros are ignored, because black cells
        are zero as well. Without bits, non-zero cells are treated as measured.
        """
        shape = self.luminance.shape
        count = int(np.prod(shape))
        non_zero = np.any(self.spectra != 0, axis=2)  # (P, T, H, W)
        if self.valid.size * 8 >= count > self.valid.size:
            bits = np.unpackbits(self.valid.reshape(-1))[:count].reshape(shape).astype(bool)
        elif self.valid.size == count:
            bits = self.valid.reshape(shape) != 0
        else:
            return non_zero
        kept = np.count_nonzero(bits & non_zero)
        return bits if 2 * kept >= np.count_nonzero(non_zero) else ~bits


def plain(value: Any) -> Any:
    """Return a value in a form for JSON: records by their `to_json` or fields, NaN as None, paths as text."""
    match value:
        case None | bool() | int():
            return value
        case str():
            return str(value)  # of subclasses too
        case float():
            return float(value) if math.isfinite(value) else None  # of NumPy too
        case Mapping():
            return {str(key): plain(each) for key, each in value.items()}
        case np.ndarray() | np.generic():
            return plain(value.tolist())
        case _ if hasattr(value, "to_json"):
            return value.to_json()
        case _ if hasattr(value, "_asdict"):
            return plain(value._asdict())
        case _ if is_dataclass(value):
            return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
        case list() | tuple():
            return [plain(each) for each in value]
        case PurePath():
            return shipped.named(value)
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def evenly_spaced(total: int, count: int) -> Indices:
    """Return at most `count` evenly spaced indices from 0 to total - 1, both ends included."""
    return np.unique(np.linspace(0, total - 1, min(total, count)).round().astype(int))
