"""The fitted manifold: latents of the materials of a library, and what they predict. This module alone imports h5py.

The file holds N latents, N weights' worth of a Gram matrix and a few settings. The measured data stay in the
library, which is named by the hash of its content.
"""

from __future__ import annotations

import difflib
import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from manifold import atomic, gram
from manifold.brdf import MeasuredBRDF
from manifold.errors import LatentError, LibraryError, ManifoldError, ModelError, UsageError
from manifold.gplvm import GPLVM
from manifold.gpr import GPWeights
from manifold.mapping import Mapping, mapping_named
from manifold.metrics import RusinkiewiczGrid
from manifold.prediction import PredictedBRDF
from manifold.records import Array, Bands
from manifold.store import Library

FORMAT = "manifold-model"
FORMAT_VERSION = 1
LARGEST_COORDINATE = 1e9  # latents are of order one; far larger ones overflow when squared
EXTRAPOLATION = 0.5  # share of the prior variance above which a latent counts as extrapolated

Progress = Callable[[int, int, str], None]


class LibraryChangedWarning(UserWarning):
    """A model was opened with a library that is not the one it was fitted to."""


@dataclass(frozen=True)
class Settings:
    """How a manifold was fitted.

    Attributes:
        latent_dim: Q.
        mapping: name of the mapping.
        optimizer: `dls` or `l-bfgs`.
        mu: noise filter of the kernel.
        length_scale: l, in units of the latents.
        grid: name of the grid of direction pairs behind the Gram matrix.
    """

    latent_dim: int = 2
    mapping: str = "cube-root"
    optimizer: str = "dls"
    mu: float = 1e-4
    length_scale: float = 1.0
    grid: str = "default"


