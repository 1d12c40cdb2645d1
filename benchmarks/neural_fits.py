"""Published neural fits of measured BRDFs, to compare with: small networks from half and difference vectors to sRGB.

    python benchmarks/neural_fits.py SOURCE FOLDER     # writes them as RGL files, NAME_rgb.bsdf

SOURCE is a folder of the public repository of Sztrajman et al. (asztr/Neural-BRDF), its zip files unpacked, or not.
"""

from __future__ import annotations

import io
import re
import sys
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from manifold.analytic.base import AnalyticBRDF
from manifold.analytic.corpus import write_files
from manifold.brdf import goniometer
from manifold.brdf.plausibility import quadrature_albedo
from manifold.core.directions import from_spherical, to_rusinkiewicz
from manifold.core.records import Array, Bands, Indices
from manifold.evaluate.cross_validation import Encode, Method
from manifold.evaluate.method_data import Data
from manifold.evaluate.seen_fits import FittedPrediction
from manifold.io_rgl import write_bsdf

NUMBERS = 675  # weights and biases of a network
_STEEPEST_DEG = 89.0  # beyond it the albedo at this incidence is taken


@dataclass(frozen=True, eq=False)
class NeuralBRDF(AnalyticBRDF):
    """A network's BRDF: dense layers with ReLU, then max(exp(z) - 1, 0), in linear sRGB.

    Inputs are the half vector (hx, 0, hz) and the difference vector of the Rusinkiewicz frame, phi_d folded into
    [0, pi), so that the BRDF is reciprocal; fits of RGL files saw pi - phi_d.

    Attributes:
        name: of the material.
        layers: kernel (n, m) and bias (m,) of every dense layer.
        is_rgl: whether it was fitted to a file of the RGL database.
        albedo_limits: None gives what was published; see `plausible`.
    Source: Sztrajman et al. 2021, "Neural BRDF Representation and Importance Sampling".
    """

    name: str
    layers: tuple[tuple[Array, Array], ...]
    is_rgl: bool
    albedo_limits: tuple[Array, Array] | None = None
    bands: Bands = Bands(None)  # noqa: RUF009

    def plausible(self) -> NeuralBRDF:
        """Both sides of the plane of incidence averaged, divided by the albedo where that is above 1."""
        theta = np.deg2rad(np.linspace(0.0, _STEEPEST_DEG, 31))
        symmetric = replace(self, albedo_limits=(theta, np.ones_like(theta)))
        albedo = symmetric.albedo(from_spherical(theta, 0.0)).max(axis=-1)
        return replace(self, albedo_limits=(theta, np.maximum(albedo, 1.0)))

    def _eval(self, wi: Array, wo: Array) -> Array:
        theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
        phi_d = np.mod(phi_d, np.pi)
        if self.is_rgl:
            phi_d = np.pi - phi_d
        f = self._network(theta_h, theta_d, phi_d)
        if self.albedo_limits is not None:
            f += self._network(theta_h, theta_d, np.pi - phi_d)
            limits = [np.interp(np.arccos(np.minimum(w[:, 2], 1.0)), *self.albedo_limits) for w in (wi, wo)]
            f /= 2.0 * np.maximum(*limits)[:, None]
        return f

    def _network(self, theta_h: Array, theta_d: Array, phi_d: Array) -> Array:
        x = np.concatenate([from_spherical(theta_h, 0.0), from_spherical(theta_d, phi_d)], axis=-1)
        for kernel, bias in self.layers:
            x = np.maximum(x @ kernel + bias, 0.0)  # at the end too: max(exp(z) - 1, 0) is exp(max(z, 0)) - 1
        return np.asarray(np.expm1(x))

    def _albedo(self, wi: Array) -> Array:
        return quadrature_albedo(self, wi, 32)


def read_neural_fits(path: Path | str) -> dict[str, NeuralBRDF]:
    """All networks in a folder, a zip file or an `.h5` file, by the material's name.

    If several have a name, it is that of the fit to the RGL file; others add the name of their archive.
    """
    found: dict[str, NeuralBRDF] = {}
    for archive, stem, data in sorted(_files(Path(path)), key=lambda file: not file[1].endswith("_rgb")):
        name = stem.removesuffix("_rgb")
        if name in found:
            name = f"{name}_{archive.stem.removesuffix('_nbrdf')}"
        found[name] = NeuralBRDF(name, _layers(data), stem.endswith("_rgb"))
    return dict(sorted(found.items()))


def _files(path: Path) -> Iterator[tuple[Path, str, bytes]]:
    if path.is_dir():
        for inner in sorted(path.rglob("*")):
            if inner.suffix in (".h5", ".zip"):
                yield from _files(inner)
    elif path.suffix == ".h5":
        yield path.parent, path.stem, path.read_bytes()
    else:
        with zipfile.ZipFile(path) as archive:
            for member in map(Path, archive.namelist()):
                if member.suffix == ".h5" and "__MACOSX" not in member.parts:
                    yield path, member.stem, archive.read(str(member))


def _layers(data: bytes) -> tuple[tuple[Array, Array], ...]:
    arrays: dict[str, Array] = {}

    def keep(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
            arrays[name] = np.asarray(item[...], dtype=np.float64)

    with h5py.File(io.BytesIO(data)) as file:
        file.visititems(keep)
    kernels = sorted(
        (name for name in arrays if "kernel" in name),
        key=lambda name: list(map(int, re.findall(r"\d+", name))),
    )
    return tuple((arrays[name], arrays[name.replace("kernel", "bias")]) for name in kernels)


def seen_neural(source: Path | str) -> Method:
    """Published fits of the seen materials, as a method; materials without one have no errors."""

    def fit(data: Data, training: Indices) -> Encode:
        fits = read_neural_fits(source)
        return lambda i: FittedPrediction.of(fits.get(data.materials[i].name), data.n_bands)

    return Method("neural", "neural fit of it", lambda B: NUMBERS, fit, is_held_out=False, refits=False)


def _write(path: Path, brdf: NeuralBRDF) -> None:
    how = {"n_theta_i": 12, "steepest": 2.0, "bend": goniometer.SOFT_BEND, "version": (1, 0)}
    what = f"Neural fit of {brdf.name} (Sztrajman et al. 2021)"
    write_bsdf(path, goniometer.measure(brdf.plausible(), brdf.name, description=what, **how))  # type: ignore[arg-type]


def write_fits(folder: Path | str, fits: Mapping[str, NeuralBRDF]) -> None:
    """Write fits as RGL files."""
    write_files(folder, "_rgb.bsdf", {name: partial(_write, brdf=brdf) for name, brdf in fits.items()})


if __name__ == "__main__":
    source, target = sys.argv[1:]
    write_fits(target, read_neural_fits(source))
