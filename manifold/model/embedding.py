"""Embeds the materials of a library in a low-dimensional space; saves the result as a model file, and loads it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core import disk, progress, work
from manifold.core.defaults import MOST_LAID_OUT
from manifold.core.directions import from_spherical
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.names import counted
from manifold.core.records import Array, evenly_spaced
from manifold.core.threads import one_blas_thread
from manifold.library.store import Library
from manifold.model.blend_fitting import BlendSamples, BlendTables, evaluate, fit_landmarks
from manifold.model.coherence import Coherence
from manifold.model.expected_error import LEAST_MATERIALS, LeftOut, leave_out
from manifold.model.gplvm_space import fit_gplvm
from manifold.model.latent_space import LatentSpace, Statistics
from manifold.model.materials import MaterialCache, names_among, names_without
from manifold.model.model_file import (
    OLD_LAYOUT,
    SPACES,
    ModelRecord,
    open_library,
    read_model,
    restore,
    write_model,
)
from manifold.model.settings import BlendSettings, GplvmSettings, Settings

_DEFAULTS = BlendSettings()
_LIT_DEG = np.array([0.0, 45.0])  # incidences of the albedos that are compared with `_MOST_ALBEDO`
# Measured materials reach a little above 1; reflectance factors taken for f are pi times as large.
_MOST_ALBEDO = 1.5


class LibraryChangedWarning(UserWarning):
    """Warns that a model was opened with another library than the one to which it was fitted."""


class BrightMaterialWarning(UserWarning):
    """Warns that the directional albedo of a measured material is far above 1, so its unit or measurement is wrong."""


class Embedding:
    """The content of a model file: materials in a latent space, with the settings and statistics of the fit.

    Attributes:
        materials: the materials, read when they are needed.
        names: names of the N materials, in the order of the latents.
        space: the latent space.
        settings: settings of the fit, `BlendSettings` or `GplvmSettings`.
        statistics: the measures of `coherence`; for a GPLVM also the objective at the start and end of the fit.
        left_out: latents and errors of left-out materials; None for a model that is not calibrated.
        notes: diagnostics that apply to all predictions, from `load`.
    """

    def __init__(
        self,
        materials: MaterialCache,
        space: LatentSpace,
        settings: Settings,
        statistics: Statistics,
        left_out: LeftOut | None = None,
    ) -> None:
        """Use `fit` or `load`."""
        self.materials = materials
        self.names = materials.names
        self.space = space
        self.space.X.setflags(write=False)
        self.settings = settings
        self.left_out = left_out
        self.statistics = statistics
        self.notes: tuple[str, ...] = ()

    @classmethod
    def fit(
        cls,
        library: Library | Path | str,
        settings: Settings = _DEFAULTS,
        *,
        names: Collection[str] | None = None,
        latents: Array | None = None,
        calibrate: bool = True,
    ) -> Self:
        """Embed the materials of a library, then leave each of them out once to calibrate the expected errors.

        Args:
            library: a library of at least two materials, or its path.
            settings: `BlendSettings` or `GplvmSettings`.
            names: names of the materials to embed; None embeds all.
            latents: latents from a dimensionality reduction of your own, shape (N, Q), in the order of the library;
                they are not changed. Only with `GplvmSettings`.
            calibrate: False saves the time of leaving materials out; there are then no expected errors. Fewer than
                four materials have no expected errors either.

        Raises:
            UsageError: there are fewer than two materials, or more dimensions than materials less one; a name is
                unknown; or latents are given for a map of blends.
            ShapeError: the latents have another shape, or are not finite.
            LibraryError: there is no such library, or a material cannot be read.
        """
        if not isinstance(library, Library):
            library = Library.open(library)
        chosen = library.names if names is None else names_among(library, names)
        _require_enough(library, len(chosen), settings)
        is_nonnegative = SPACES[settings.kind].is_nonnegative
        materials = MaterialCache(
            library, chosen, is_nonnegative=is_nonnegative, fills_cells=settings.fills_cells
        )
        space: LatentSpace
        samples, left_out = None, None
        # A layout amplifies the rounding of sums, which depends on the number of threads.
        with one_blas_thread:
            if isinstance(settings, GplvmSettings):
                for material in materials.filled():
                    _warn_if_bright(material)
                space, statistics = fit_gplvm(materials, settings, latents)
            else:
                assert isinstance(settings, BlendSettings)
                if latents is not None:
                    raise UsageError(
                        "latents are given for kind blend, which computes its own; leave them out, or use kind gplvm"
                    )
                space, statistics, samples = _fit_blends(materials, settings)
            if calibrate and len(chosen) >= LEAST_MATERIALS:
                left_out, coherence = leave_out(space, materials, settings, samples)
                statistics |= {} if coherence is None else coherence.statistics
        return cls(materials, space, settings, statistics, left_out)

    @property
    def X(self) -> Array:
        """Return the latents of the materials, read-only, shape (N, Q)."""
        return self.space.X

    @property
    def coherence(self) -> Coherence | None:
        """Return how well the map keeps similar materials together.

        It is None for a model without calibration, or of version 0.4.
        """
        return Coherence.from_statistics(self.statistics)

    @property
    def library(self) -> Library:
        """Return the library of the measured materials."""
        return self.materials.library

    def save(self, path: Path | str) -> None:
        """Write the model to an HDF5 file, atomically.

        Raises:
            UsageError: the file cannot be written.
        """
        library, settings = self.library, self.settings.to_json()
        arrays = self.space.arrays | ({} if self.left_out is None else self.left_out.arrays)
        record = ModelRecord(
            library.path, library.content_hash, self.names, settings, self.statistics, arrays
        )
        write_model(Path(path), record)

    @classmethod
    def load(cls, path: Path | str, library: Library | Path | str | None = None) -> Self:
        """Read a model and open its library.

        Args:
            path: path of the model, or `built-in`.
            library: the library or its path, if the library was moved.

        Raises:
            UsageError: `path` is not a path.
            ModelError: the file does not exist, is not a model of this package, has another version, or is damaged.
            LibraryError: the library does not exist, or lacks materials of the model.

        Warns:
            LibraryChangedWarning: the library's content has changed since the model was fitted.
        """
        if not isinstance(path, Path | str):
            raise UsageError(f"found {type(path).__name__}, expected the path of a model, or 'built-in'")
        path = Path(path)
        stored = read_model(path)
        library = open_library(path, stored, library)
        settings, space, left_out = restore(path, stored)
        materials = MaterialCache(
            library, stored.names, is_nonnegative=space.is_nonnegative, fills_cells=settings.fills_cells
        )
        model = cls(materials, space, settings, stored.statistics, left_out)
        if stored.has_old_layout:
            model.notes = (f"{path.name}: {OLD_LAYOUT}",)
        if library.content_hash != stored.library_hash:
            change = (
                f"{library.path.name} differs from the library that {path.name} was fitted to "
                f"(hash {library.content_hash[:12]}, "
                f"expected {stored.library_hash[:12]}); predictions use the present files: embed again"
            )
            model.notes += (change,)
            warnings.warn(change, LibraryChangedWarning, stacklevel=2)
        return model


def embed(
    library: Path,
    model: Path,
    settings: Settings,
    *,
    without: Collection[str] = (),
    choose: Choice | None = None,
    workers: Executor | None = None,
) -> tuple[Embedding, list[Any]]:
    """Fit a manifold to the materials of a library except `without`, and save it, as `manifold embed` does.

    With workers, the fit runs as one task and reports no progress.

    Returns:
        The embedding, and the list of settings that `choose` tried; empty without `choose`.

    Raises:
        ManifoldError: the fit failed in the worker, or the worker ended unexpectedly.
    """
    if workers is not None:
        task = partial(_embed_there, library, settings=settings, without=tuple(without), choose=choose)
        with progress.shown("Embedding"):
            ((_, tried, failure),) = work.run(task, [model], workers)
        if tried is None:
            raise ManifoldError(failure)
        return Embedding.load(model, library), tried
    disk.require_writable(model)
    opened = Library(library)
    names = names_without(opened, without)
    candidates: list[Any] = []
    if choose is not None:
        with progress.shown("Reading materials"):
            read = progress.each(names, str)
            materials = [MeasuredBRDF(fill_unmeasured(opened.read(name))) for name in read]
        with progress.shown("Leaving materials out"):
            settings, candidates = choose(materials, settings)
    with progress.shown("Embedding"):
        fitted = Embedding.fit(opened, settings, names=names)
    fitted.save(model)
    return fitted, candidates


Choice = Callable[[Sequence[MeasuredBRDF], Settings], tuple[Settings, list[Any]]]
"""A function that chooses settings for materials and returns them with all that it tried.