class Manifold:
    """Latent coordinates of measured materials, and predictions at any coordinate.

    Attributes:
        library: the measured materials.
        names: material names in the order of the latents, N of them.
        X: latents, shape (N, Q).
        S: Gram matrix of the mapped materials, not centred, shape (N, N).
        n_outputs: D, the outputs behind S.
        settings: how it was fitted.
        statistics: objective at start and end, evaluations.
    """

    def __init__(
        self,
        library: Library,
        names: tuple[str, ...],
        X: Array,
        S: Array,
        n_outputs: int,
        settings: Settings,
        statistics: dict[str, float],
    ) -> None:
        """Use `fit` or `load`."""
        self.library = library
        self.names = names
        self.X = X
        self.S = S
        self.n_outputs = n_outputs
        self.settings = settings
        self.statistics = statistics

    @classmethod
    def fit(
        cls, library: Library, settings: Settings = Settings(), on_progress: Progress | None = None
    ) -> Manifold:
        """Embed all materials of a library.

        Args:
            library: at least two materials.
            settings: see `Settings`.
            on_progress: called with (done, total, what) while materials are read and evaluated.
        Raises:
            UsageError: fewer than two materials, or more dimensions than materials less one.
            LibraryError: a material cannot be read.
        """
        names = library.names
        if len(names) < 2:
            raise UsageError(
                f"{library.path.name}: found {len(names)} material{'s' * (len(names) != 1)}, "
                "expected at least 2; import more"
            )
        if not 1 <= settings.latent_dim < len(names):
            most = len(names) - 1
            raise UsageError(
                f"{settings.latent_dim} latent dimensions for {len(names)} materials, "
                f"expected {'1' if most == 1 else f'1 to {most}'}; lower --latent-dim or import more"
            )
        mapping, grid = mapping_named(settings.mapping), RusinkiewiczGrid.named(settings.grid)
        model = cls(library, names, np.empty((len(names), 0)), np.empty((0, 0)), 0, settings, {})
        key = gram.cache_key(library.content_hash, mapping, grid)
        cached = library.cache_get(key)
        if cached is None:
            matrix = gram.gram_matrix(model.load_materials(on_progress), mapping, grid, on_progress)
            library.cache_put(key, {"S": matrix.S, "n_outputs": np.array([matrix.n_outputs])})
            model.S, model.n_outputs = matrix.S, matrix.n_outputs
        else:
            model.S, model.n_outputs = cached["S"], int(cached["n_outputs"][0])
        latent = model._gplvm().fit_gram(model.S, model.n_outputs)
        model.X = latent.embedding_
        model.statistics = {
            "objective_start": float(latent.objective_start_),
            "objective": float(latent.objective_),
            "n_evaluations": float(latent.n_evaluations_),
        }
        return model

    def _gplvm(self) -> GPLVM:
        """An unfitted latent variable model with these settings."""
        return GPLVM(
            self.settings.latent_dim,
            mu=self.settings.mu,
            length_scale=self.settings.length_scale,
            optimizer=self.settings.optimizer,
        )

    @property
    def bands(self) -> Bands:
        """The spectral axis of the library."""
        return self.library.bands

    @cached_property
    def mapping(self) -> Mapping:
        """The mapping of BRDF values."""
        return mapping_named(self.settings.mapping)

    @cached_property
    def gp(self) -> GPWeights:
        """The Gaussian process of the latents."""
        return GPWeights(self.X, self.settings.mu, self.settings.length_scale)

    @cached_property
    def _materials(self) -> dict[str, MeasuredBRDF]:
        return {}

    def material(self, name: str) -> MeasuredBRDF:
        """A measured material, read from the library when first asked for.

        Raises:
            UsageError: the model has no such material.
            LibraryError: the library has lost it.
        """
        self._index(name)
        if name not in self._materials:
            self._materials[name] = MeasuredBRDF(self.library.read(name))
        return self._materials[name]

    def _index(self, name: str) -> int:
        if name not in self.names:
            near = difflib.get_close_matches(name, self.names, 3) or self.names
            raise UsageError(f"no material '{name}' in this model; near are {', '.join(near)}")
        return self.names.index(name)

    def load_materials(self, on_progress: Progress | None = None) -> list[MeasuredBRDF]:
        """All measured materials in the order of the latents."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            loaded = []
            for done, material in enumerate(pool.map(self.material, self.names), start=1):
                loaded.append(material)
                if on_progress is not None:
                    on_progress(done, len(self.names), material.name)
        return loaded

    def weights(self, x: Array) -> Array:
        """Weights v of the materials at latents x (M, Q) or (Q,), shape (M, N) or (N,)."""
        return self._at(x, self.gp.weights)

    def std(self, x: Array) -> Array:
        """Posterior standard deviation at latents x (M, Q) or (Q,), as a fraction of the prior's, in [0, 1]."""
        return self._at(x, lambda X: np.sqrt(self.gp.variance_fraction(X)))

    def is_extrapolation(self, x: Array) -> Array:
        """Whether the posterior variance at x is over half of the prior's: the data say little there."""
        return self._at(x, lambda X: self.gp.variance_fraction(X) > EXTRAPOLATION)

    def nearest(self, x: Array, count: int = 1) -> list[tuple[str, float]]:
        """The materials nearest to a latent x (Q,) with their distances, nearest first."""
        distance = np.linalg.norm(self.X - self.require_latent(x), axis=1)
        return [(self.names[k], float(distance[k])) for k in np.argsort(distance, kind="stable")[:count]]

    def largest_weights(self, x: Array, count: int) -> list[tuple[str, float]]:
        """The materials with the largest weights at a latent x (Q,), by magnitude; none that is zero."""
        weights = self.weights(self.require_latent(x))
        order = np.argsort(-np.abs(weights), kind="stable")[:count]
        return [(self.names[k], float(weights[k])) for k in order if weights[k] != 0]

    def latent(self, name: str) -> Array:
        """The latent of a material, shape (Q,).

        Raises:
            UsageError: the model has no such material.
        """
        return self.X[self._index(name)].copy()

    def between(self, a: str, b: str, t: float) -> Array:
        """The latent on the straight line from material a (t = 0) to b (t = 1), shape (Q,)."""
        return (1.0 - t) * self.latent(a) + t * self.latent(b)

    def predict(self, x: Array) -> PredictedBRDF:
        """The BRDF at a latent x (Q,); at a training latent the measured one, bit for bit.

        Raises:
            LatentError: x is not (Q,) or not finite.
        """
        weights = self.weights(self.require_latent(x))
        if np.count_nonzero(weights) > 1:
            self.load_materials()
        names = [name for name, weight in zip(self.names, weights, strict=True) if weight]
        return PredictedBRDF([self.material(name) for name in names], weights[weights != 0], self.mapping)

    def require_latent(self, x: Array | Sequence[float]) -> Array:
        """A latent as float64 (Q,), or a LatentError that says how many coordinates were expected."""
        x = np.asarray(x, dtype=np.float64)
        if x.shape != (self.settings.latent_dim,) or not np.all(np.isfinite(x)):
            raise LatentError(
                f"latent {np.array2string(x, separator=', ')}: found {x.size} coordinates, "
                f"expected {self.settings.latent_dim} finite ones; give as many as the model has dimensions"
            )
        if np.any(np.abs(x) > LARGEST_COORDINATE):
            raise LatentError(
                f"latent {np.array2string(x, separator=', ')}: expected coordinates up to {LARGEST_COORDINATE:g}; "
                "the materials lie within a few units of zero"
            )
        return x

    def _at(self, x: Array, function: Callable[[Array], Array]) -> Array:
        x = np.asarray(x, dtype=np.float64)
        return function(np.atleast_2d(x))[0] if x.ndim == 1 else function(x)

    def save(self, path: Path | str) -> None:
        """Write the model as HDF5, atomically.

        Raises:
            UsageError: the file cannot be written.
        """
        path = Path(path)
        with atomic.replacing(path) as partial, h5py.File(partial, "w") as file:
            self._write(file, path)

    def _write(self, file: h5py.File, path: Path) -> None:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        # Relative to the model, so that a folder with both can be moved.
        file.attrs["library"] = os.path.relpath(self.library.path.resolve(), path.resolve().parent)
        file.attrs["library_hash"] = self.library.content_hash
        for name, value in vars(self.settings).items():
            file.attrs[f"settings.{name}"] = value
        for name, value in self.statistics.items():
            file.attrs[f"statistics.{name}"] = value
        file.attrs["n_outputs"] = self.n_outputs
        file.create_dataset("names", data=np.array(self.names, dtype=h5py.string_dtype()))
        file.create_dataset("X", data=self.X)
        file.create_dataset("S", data=self.S)

    @classmethod
    def load(cls, path: Path | str, library: Library | Path | str | None = None) -> Manifold:
        """Read a model and open its library.

        Args:
            path: the model.
            library: where the library is now, if not where the model remembers it.
        Raises:
            ModelError: no such file, no model of this package, another version, or damaged.
            LibraryError: the library is not there, or lacks materials of the model.
        Warns:
            LibraryChangedWarning: the library's content is not what the model was fitted to.
        """
        path = Path(path)
        stored = _read_model(path)
        if library is None:
            library = Path(os.path.normpath(path.resolve().parent / stored["library"]))
            if not library.exists():
                raise LibraryError(f"{path}: its library is not at {library}; say where with --library")
        if not isinstance(library, Library):
            library = Library.open(library)
        missing = sorted(set(stored["names"]) - set(library.names))
        if missing:
            shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
            raise LibraryError(
                f"{library.path.name} lacks {len(missing)} of the {len(stored['names'])} materials of {path.name} "
                f"({shown}); import them again, name the right library with --library, or embed again"
            )
        if library.content_hash != stored["library_hash"]:
            warnings.warn(
                f"{library.path.name} is not what {path.name} was fitted to (hash {library.content_hash[:12]}, "
                f"expected {stored['library_hash'][:12]}); predictions use the present files: embed again",
                LibraryChangedWarning,
                stacklevel=2,
            )
        return cls(
            library, stored["names"], stored["X"], stored["S"], stored["n_outputs"], stored["settings"],
            stored["statistics"],
        )  # fmt: skip


