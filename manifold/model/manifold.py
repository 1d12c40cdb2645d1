"""The fitted manifold: predictions from the latents of the materials of a library."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from html import escape
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manifold.brdf.interface import BRDF, require_brdf, require_values
from manifold.brdf.measured import MeasuredBRDF
from manifold.core import shipped
from manifold.core.errors import UnknownNameError, UsageError
from manifold.core.mapping import Identity, ValueMapping
from manifold.core.metrics import Errors
from manifold.core.names import names_like
from manifold.core.records import Array, Bands, Indices, Mask, evenly_spaced, plain
from manifold.gpr import GaussianProcess, LengthScaleBound
from manifold.model.blend_space import BlendSpace
from manifold.model.colours import NEAREST, UNCHOSEN, ChosenColour, ColourChoice, ReflectanceColours
from manifold.model.combination import Combination
from manifold.model.decoding import decoder_at
from manifold.model.embedding import Embedding, LibraryChangedWarning
from manifold.model.gplvm_space import GplvmSpace
from manifold.model.gram import Gram
from manifold.model.landmarks import LandmarkSearch, SamplesOnDemand
from manifold.model.latent_space import Embedded, fixed_colours
from manifold.model.map import map_svg
from manifold.model.materials import MaterialCache
from manifold.model.places import (
    Place,
    PlaceLike,
    on_line,
    parse_coordinates,
    parse_walk,
    require_between,
    require_latent,
    require_latents,
)
from manifold.model.prediction import PredictedBRDF
from manifold.model.reconstruction import reconstruct
from manifold.model.settings import SAMPLE_BANDS, GplvmSettings
from manifold.model.walks import Walk, Walked
from manifold.registries import MAPPINGS

_ONE = np.ones(1)

S = TypeVar("S", bound=np.generic)

_PICTURED = 80  # materials with ball and name in a picture of thousands
EXTRAPOLATION = 0.5  # share of the prior variance above which a latent counts as extrapolated


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior standard deviation of the Gaussian process at one or several latents.

    Attributes:
        std: posterior standard deviation, in `unit`, a number or shape (M,).
        relative: posterior over prior standard deviation, a number or shape (M,).
        unit: text that names the outputs of the process.
    """

    std: Array
    relative: Array
    unit: str

    @property
    def words(self) -> str:
        """Return a text that states the standard deviation at one latent."""
        return f"{self.std:.3g} of {self.unit}; {self.relative:.2g} of the prior's"

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain values for JSON."""
        return plain(vars(self))


class Manifold(Embedding):
    """Latent coordinates of measured materials, and predictions at any coordinate.

    Attributes: those of `Embedding`.
    """

    def __init__(self, *fitted: Any) -> None:
        """Use `fit` or `load`.

        Raises:
            UsageError: it is called with a path or a library.
        """
        if not fitted or not isinstance(fitted[0], MaterialCache):
            found = ", ".join(map(repr, fitted))
            raise UsageError(
                f"Manifold({found}): use Manifold.load(path) to load a model, such as 'built-in', or "
                "Manifold.fit(library) to fit one"
            )
        super().__init__(*fitted)
        self._walked: dict[str, Walked] = {}
        self._searches: dict[bool, LandmarkSearch] = {}  # keys: whether all materials are isotropic

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to other processes without materials, which these read from the library."""
        fitted = self.materials, self.space, self.settings, self.statistics, self.left_out
        return type(self), fitted, {"notes": self.notes}

    def __repr__(self) -> str:
        s, n = self.settings, len(self.names)
        return (
            f"<Manifold: {n} materials, {self.bands}, {s.latent_dim} dimensions, kind {s.kind}, "
            f"mapping {s.mapping}, kernel {self.space.kernel.name}, library {self.library.path.name}>"
        )

    def _repr_html_(self) -> str:
        return f"<div>{escape(repr(self))}</div>{map_svg(self.X, self.names)}"

    # -- the map -------------------------------------------------------------------------------------------

    @property
    def landmarks(self) -> Indices:
        """Return the indices of the landmarks, or of all materials if there are none, shape (M,)."""
        return np.arange(len(self.names)) if self.space.landmarks is None else self.space.landmarks

    @property
    def pictured(self) -> Indices:
        """Return the materials that a picture shows as named balls: all, or 80 landmarks that cover the map."""
        return self.landmarks if self.space.landmarks is None else self.landmarks[:_PICTURED]

    @property
    def gp(self) -> GaussianProcess:
        """Return the Gaussian process on the latents of the materials; predictions of blends use only its variance."""
        return self.space.gp

    def weights(self, x: ArrayLike | PlaceLike, colours: Array | None = None) -> Array:
        """Return the weights of the materials at a point or latents x (M, Q), shape (N,) or (M, N); they sum to 1."""
        return self._at(x, colours, self.space.material_weights)

    def std(self, x: ArrayLike | PlaceLike, colours: Array | None = None) -> Array:
        """Return the posterior over the prior standard deviation at a point or latents x (M, Q), from 0 to 1."""
        return np.sqrt(self._at(x, colours, self.space.variance_fraction))

    def posterior(self, x: ArrayLike | PlaceLike) -> Posterior:
        """Return the posterior standard deviation at a point (Q,) or latents x (M, Q), in the unit of the outputs.

        The outputs of the process are `sqrt(cos(theta_i) cos(theta_o)) T(f)`, or `T(f)` in the published method, with
        the mapping T and f in 1/sr. All outputs share one variance.

        Raises:
            UsageError: the model is of kind blend, whose predictions are not those of a Gaussian process.
        Source: Hikichi & Iwasaki, eq. 12.
        """
        space, settings = self._whole_materials(), self.settings
        assert isinstance(settings, GplvmSettings)
        variance = settings.output_variance or space.gp.output_variance(space.S, space.n_outputs)
        relative = self.std(x)
        prior = np.sqrt(variance * space.kernel.prior_variance)
        weight = "" if settings.as_published else "sqrt(cos(theta_i) cos(theta_o)) "
        return Posterior(prior * relative, relative, f"{weight}T(f), T = {settings.mapping}, f in 1/sr")

    def is_extrapolation(self, x: ArrayLike | PlaceLike, colours: Array | None = None) -> Mask:
        """Return whether the data do not support predictions at a point (Q,) or latents x (M, Q).

        See `LeftOut.is_unsupported`. For a model that is not calibrated, the result is whether the posterior variance
        exceeds half of the prior variance. A step of a walk is never an extrapolation.
        """
        left_out = self.left_out
        if self._is_step(x, colours):
            return np.zeros((), dtype=bool)
        if left_out is None:
            return self._at(x, colours, self.space.variance_fraction) > EXTRAPOLATION
        is_predicted = self._at(x, colours, self.space.training_indices) < 0
        return is_predicted & self._at(x, None, lambda X, _: left_out.is_unsupported(X))

    def expected_error(
        self, x: ArrayLike | PlaceLike, colours: Array | None = None, residual: float | None = None
    ) -> Errors[Array] | None:
        """Return the expected errors of predictions at a point (Q,) or latents x (M, Q).

        They hold for a material with the given colours or, without colours, with colours blended from the surrounding
        materials. They are 0 at a material's own latent, where the prediction is its file. The result is None if the
        model is not calibrated, and for a step of a walk, which does not use the map. `residual` is the residual of
        an `Embedded` material, which makes the estimate more accurate.
        """
        if self.left_out is None or self._is_step(x, colours):
            return None
        found = self.left_out.expected(self._latents(x), residual, is_colour_known=colours is not None)
        if residual is not None:
            return found
        is_predicted = self._at(x, colours, self.space.training_indices) < 0
        return Errors(found.ball * is_predicted, found.cube_root * is_predicted)

    def nearest(self, x: PlaceLike, count: int = 1) -> list[tuple[str, float]]:
        """Return the materials nearest to a latent x (Q,) with their distances, nearest first.

        Raises:
            UsageError: `count` is below 1.
        """
        if count < 1:
            raise UsageError(f"found {count} nearest materials to return, expected at least 1")
        distance = np.linalg.norm(self.space.X - self.place(x).latent, axis=1)
        return [(self.names[k], float(distance[k])) for k in np.argsort(distance, kind="stable")[:count]]

    def largest_weights(
        self, x: PlaceLike, count: int, colours: Array | None = None
    ) -> list[tuple[str, float]]:
        """Return the materials with the largest nonzero weights at a latent x (Q,), by magnitude."""
        weights = self.weights(x, colours)
        order = np.argsort(-np.abs(weights), kind="stable")[:count]
        return [(self.names[k], float(weights[k])) for k in order if weights[k] != 0]

    def unmeasured_share(self, x: PlaceLike, colours: Array | None = None) -> float:
        """Return the share of unmeasured cells at a point x, averaged over materials by magnitude of weight.

        For a step of a walk it is averaged over the two materials by t.
        """
        place = self.place(x)
        if place.walk is not None and place.is_step(colours):
            start, end, t = place.walk
            of_ends = [
                self.materials.unmeasured_share(name) if name in self.names else 0.0 for name in (start, end)
            ]
            return (1.0 - t) * of_ends[0] + t * of_ends[1]
        weights = np.abs(self.weights(place))
        shares = [self.materials.unmeasured_share(self.names[k]) for k in np.flatnonzero(weights)]
        return float(weights[weights > 0] @ shares / weights.sum())

    def latent(self, name: str) -> Array:
        """Return the latent of a material, shape (Q,)."""
        return self.X[self.materials.index(name)].copy()

    def between(self, a: str, b: str, t: float) -> Array:
        """Return the latent on the straight line from material a (t = 0) to b (t = 1), shape (Q,)."""
        require_between(t)
        return on_line(self.latent(a), self.latent(b), t)

    def place(self, x: PlaceLike) -> Place:
        """Return the point that a latent or a text denotes."""
        if isinstance(x, Place):
            return x
        if not isinstance(x, str):
            return Place(require_latent(x, self.settings.latent_dim))
        walk = parse_walk(x, self.names)
        if walk is not None:
            start, end, t = walk
            is_end = start == end or t in (0.0, 1.0)  # a material, which lies on the map
            return Place(self.between(start, end, t), None if is_end else walk)
        if x in self.names:
            return Place(self.latent(x))
        coordinates = parse_coordinates(x)
        if coordinates is None:
            raise UnknownNameError(
                f"'{x}' is neither a material of this model ({names_like(self.names, x)}), nor coordinates such as "
                "-0.3,1.2, nor FROM:TO:T between two materials"
            )
        return Place(require_latent(coordinates, self.settings.latent_dim))

    def _is_step(self, x: ArrayLike | PlaceLike, colours: Array | None) -> bool:
        return isinstance(x, Place | str) and self.place(x).is_step(colours)

    def _latents(self, x: ArrayLike | PlaceLike) -> Array:
        if isinstance(x, Place | str):
            return self.place(x).latent
        return require_latents(x, self.settings.latent_dim)

    def _at(
        self,
        x: ArrayLike | PlaceLike,
        colours: Array | None,
        function: Callable[[Array, Array | None], NDArray[S]],
    ) -> NDArray[S]:
        """Apply a function of latents (M, Q) and colours to one latent or several."""
        X, colours = self._latents(x), self.space.require_colours(colours)
        return function(X[None], colours)[0] if X.ndim == 1 else function(X, colours)

    # -- materials -----------------------------------------------------------------------------------------

    @property
    def bands(self) -> Bands:
        """Return the spectral bands of the library."""
        return self.library.bands

    @cached_property
    def mapping(self) -> ValueMapping:
        """Return the mapping of BRDF values."""
        return MAPPINGS[self.settings.mapping]

    def material(self, name: str) -> MeasuredBRDF:
        """Return a measured material as predictions use it, with its unmeasured cells filled.

        See docs/explanation/gplvm.md. `library.read(name)` returns the file itself.

        Raises:
            UsageError: the model has no such material.
            LibraryError: the library no longer has it.
        """
        return self.materials.measured(name)

    def prepare(self) -> None:
        """Load the materials, which all predictions need."""
        self.materials.filled()

    # -- predicting ----------------------------------------------------------------------------------------

    @cached_property
    def colours(self) -> ReflectanceColours:
        """Return the converter from reflectances or material names to the colour coordinates that `predict` takes.

        Raises:
            UsageError: the colours of this kind of model cannot be changed.
        """
        return ReflectanceColours(self.space, self.materials, self.settings)

    def choose_colour(self, x: PlaceLike, choice: ColourChoice) -> ChosenColour:
        """Return the colour coordinates that give the prediction at a point x the given colour."""
        if not self.space.takes_colours:
            if choice != NEAREST:
                raise UsageError(fixed_colours(self.space.kind))
            return UNCHOSEN
        place = self.place(x)
        latent = place.latent
        if choice == NEAREST:
            around = "the surrounding materials" if place.walk is None else "the two materials of the walk"
            return ChosenColour(None, f"blended from {around}", 0.0)
        if choice.like is not None and not choice.is_like_file:
            colours = self.colours.like(latent, choice.like)
            reached, asked = self.colours.reached(latent, colours), self.colours.reflectance(choice.like)
            words = f"like {choice.like}"
        else:
            asked, words = choice.asked(self.bands)
            colours, reached = self.colours.of_reflectance(latent, asked)
        return ChosenColour(colours, words, float(np.abs(reached - asked).max()))

    @overload
    def predict(self, x: PlaceLike, colours: Array | None = None) -> PredictedBRDF: ...
    @overload
    def predict(
        self, x: Sequence[Array] | Sequence[Sequence[float]], colours: Array | None = None,
    ) -> list[PredictedBRDF]: ...  # fmt: skip
    def predict(self, x: Any, colours: Array | None = None) -> PredictedBRDF | list[PredictedBRDF]:
        """Return the predicted BRDF at a latent x (Q,), or a list of predictions at latents (M, Q).

        At the latent of a material, the prediction equals `material`, bit for bit.

        Args:
            x: a latent, the name of a material, or `FROM:TO:T` for a step of the walk between two materials, which
                `interpolate` computes unless colours are given.
            colours: colour coordinate of every band, shape (B,), from `colours.of_reflectance`; for blends also with
                gains, shape (2, B), from `embed`. None blends the colours of the surrounding materials.

        Raises:
            LatentError: x does not have Q coordinates, or is not finite.
            UsageError: colours are given for a manifold of kind `gplvm`, or there is no such material.
            ShapeError: the colours have another shape, are negative or not finite, or are black in all bands.
        """
        # As objects, rows of different lengths are no error here; `place` reports them.
        if np.asarray(x, dtype=object).ndim == 2:
            return [self.predict(row, colours) for row in x]
        place = self.place(x)
        if place.walk is not None and place.is_step(colours):
            return self.interpolate(*place.walk)
        x = place.latent
        combination = self.combination(x, colours)
        if combination.source is not None:
            return PredictedBRDF(
                [self.material(self.names[combination.source])], replace(combination, weights=_ONE)
            )
        used, combination = combination.used
        names = [self.names[k] for k in used]
        if combination.sample_bands is None:
            return PredictedBRDF(self.materials.filled(names), combination)
        bands = combination.sample_bands.tolist()
        return PredictedBRDF(self.materials.in_bands(bands, names), combination, self.bands)

    def combination(self, x: Array, colours: Array | None) -> Combination:
        """Return the materials and weights that predict at a latent x (Q,); see `LatentSpace.combination`."""
        return self.space.combination(x, self.space.require_colours(colours), self.mapping)

    def linear(self, a: str, b: str, alpha: float) -> PredictedBRDF:
        """Return the linear interpolation `alpha f_a + (1 - alpha) f_b` of raw values of materials a and b.

        Raises:
            UsageError: the model has no such material, or alpha is not finite.
        Source: Hikichi & Iwasaki, eq. 23.
        """
        if not np.isfinite(alpha):
            raise UsageError(f"alpha is {alpha}, expected a finite number")
        return PredictedBRDF(
            self.materials.filled([a, b]), Combination(Identity(), np.array([alpha, 1.0 - alpha]))
        )

    @property
    def gram(self) -> Gram:
        """Return the Gram matrix of the mapped materials, not centred, and the number of outputs D.

        Raises:
            UsageError: the model is of kind blend, which has no Gram matrix.
        """
        space = self._whole_materials()
        return Gram(space.S, space.n_outputs)

    def eq15(self, x: Any) -> LengthScaleBound:
        """Return both sides of the bound on the length scale at latents x (Q,) or (M, Q).

        Raises:
            UsageError: the model is of kind blend.
        Source: Hikichi & Iwasaki, eq. 15.
        """
        places: list[PlaceLike] = list(x) if isinstance(x, np.ndarray) and x.ndim == 2 else [x]
        X = np.stack([self.place(place).latent for place in places])
        return self.gp.length_scale_bound(X, self._whole_materials().S)

    def _whole_materials(self) -> GplvmSpace:
        if not isinstance(self.space, GplvmSpace):
            raise UsageError(
                f"a model of kind {self.space.kind}, expected gplvm: embed the library with that kind"
            )
        return self.space

    def interpolate(self, a: str, b: str, t: float) -> PredictedBRDF:
        """Interpolate between material a (t = 0) and material b (t = 1), using only these two; see `model.walks`.

        Equal steps in t look equally large, and the roughness changes from one material to the other. The map is not
        used; `predict(between(a, b, t))` predicts from the line between both on the map instead.

        Raises:
            UsageError: the model has no such material, or t is not from 0 to 1.
        """
        require_between(t)
        if a == b or t in (0.0, 1.0):
            return PredictedBRDF([self.material(b if t else a)], Combination(self.mapping, _ONE))
        start, end = self.materials.filled([a, b])
        return Walk((start, end), (self.walked(a), self.walked(b))).at(t)

    def walked(self, name: str) -> Walked:
        """Return a material prepared as the end of a walk; the result is cached."""
        if name not in self._walked:
            self._walked[name] = Walked.of(self.materials.filled([name])[0])
        return self._walked[name]

    def embed(self, brdf: BRDF) -> Embedded:
        """Find the latent and colours whose prediction is nearest to a material's data.

        Args:
            brdf: a material in the bands of the library.

        Raises:
            BandMismatchError: the material has other bands than the library.
            ShapeError: its `eval` returns another shape, or values that are not finite.
        """
        require_brdf(brdf, "the material to embed")
        self.bands.require_same(brdf.bands, "the material to embed")
        is_isotropic = self.materials.is_isotropic and brdf.is_isotropic
        pairs = self.space.embedding_pairs(is_isotropic)
        f = brdf.eval(pairs.wi, pairs.wo)
        f = require_values(f, len(pairs), brdf.bands, "the material to embed").T
        if isinstance(self.space, BlendSpace) and self.space.landmarks is not None:
            if is_isotropic not in self._searches:
                samples = SamplesOnDemand(self.space, self.materials, pairs)
                self._searches[is_isotropic] = LandmarkSearch(self.space, samples)
            return self._searches[is_isotropic].embed(f)
        return self.space.embed(
            decoder_at(pairs, self.space, self.materials, self.settings), f, self.settings
        )

    def reconstruct(self, brdf: BRDF, numbers: int | None = None) -> PredictedBRDF:
        """Reconstruct a material by non-negative least squares over all samples and analytic lobes, in every band.

        The result has no latent; see docs/explanation/reconstruction.md.

        Args:
            brdf: the material, in the bands of the model.
            numbers: largest number of parameters of the description, for example 12; None sets no limit.

        Raises:
            UsageError: the material is black, or `numbers` is below 1.
            BandMismatchError: the material has other bands than the model.
            ShapeError: its `eval` returns another shape, or values that are not finite.
        """
        require_brdf(brdf, "the material to reconstruct")
        self.bands.require_same(brdf.bands, "the material to reconstruct")
        bands = evenly_spaced(self.bands.count, SAMPLE_BANDS)
        return reconstruct(self.materials, bands, brdf, numbers)