`evaluate.selection.choose`.
"""


def _embed_there(library: Path, model: Path, **how: Any) -> list[Any]:
    return embed(library, model, **how)[1]


def _require_enough(library: Library, count: int, settings: Settings) -> None:
    """Raise UsageError unless `count` materials can be embedded with these settings."""
    most = count - 1
    if count < 2:
        raise UsageError(
            f"{library.path.name}: found {counted(count, 'material')}, expected at least 2; import more"
        )
    if settings.latent_dim > most:
        raise UsageError(
            f"{settings.latent_dim} latent dimensions for {count} materials, "
            f"expected {'1' if most == 1 else f'1 to {most}'}; choose fewer or import more"
        )
    if count > MOST_LAID_OUT and isinstance(settings, GplvmSettings):
        raise UsageError(
            f"{count} materials for kind {settings.kind}, expected at most {MOST_LAID_OUT}; use kind blend, or leave "
            "materials out"
        )


def _warn_if_bright(material: MeasuredBRDF) -> MeasuredBRDF:
    wi = from_spherical(np.deg2rad(_LIT_DEG), 0.0)
    some = evenly_spaced(material.bands.count, 3).tolist()
    most = float(material.select_bands(some).albedo(wi).max())
    if most > _MOST_ALBEDO:
        warnings.warn(
            f"{material.name} has a directional albedo of {most:.3g}, expected at most 1: check its unit, 1/sr, or "
            "exclude it; it is fitted unchanged",
            BrightMaterialWarning,
            stacklevel=4,
        )
    return material


def _fit_blends(
    materials: MaterialCache, s: BlendSettings
) -> tuple[LatentSpace, Statistics, BlendSamples | None]:
    """Return a map of blends, no statistics, and of a map by landmarks the samples that it was fitted to."""
    bands, samples = evenly_spaced(materials.library.bands.count, s.sample_bands), None
    count = s.landmarks_of(len(materials.names))
    if count < len(materials.names):
        read = map(_warn_if_bright, materials.stream())
        appearance, samples = evaluate(read, bands, materials.is_isotropic)
        space = fit_landmarks(appearance, samples, count, s.latent_dim, s.covariance())
    else:
        brdfs = [_warn_if_bright(material) for material in materials.filled()]
        space = BlendTables.of(brdfs, bands).fit(s.latent_dim, s.covariance())
    return space, {}, samples