def _read_model(path: Path) -> dict[str, Any]:
    """The content of a model file, checked."""
    if not path.exists():
        raise ModelError(f"{path}: no such model; `manifold embed --model {path}` makes one")
    if not path.is_file() or not h5py.is_hdf5(path):
        what = "a folder" if path.is_dir() else "no HDF5 file, or cut off at its beginning"
        raise ModelError(f"{path}: {what}, expected a model; `manifold embed` makes one")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise ModelError(f"{path}: an HDF5 file, but no manifold model; `manifold embed` makes one")
            version = int(file.attrs["format_version"])
            if version != FORMAT_VERSION:
                raise ModelError(
                    f"{path}: model format {version}, expected {FORMAT_VERSION}; embed again with this version"
                )
            attributes = dict(file.attrs)
            content = {
                "library": str(attributes["library"]),
                "library_hash": str(attributes["library_hash"]),
                "names": tuple(file["names"].asstr()[...].tolist()),
                "X": file["X"][...].astype(np.float64),
                "S": file["S"][...].astype(np.float64),
                "n_outputs": int(attributes["n_outputs"]),
                "settings": Settings(
                    **{name: _plain(attributes[f"settings.{name}"]) for name in Settings.__dataclass_fields__}
                ),
                "statistics": {
                    name.removeprefix("statistics."): float(value)
                    for name, value in attributes.items()
                    if name.startswith("statistics.")
                },
            }
    except ManifoldError:
        raise
    except (OSError, KeyError, TypeError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise ModelError(f"{path}: not a readable model ({reason}); embed again") from error
    _require_consistent(path, content)
    return content


def _plain(value: Any) -> Any:
    """A NumPy scalar or HDF5 string as a Python value."""
    return value.item() if isinstance(value, np.generic) else value


def _require_consistent(path: Path, content: dict[str, Any]) -> None:
    n, q = len(content["names"]), content["settings"].latent_dim
    for name, shape in (("X", (n, q)), ("S", (n, n))):
        found = content[name]
        if found.shape != shape or not np.all(np.isfinite(found)):
            raise ModelError(
                f"{path}: dataset '{name}' has shape {found.shape}, expected {shape} and finite; embed again"
            )
