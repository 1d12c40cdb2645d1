"""Lights by their relative spectral power: CIE illuminants and measured ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manifold.colour.colour_science import standard_tables
from manifold.core.errors import FileFormatError, UnknownNameError
from manifold.core.names import names_like
from manifold.core.records import Array, Bands
from manifold.formats.spectra import read_spectrum

_MOST_POWER = 1e30  # renders are in single precision

# CIE's names of the fluorescent illuminants, which colour-science calls FL1 to FL12.
_CIE_FLUORESCENT = {f"F{i}": f"FL{i}" for i in range(1, 13)}


def illuminant_names() -> tuple[str, ...]:
    """Return the names of all illuminants: those of colour-science, and F1 to F12 for its FL1 to FL12."""
    return (*standard_tables().illuminants, *_CIE_FLUORESCENT)


@dataclass(frozen=True)
class Illuminant:
    """A light: its relative spectral power, and the name of the CIE illuminant or of the file.

    Attributes:
        wavelengths_nm: increasing wavelengths in nm.
        power: relative power at each wavelength; it is interpolated linearly, and 0 outside.
    """

    name: str
    wavelengths_nm: tuple[float, ...]
    power: tuple[float, ...]

    @classmethod
    def named(cls, name: str) -> Illuminant:
        """Return the CIE illuminant with a name of `illuminant_names()`."""
        key, known = _CIE_FLUORESCENT.get(name, name), standard_tables().illuminants
        if key not in known:
            raise UnknownNameError(
                f"no illuminant named {name!r}; {names_like(illuminant_names(), name, 'the names are')}"
            )
        nodes, power = known[key]
        return cls(name, tuple(nodes.tolist()), tuple(power.tolist()))

    @classmethod
    def read(cls, path: Path) -> Illuminant:
        """Read a light from a file of wavelengths and powers in any unit (see `formats.spectra.read_spectrum`)."""
        nm, power = read_spectrum(path, "power")
        if power.min() < 0 or not 0 < power.max() < _MOST_POWER:
            raise FileFormatError(
                f"{path}: powers from {power.min():g} to {power.max():g}, expected powers from 0 to below "
                f"{_MOST_POWER:g}, one of them above 0"
            )
        return cls(path.name, tuple(nm.tolist()), tuple(power.tolist()))

    @property
    def is_d65(self) -> bool:
        """Return whether the light is D65, the light of linear sRGB."""
        return self.name == "D65"

    def at(self, wavelengths_nm: Array) -> Array:
        """Return the power at wavelengths in nm, any shape."""
        return np.interp(wavelengths_nm, self.wavelengths_nm, self.power, left=0.0, right=0.0)


def illuminant_power(bands: Bands, illuminant: str) -> Array:
    """Return the relative spectral power of an illuminant at the bands, shape (B,).

    It is 1 for RGB bands, and 0 beyond the illuminant's table.
    """
    lamp = Illuminant.named(illuminant)
    return np.ones(bands.count) if bands.is_rgb else lamp.at(np.asarray(bands.wavelengths_nm))
