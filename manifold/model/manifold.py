"""The fitted manifold: latents of the materials of a library, and predictions from them."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from manifold.brdf.measured import BRDF, MeasuredBRDF, require_brdf
from manifold.library.store import Library
from manifold.mapping import Mapping, mapping_named
from manifold.model.combination import Combination
from manifold.model.decoding import encoder_at
from manifold.model.fitting import fit_space
from manifold.model.latent_map import LatentMap
from manifold.model.latent_space import Embedded, LatentSpace
from manifold.model.latents import Place, require_between
from manifold.model.left_out import LeftOut, leave_out
from manifold.model.materials import MaterialCache, names_among
from manifold.model.model_file import ModelRecord, read_model, write_model
from manifold.model.prediction import PredictedBRDF
from manifold.model.reconstruction import reconstruct
from manifold.model.reflectance import ReflectanceColours
from manifold.model.restoring import open_library, restore
from manifold.model.settings import Settings
from manifold.model.spaces import SPACES
from manifold.models.expected_error import LEAST_MATERIALS
from manifold.records import Array, Bands, Progress, evenly_spaced

_ONE = np.ones(1)
_DEFAULTS = Settings()


class LibraryChangedWarning(UserWarning):
    """A model was opened with another library than the one it was fitted to."""


class Manifold(LatentMap):
    """Latent coordinates of measured materials, and predictions at any coordinate.

    Attributes: those of `LatentMap`, and
        statistics: objective at start and end of the fit.
        notes: diagnostics that apply to all predictions, from `load`.
    """

    def __init__(
        self,
        materials: MaterialCache,
        space: LatentSpace,
        settings: Settings,
        statistics: dict[str, float],
        left_out: LeftOut | None = None,
    ) -> None:
        """Use `fit` or `load`."""
        super().__init__(materials, space, settings, left_out)
        self.statistics = statistics
        self.notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        s, n = self.settings, len(self.names)
        return (
            f"<Manifold: {n} materials, {self.bands}, {s.latent_dim} dimensions, kind {s.kind}, "
            f"mapping {s.mapping}, kernel {self.space.kernel.name}, library {self.library.path.name}>"
        )

    @classmethod
    def fit(
        cls,
        library: Library | Path | str,
        settings: Settings = _DEFAULTS,
        on_progress: Progress | None = None,
        *,
        names: Collection[str] | None = None,
    ) -> Manifold:
        """Embed the materials of a library.

        Args:
            library: at least two materials, or the path of a library.
            settings: see `Settings`.
            on_progress: called with (done, total, what) while materials are read and evaluated.
            names: of the materials to embed, such as all but those that are held out; None for all of them.
        Raises:
            UsageError: fewer than two materials, more dimensions than materials less one, or no such material.
            LibraryError: there is no such library, or a material cannot be read.
        """
        if not isinstance(library, Library):
            library = Library.open(library)
        chosen = library.names if names is None else names_among(library, names)
        is_nonnegative = SPACES[settings.kind].is_nonnegative
        materials = MaterialCache(library, chosen, is_nonnegative=is_nonnegative)
        space, statistics = fit_space(materials, settings, on_progress)
        return cls(materials, space, settings, statistics)

    # -- materials -----------------------------------------------------------------------------------------

    @property
    def library(self) -> Library:
        """The library of the measured materials."""
        return self.materials.library

    @property
    def bands(self) -> Bands:
        """The spectral axis of the library."""
        return self.library.bands

    @cached_property
    def mapping(self) -> Mapping:
        """The mapping of BRDF values."""
        return mapping_named(self.settings.mapping)

    def material(self, name: str) -> MeasuredBRDF:
        """A measured material, as in its file.

        Raises:
            UsageError: the model has no such material.
            LibraryError: the library no longer has it.
        """
        return self.materials.measured(name)

    def prepare(self, on_progress: Progress | None = None, x: Array | None = None) -> None:
        """Load what predictions need: the materials, or, for a monochrome manifold, some of their bands.

        Args:
            on_progress: called with (done, total, what) while they are read.
            x: a latent (Q,): then, where materials have fixed colours, only those with a weight there are read.
        """
        if self.space.sample_bands is not None:
            self.materials.in_bands(self.space.sample_bands.tolist(), on_progress)
        elif x is None:
            self.materials.filled(on_progress=on_progress)
        else:
            used = np.flatnonzero(self.combination(x, None).weights)
            self.materials.filled([self.names[k] for k in used], on_progress)

    # -- expected errors ----------------------------------------------------------------------------------

    def calibrate(self, on_progress: Progress | None = None) -> None:
        """Calibrate the expected errors by leaving every material out once; takes seconds to minutes.

        Models of fewer than four materials are not changed.
        """
        if len(self.names) >= LEAST_MATERIALS:
            self.left_out = leave_out(self.space, self.materials, self.settings, on_progress)

    @cached_property
    def colours(self) -> ReflectanceColours:
        """Colours of predictions, by reflectances: what `predict` takes for a spectrum or another material's.

        Raises:
            UsageError: its materials have fixed colours.
        """
        return ReflectanceColours(self.space, self.materials, self.settings)

    # -- predicting ----------------------------------------------------------------------------------------

    def predict(self, x: Place, colours: Array | None = None) -> PredictedBRDF:
        """The BRDF at a latent x (Q,); at a training latent the measured one, bit for bit.

        Args:
            x: latent, the name of a material, or `FROM:TO:T` on the path between two, which `interpolate` predicts
                unless colours are given; of a monochrome manifold, the structure.
            colours: colour coordinate of every band, shape (B,), as `colours.of_reflectance` gives them; of blends
                also with gains, shape (2, B), as `embed` does. None blends the colours of the surrounding materials,
                and gives x on a monochrome manifold the reflectance of the nearest one.
        Raises:
            LatentError: x is not (Q,) or not finite.
            UsageError: colours for a manifold of kind `material`, or no such material.
            ShapeError: colours have another shape, are not finite, or are black in all bands.
        """
        path = self.path(x)
        if path is not None and colours is None:
            return self.interpolate(*path)
        x = self.require_latent(x)
        if colours is None and self.space.needs_colours:
            colours = self.colours.like(x, self.nearest(x)[0][0])
        combination = self.combination(x, colours)
        if combination.source is not None:
            return PredictedBRDF(
                [self.material(self.names[combination.source])], replace(combination, weights=_ONE)
            )
        if combination.sample_bands is not None:
            return PredictedBRDF(
                self.materials.in_bands(combination.sample_bands.tolist()), combination, self.bands
            )
        used = np.flatnonzero(combination.weights)
        materials = self.materials.filled([self.names[k] for k in used])
        return PredictedBRDF(materials, replace(combination, weights=combination.weights[used]))

    def combination(self, x: Array, colours: Array | None) -> Combination:
        """The weighted sum of a prediction at a latent x (Q,); at a training latent, that material alone."""
        return self.space.combination(x, self.space.require_colours(colours), self.mapping)

    def interpolate(self, a: str, b: str, t: float) -> PredictedBRDF:
        """The prediction between materials a (t = 0) and b (t = 1), at interpolated latents and reflectances.

        In a blend, a and b keep their colours; the other materials take on the reflectance between theirs. Where
        colours are fixed by latents, it is the prediction at the latent.

        Raises:
            UsageError: the model has no such material, or t is not from 0 to 1.
        """
        x = self.between(a, b, t)
        if not self.space.takes_colours:
            return self.predict(x)
        if a == b or t in (0.0, 1.0):
            name = b if t else a
            return self.predict(name, self.colours.like(x, name))
        reflectance = (1.0 - t) * self.colours.reflectance(a) + t * self.colours.reflectance(b)
        coloured = self.predict(x, self.colours.of_reflectance(x, reflectance)[0])
        if self.space.needs_colours:
            return coloured
        ends = [self.materials.index(a), self.materials.index(b)]
        shares = self.space.material_weights(x[None], None)[0, ends]
        weights = np.append(shares, max(1.0 - shares.sum(), 0.0))
        return PredictedBRDF([*self.materials.filled([a, b]), coloured], Combination(self.mapping, weights))

    def blend(self, a: str, b: str, t: float) -> PredictedBRDF:
        """The linear interpolation of measured values, the baseline of Hikichi & Iwasaki, eq. 23; as `interpolate`."""
        require_between(t)
        ends = self.materials.filled([a, b]) if 0 < t < 1 else [self.material(a), self.material(b)]
        return PredictedBRDF(ends, Combination(mapping_named("identity"), np.array([1.0 - t, t])))

    def embed(self, brdf: BRDF, criterion: str | None = None) -> Embedded:
        """Find the latent, and colours, whose decoded prediction is nearest to a material's data.

        Args:
            brdf: a material in the bands of the library.
            criterion: the objective, see `manifold.models.criteria`; by default that of the settings. Blends
                are always found by cube roots.
        Raises:
            BandMismatchError: it has other bands.
            UsageError: there is no such criterion.
        """
        require_brdf(brdf, "the material to embed")
        self.bands.require_same(brdf.bands, "the material to embed", "resample it, or use its own library")
        pairs = self.space.embedding_pairs(self.materials.is_isotropic and brdf.is_isotropic)
        encoder = encoder_at(pairs, self.space, self.materials, self.settings, criterion)
        return self.space.embed(encoder, brdf.eval(pairs.wi, pairs.wo).T)

    def reconstruct(self, brdf: BRDF) -> PredictedBRDF:
        """Non-negative least squares of a material over all samples and analytic lobes, in every band.

        It has no latent; see docs/design/nonnegative.md. Arguments and errors as of `embed`.
        """
        require_brdf(brdf, "the material to reconstruct")
        self.bands.require_same(
            brdf.bands, "the material to reconstruct", "resample it, or use its own library"
        )
        bands = evenly_spaced(self.bands.count, self.settings.sample_bands)
        return reconstruct(self.materials, bands, brdf)

    # -- files ---------------------------------------------------------------------------------------------

    def save(self, path: Path | str) -> None:
        """Write the model as HDF5, atomically.

        Raises:
            UsageError: the file cannot be written.
        """
        library, settings = self.library, dict(vars(self.settings))
        arrays = self.space.arrays | ({} if self.left_out is None else self.left_out.arrays)
        record = ModelRecord(
            library.path, library.content_hash, self.names, settings, self.statistics, arrays
        )
        write_model(Path(path), record)

    @classmethod
    def load(cls, path: Path | str, library: Library | Path | str | None = None) -> Manifold:
        """Read a model and open its library.

        Args:
            path: the model.
            library: path of the library, if it was moved.
        Raises:
            ModelError: no such file, no model of this package, another version, or damaged.
            LibraryError: the library is not there, or lacks materials of the model.
        Warns:
            LibraryChangedWarning: the library's content is not what the model was fitted to.
        """
        path = Path(path)
        stored = read_model(path)
        library = open_library(path, stored, library)
        settings, space, left_out = restore(path, stored)
        materials = MaterialCache(library, stored.names, is_nonnegative=space.is_nonnegative)
        model = cls(materials, space, settings, stored.statistics, left_out)
        if library.content_hash != stored.library_hash:
            change = (
                f"{library.path.name} is not what {path.name} was fitted to (hash {library.content_hash[:12]}, "
                f"expected {stored.library_hash[:12]}); predictions use the present files: embed again"
            )
            model.notes = (change,)
            warnings.warn(change, LibraryChangedWarning, stacklevel=2)
        return model