@lru_cache(maxsize=4)
def _model(path: Path, changed_ns: int, library: Path | None) -> tuple[Manifold, str]:
    """Open a model, cached because scenes are loaded often; return it and its library's content hash."""
    with warnings.catch_warnings(action="ignore", category=LibraryChangedWarning):  # see `load_model`
        loaded = Manifold.load(path, library)
    return loaded, loaded.library.content_hash


def load_model(model: Manifold | Path | str, library: Path | str | None) -> Manifold:
    """Load a model, or return it from a cache if its file and library are unchanged.

    A `Manifold` is returned as it is.
    """
    if isinstance(model, Manifold):
        return model
    path = shipped.resolved(model)
    file = shipped.model_file(path)
    changed = file.stat().st_mtime_ns if file.exists() else 0
    key = path, changed, None if library is None else shipped.resolved(library)
    loaded, content_hash = _model(*key)
    if loaded.library.content_hash != content_hash:
        _model.cache_clear()
        loaded, _ = _model(*key)
    for note in loaded.notes:
        warnings.warn(note, LibraryChangedWarning, stacklevel=2)
    return loaded


def built_in() -> Manifold:
    """Return the built-in model of 20 measured RGB materials of the RGL database (Dupuy & Jakob, CC0 1.0)."""
    return Manifold.load(shipped.BUILT_IN)
