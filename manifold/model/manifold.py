"""The fitted manifold: latents of the materials of a library, and what they predict."""

from __future__ import annotations

import difflib
import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial.distance import cdist

from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.brdf.unmeasured import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.directions import from_spherical
from manifold.errors import LatentError, LibraryError, ShapeError, UsageError
from manifold.gplvm import GPLVM, OPTIMIZERS
from manifold.gpr import GPWeights
from manifold.library.store import Library
from manifold.mapping import Mapping, mapping_named
from manifold.metrics import RusinkiewiczGrid
from manifold.model import gram
from manifold.model.model_file import ModelRecord, damaged, read_model, write_model
from manifold.model.prediction import Mixture, MonochromePrediction, PredictedBRDF
from manifold.model.spaces import KINDS, CurveSpace, MaterialSpace
from manifold.models.encoding import Decoder, EncodingPairs
from manifold.models.kernels import Kernel, kernel_named
from manifold.models.per_band import MonochromeGPLVM
from manifold.records import Array, Bands, BsdfFile, Progress, evenly_spaced

LARGEST_COORDINATE = 1e9  # latents are of order one; far larger ones overflow when squared
EXTRAPOLATION = 0.5  # share of the prior variance above which a latent counts as extrapolated
REFLECTANCE_INCIDENCE_DEG = 8.0  # of integrating spheres, specular included
_SHOWN_NAMES = 4  # of a model's materials, in messages
_EMBEDDING_BANDS = 20  # of a whole material that serve to embed it, evenly spaced


class LibraryChangedWarning(UserWarning):
    """A model was opened with a library that is not the one it was fitted to."""


@dataclass(frozen=True)
class Settings:
    """How a manifold was fitted.

    Attributes:
        kind: `monochrome`, every band a sample, or `material`, the kind of Hikichi & Iwasaki.
        latent_dim: Q; of a monochrome manifold the structure coordinates, to which every band adds a colour.
        mapping: name of the mapping.
        optimizer: `dls`, `l-bfgs` or `both`; None is the kind's own, and monochrome has `l-bfgs` only.
        mu: noise filter of the kernel; None is the kind's own.
        prior: weight of the Gaussian prior on the latents; None is the kind's own.
        length_scale: l, in units of the latents.
        kernel: name of the kernel, see `kernel_named`.
        grid: name of the grid of direction pairs behind the Gram matrix.
        sample_bands: bands per material that are samples of a monochrome manifold, at most.
    """

    kind: str = "monochrome"
    latent_dim: int = 2
    mapping: str = "cube-root"
    optimizer: str = cast(str, None)
    mu: float = cast(float, None)
    prior: float = cast(float, None)
    length_scale: float = 1.0
    kernel: str = "se"
    grid: str = "default"
    sample_bands: int = 5

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"no kind of manifold is called '{self.kind}', expected {' or '.join(KINDS)}")
        for name, value in _KIND_DEFAULTS[self.kind].items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        optimizers = OPTIMIZERS if self.kind == "material" else ("l-bfgs",)
        if self.optimizer not in optimizers:
            raise UsageError(
                f"optimizer '{self.optimizer}' for kind {self.kind}, expected {' or '.join(optimizers)}"
            )
        if self.sample_bands < 2:
            raise UsageError(f"{self.sample_bands} sample bands, expected at least 2")
        self.covariance()  # checks it

    def covariance(self) -> Kernel:
        """The kernel with its parameters."""
        return kernel_named(self.kernel, self.mu, self.length_scale)


_KIND_DEFAULTS: dict[str, dict[str, Any]] = {
    "monochrome": {"optimizer": "l-bfgs", "mu": 1e-3, "prior": 0.1},
    "material": {"optimizer": "dls", "mu": 1e-4, "prior": 0.0},
}


@dataclass(frozen=True, eq=False)
class Embedded:
    """Where a material that the manifold has not seen belongs.

    Attributes:
        latent: shape (Q,).
        colours: colour coordinate of every band, shape (B,); None where whole materials are points.
        relative_error: of the decoded material, `||w (f* - f)|| / ||w f||` on the pairs that it was embedded by.
    """

    latent: Array
    colours: Array | None
    relative_error: float


class Manifold:
    """Latent coordinates of measured materials, and predictions at any coordinate.

    Attributes:
        library: the measured materials.
        names: material names in the order of the latents, N of them.
        space: latents and the Gaussian process on them.
        settings: how it was fitted.
        statistics: objective at start and end.
    """

    def __init__(
        self,
        library: Library,
        names: tuple[str, ...],
        space: MaterialSpace | CurveSpace,
        settings: Settings,
        statistics: dict[str, float],
    ) -> None:
        """Use `fit` or `load`."""
        self.library = library
        self.names = names
        self.space = space
        self.settings = settings
        self.statistics = statistics
        self._materials: dict[str, MeasuredBRDF] = {}
        self._closed: dict[str, MeasuredBRDF] = {}
        self._sampled: list[MeasuredBRDF] | None = None
        self._unmeasured_shares: dict[str, float] = {}

    # -- fitting -------------------------------------------------------------------------------------------

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
        empty = MaterialSpace(np.empty((len(names), 0)), np.empty((0, 0)), 0, settings.covariance())
        model = cls(library, names, empty, settings, {})
        if settings.kind == "material":
            model._fit_materials(on_progress)
        else:
            model._fit_curves(on_progress)
        return model

    def _fit_materials(self, on_progress: Progress | None) -> None:
        s = self.settings
        matrix = self._gram(None, on_progress)
        fitted = GPLVM(
            s.latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, optimizer=s.optimizer, prior=s.prior
        ).fit_gram(matrix.S, matrix.n_outputs)  # fmt: skip
        self.space = MaterialSpace(fitted.embedding_, matrix.S, matrix.n_outputs, s.covariance())
        self._remember(fitted)

    def _fit_curves(self, on_progress: Progress | None) -> None:
        s = self.settings
        bands = evenly_spaced(self.bands.count, s.sample_bands)
        matrix = self._gram(bands, on_progress)
        fitted = MonochromeGPLVM(
            s.latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior
        ).fit_gram(matrix.S, len(self.names), matrix.n_outputs)  # fmt: skip
        samples = fitted.colour_[:, :, 0]
        # Colours and reflectances of all bands follow: decoding needs the samples only.
        unknown = np.zeros((len(self.names), 0))
        self.space = CurveSpace(fitted.structure_, samples, bands, unknown, unknown, s.covariance())
        self._remember(fitted)
        # The colours of all bands, those of the samples too, by the decoded error: what predictions are judged by.
        pairs = self._encoding_pairs
        decoder = self._decoder_at(pairs)
        sphere, measure = _reflectance_pairs()
        colours = np.empty((len(self.names), self.bands.count))
        reflectances = np.empty_like(colours)
        for n, material in enumerate(self.load_materials()):
            f = material.eval(pairs.wi, pairs.wo).T
            colours[n] = decoder.encode_colours(self.X[n], f)[:, 0]
            reflectances[n] = measure @ material.eval(sphere.wi, sphere.wo)
            if on_progress is not None:
                on_progress(n + 1, len(self.names), "colours")
        self.space = replace(self.space, colours=colours, reflectances=reflectances)

    def _remember(self, fitted: GPLVM | MonochromeGPLVM) -> None:
        self.statistics = {
            "objective_start": float(fitted.objective_start_),
            "objective": float(fitted.objective_),
        }

    def _gram(self, bands: Array | None, on_progress: Progress | None) -> gram.Gram:
        """The Gram matrix of whole materials, or of the given bands as samples, from the library's cache."""
        grid = RusinkiewiczGrid.named(self.settings.grid)
        chosen = None if bands is None else bands.tolist()
        key = gram.cache_key(self.library.content_hash, self.mapping, grid, chosen)
        cached = self.library.cache_get(key)
        if cached is not None:
            return gram.Gram(cached["S"], int(cached["n_outputs"][0]))
        materials = self.load_materials(on_progress)
        per_band = chosen is not None
        if chosen is not None:
            materials = [material.select_bands(chosen) for material in materials]
        matrix = gram.gram_matrix(materials, self.mapping, grid, on_progress, per_band=per_band)
        self.library.cache_put(key, {"S": matrix.S, "n_outputs": np.array([matrix.n_outputs])})
        return matrix

    # -- materials -----------------------------------------------------------------------------------------

    @property
    def bands(self) -> Bands:
        """The spectral axis of the library."""
        return self.library.bands

    @cached_property
    def mapping(self) -> Mapping:
        """The mapping of BRDF values."""
        return mapping_named(self.settings.mapping)

    @property
    def X(self) -> Array:
        """Latents of the materials, shape (N, Q); of a monochrome manifold their structure coordinates."""
        return self.space.X

    @property
    def S(self) -> Array:
        """Gram matrix of the mapped materials, not centred, shape (N, N); of whole materials only."""
        return self._require_materials().S

    def _require_materials(self) -> MaterialSpace:
        if not isinstance(self.space, MaterialSpace):
            raise UsageError(
                "a monochrome manifold has no Gram matrix of whole materials; embed with --kind material"
            )
        return self.space

    @property
    def gp(self) -> GPWeights:
        """The Gaussian process on the latents: of the materials, or of the monochrome samples."""
        return self.space.gp

    def material(self, name: str) -> MeasuredBRDF:
        """A measured material as its file has it, read from the library when first asked for.

        Raises:
            UsageError: the model has no such material.
            LibraryError: the library has lost it.
        """
        self._index(name)
        if name not in self._materials:
            self._materials[name] = MeasuredBRDF(self.library.read(name))
        return self._materials[name]

    def _closed_material(self, name: str) -> MeasuredBRDF:
        """A measured material with unmeasured cells filled, as predictions combine it."""
        if name not in self._closed:
            file = self.library.read(name)
            closed = self._with_unmeasured_filled(file)
            self._closed[name] = MeasuredBRDF(closed)
            if closed is file:
                self._materials[name] = self._closed[name]
        return self._closed[name]

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise UsageError(f"no material '{name}' in this model; {self._names_like(name)}")
        return self.names.index(name)

    def _names_like(self, name: str) -> str:
        """What somebody may have meant by a name: those that contain it, or nearly are it, a few at most."""
        within = [known for known in self.names if name and name.lower() in known.lower()]
        near = (within or difflib.get_close_matches(name, self.names))[:_SHOWN_NAMES]
        if near:
            return f"near are {', '.join(near)}"
        shown = ", ".join(self.names[:_SHOWN_NAMES])
        return f"it holds {shown}" + f" and {len(self.names) - _SHOWN_NAMES} more" * (
            len(self.names) > _SHOWN_NAMES
        )

    def load_materials(self, on_progress: Progress | None = None) -> list[MeasuredBRDF]:
        """All measured materials in the order of the latents, unmeasured cells filled; see `brdf.unmeasured`."""
        return self._read_all(self._closed_material, on_progress)

    def prepare(self, on_progress: Progress | None = None) -> None:
        """Read ahead what predictions need: the materials, of a monochrome manifold a few of their bands."""
        if isinstance(self.space, MaterialSpace):
            self.load_materials(on_progress)
        else:
            self._sampled_materials(on_progress)

    def _read_all(
        self, read: Callable[[str], MeasuredBRDF], on_progress: Progress | None
    ) -> list[MeasuredBRDF]:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            loaded = []
            for done, material in enumerate(pool.map(read, self.names), start=1):
                loaded.append(material)
                if on_progress is not None:
                    on_progress(done, len(self.names), material.name)
        return loaded

    def _sampled_materials(self, on_progress: Progress | None = None) -> list[MeasuredBRDF]:
        """All measured materials in the bands that find latents, of a monochrome manifold its samples."""
        if self._sampled is None:
            self._sampled = self._read_all(self._sampled_material, on_progress)
        return self._sampled

    def _sampled_material(self, name: str) -> MeasuredBRDF:
        """A measured material, unmeasured cells filled, in a few of its bands; the others are not kept."""
        whole = self._closed.get(name)
        if whole is None:
            whole = MeasuredBRDF(self._with_unmeasured_filled(self.library.read(name)))
        return whole.select_bands(self._embedding_bands.tolist())

    def _with_unmeasured_filled(self, file: BsdfFile) -> BsdfFile:
        cells = unmeasured_cells(file)
        self._unmeasured_shares[file.name] = unmeasured_share(file, cells)
        return fill_unmeasured(file, cells)

    # -- latents -------------------------------------------------------------------------------------------

    def weights(self, x: Array, colours: Array | None = None) -> Array:
        """Weights of the materials at latents x (M, Q) or (Q,), shape (M, N) or (N,); they sum to 1.

        Of a monochrome manifold: summed over the samples of a material, averaged over bands, at the colours (B,)
        given, or in the colours of the materials around.
        """
        return self._at(x, lambda X: self._weights(X, colours))

    def _weights(self, X: Array, colours: Array | None) -> Array:
        if isinstance(self.space, MaterialSpace):
            return self.gp.weights(X)
        if len(X) == 1 and colours is not None:
            owner = self.owner(X[0], self._require_colours(colours))
            if owner is not None:
                return np.eye(len(self.names))[[owner]]
        V = self.gp.weights(self._coloured(X, colours))
        V = V.reshape(len(X), -1, len(self.names), len(self.space.sample_bands)).sum(axis=3).mean(axis=1)
        return V

    def std(self, x: Array, colours: Array | None = None) -> Array:
        """Posterior standard deviation at latents x (M, Q) or (Q,), as a fraction of the prior's, in [0, 1].

        Of a monochrome manifold: the root of the variance's mean over bands, at the colours (B,) given, or
        over the sample bands in the colours of the materials around.
        """
        return self._at(x, lambda X: np.sqrt(self._variance_fraction(X, colours)))

    def is_extrapolation(self, x: Array, colours: Array | None = None) -> Array:
        """Whether the posterior variance at x is over half of the prior's: the data say little there."""
        return self._at(x, lambda X: self._variance_fraction(X, colours) > EXTRAPOLATION)

    def _variance_fraction(self, X: Array, colours: Array | None) -> Array:
        if isinstance(self.space, MaterialSpace):
            return self.gp.variance_fraction(X)
        if (
            len(X) == 1
            and colours is not None
            and self.owner(X[0], self._require_colours(colours)) is not None
        ):
            return np.zeros(1)
        return self.gp.variance_fraction(self._coloured(X, colours)).reshape(len(X), -1).mean(axis=1)

    def _coloured(self, X: Array, colours: Array | None) -> Array:
        """Latents of structures X (M, Q) in all bands of colours (B,), or of `_sample_latents`; M times as many."""
        if colours is None:
            return self._sample_latents(X)
        everywhere = np.broadcast_to(self._require_colours(colours), (len(X), self.bands.count))
        return self._require_curves().join(X, everywhere)

    def _sample_latents(self, X: Array) -> Array:
        """Latents of the sample bands at structures X (M, Q), in colours blended from those of the materials around.

        The weights fall with the fourth power of the distance: near a material its own colours, and no seams.
        """
        assert isinstance(self.space, CurveSpace)
        distance = cdist(X, self.X)
        nearest = distance.min(axis=1, keepdims=True)
        share = np.divide(nearest, distance, out=np.ones_like(distance), where=distance > 0) ** 4
        share[nearest[:, 0] == 0] = 0.0
        share[np.flatnonzero(nearest[:, 0] == 0), distance[nearest[:, 0] == 0].argmin(axis=1)] = 1.0
        return self.space.join(X, share @ self.space.sample_colours / share.sum(axis=1, keepdims=True))

    def nearest(self, x: Array, count: int = 1) -> list[tuple[str, float]]:
        """The materials nearest to a latent x (Q,) with their distances, nearest first."""
        distance = np.linalg.norm(self.X - self.require_latent(x), axis=1)
        return [(self.names[k], float(distance[k])) for k in np.argsort(distance, kind="stable")[:count]]

    def largest_weights(self, x: Array, count: int, colours: Array | None = None) -> list[tuple[str, float]]:
        """The materials with the largest weights at a latent x (Q,), by magnitude; none that is zero."""
        weights = self.weights(self.require_latent(x), colours)
        order = np.argsort(-np.abs(weights), kind="stable")[:count]
        return [(self.names[k], float(weights[k])) for k in order if weights[k] != 0]

    def unmeasured_share(self, x: Array) -> float:
        """Share of unmeasured cells at a latent x (Q,): the materials' shares, averaged by magnitude of weight."""
        weights = np.abs(self.weights(self.require_latent(x)))
        used = [(self.names[k], weights[k]) for k in np.flatnonzero(weights)]
        for name, _ in used:
            if name not in self._unmeasured_shares:
                self._with_unmeasured_filled(self.library.read(name))
        return float(sum(w * self._unmeasured_shares[name] for name, w in used) / weights.sum())

    def latent(self, name: str) -> Array:
        """The latent of a material, shape (Q,).

        Raises:
            UsageError: the model has no such material.
        """
        return self.X[self._index(name)].copy()

    def between(self, a: str, b: str, t: float) -> Array:
        """The latent on the straight line from material a (t = 0) to b (t = 1), shape (Q,)."""
        return (1.0 - t) * self.latent(a) + t * self.latent(b)

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
        Q = self.settings.latent_dim
        if x.ndim not in (1, 2) or x.shape[-1] != Q or not np.all(np.isfinite(x)):
            raise LatentError(f"latents have shape {x.shape}, expected ({Q},) or (M, {Q}), finite")
        return function(np.atleast_2d(x))[0] if x.ndim == 1 else function(x)

    # -- colours of a monochrome manifold ------------------------------------------------------------------

    def reflectance(self, name: str) -> Array:
        """Reflectance of a material at 8 degrees, specular included, shape (B,).

        Raises:
            UsageError: the model has no such material, or its materials are points and carry their colours.
        """
        return self._require_curves().reflectances[self._index(name)].copy()

    def reflectance_of_colours(self, x: Array, colours: Array) -> Array:
        """Reflectance of a structure x (Q,) in colours (B,), at 8 degrees, specular included, shape (B,)."""
        curves = self._require_curves()
        x, colours = self.require_latent(x), self._require_colours(colours)
        decoder, measure = self._sphere
        return decoder.decode(curves.join(x[None], colours[None])) @ measure

    def colours_like(self, x: Array, name: str) -> Array:
        """Colour coordinates (B,) that give a structure x (Q,) the reflectance of a material.

        At the material's own latent, its own colours: there the prediction is the measured file.
        """
        curves, x, k = self._require_curves(), self.require_latent(x), self._index(name)
        if np.array_equal(x, self.X[k]):
            return curves.colours[k].copy()
        return self.colours_of_reflectance(x, curves.reflectances[k])[0]

    def colours_of_reflectance(self, x: Array, reflectance: Array) -> tuple[Array, Array]:
        """Colour coordinates that give a structure x (Q,) a reflectance spectrum.

        Reflectance is the directional-hemispherical one at 8 degrees, specular included, as integrating
        spheres measure it; of an RGB library, the linear sRGB colour. What the structure cannot reach, as a
        metal cannot be black, is met as nearly as it can be.

        Args:
            x: structure.
            reflectance: shape (B,).
        Returns:
            colours (B,), and the reflectance that they give, (B,).
        Raises:
            UsageError: materials are points here.
            ShapeError: there is not one finite value per band.
        """
        self._require_curves()
        x = self.require_latent(x)
        reflectance = np.asarray(reflectance, dtype=np.float64)
        if reflectance.shape != (self.bands.count,) or not np.all(np.isfinite(reflectance)):
            raise ShapeError(
                f"reflectance has shape {reflectance.shape}, expected ({self.bands.count},), finite"
            )
        decoder, measure = self._sphere
        return decoder.colours_of_albedo(x, reflectance, measure)

    @cached_property
    def _sphere(self) -> tuple[Decoder, Array]:
        """What decodes latents inside an integrating sphere, and what makes a reflectance of it, (P,)."""
        pairs, measure = _reflectance_pairs()
        return self._decoder_at(pairs), measure

    def _require_curves(self) -> CurveSpace:
        if not isinstance(self.space, CurveSpace):
            raise UsageError(
                "the materials of this manifold carry their colours with them; embed with --kind monochrome "
                "to choose colours"
            )
        return self.space

    def _require_colours(self, colours: Array) -> Array:
        self._require_curves()
        colours = np.asarray(colours, dtype=np.float64)
        if colours.shape != (self.bands.count,) or not np.all(np.isfinite(colours)):
            raise ShapeError(f"colours have shape {colours.shape}, expected ({self.bands.count},), finite")
        return colours

    # -- predicting ----------------------------------------------------------------------------------------

    def predict(self, x: Array, colours: Array | None = None) -> Mixture:
        """The BRDF at a latent x (Q,); at a training latent the measured one, bit for bit.

        Args:
            x: latent; of a monochrome manifold, the structure.
            colours: colour coordinate of every band, shape (B,), of a monochrome manifold; None gives x the
                reflectance of the nearest material.
        Raises:
            LatentError: x is not (Q,) or not finite.
            UsageError: colours for a manifold whose materials carry them.
            ShapeError: colours are not (B,) or not finite.
        """
        x = self.require_latent(x)
        if isinstance(self.space, MaterialSpace):
            if colours is not None:
                self._require_curves()
            return self._predict_from_materials(self.gp.weights(x[None])[0])
        if colours is None:
            colours = self.colours_like(x, self.nearest(x)[0][0])
        colours = self._require_colours(colours)
        owner = self.owner(x, colours)
        if owner is not None:
            return self._predict_from_materials(np.eye(len(self.names))[owner])
        weights = self.gp.weights(self.space.join(x[None], colours[None]))
        return MonochromePrediction(self._sampled_materials(), weights, self.mapping, self.bands)

    def owner(self, x: Array, colours: Array) -> int | None:
        """The material whose structure x (Q,) and colours (B,) these are."""
        own = np.all(x == self.X, axis=1) & np.all(colours == self._require_curves().colours, axis=1)
        return int(np.argmax(own)) if np.any(own) else None

    def _predict_from_materials(self, weights: Array, mapping: Mapping | None = None) -> PredictedBRDF:
        if np.count_nonzero(weights) > 2:
            self.load_materials()
        used = np.flatnonzero(weights)
        if len(used) == 1 and weights[used[0]] == 1.0:
            materials = [self.material(self.names[used[0]])]
        else:
            materials = [self._closed_material(self.names[k]) for k in used]
        return PredictedBRDF(materials, weights[used], self.mapping if mapping is None else mapping)

    def interpolate(self, a: str, b: str, t: float) -> Mixture:
        """The prediction on the straight line from material a (t = 0) to b (t = 1), reflectances too."""
        x = self.between(a, b, t)
        if isinstance(self.space, MaterialSpace):
            return self.predict(x)
        if t in (0.0, 1.0):
            return self.predict(x, self.colours_like(x, b if t else a))
        reflectance = (1.0 - t) * self.reflectance(a) + t * self.reflectance(b)
        return self.predict(x, self.colours_of_reflectance(x, reflectance)[0])

    def blend(self, a: str, b: str, t: float) -> PredictedBRDF:
        """The linear interpolation of measured values, the baseline of Hikichi & Iwasaki, eq. 23."""
        unit = np.eye(len(self.names))
        weights = (1.0 - t) * unit[self._index(a)] + t * unit[self._index(b)]
        return self._predict_from_materials(weights, mapping_named("identity"))

    # -- new materials -------------------------------------------------------------------------------------

    def embed(self, brdf: BRDF) -> Embedded:
        """Find the latent, and colours, whose decoded prediction is nearest to a material's data.

        Args:
            brdf: a material in the bands of the library.
        Raises:
            BandMismatchError: it has other bands.
        """
        self.bands.require_same(brdf.bands, "the material to embed", "resample it, or use its own library")
        pairs = self._encoding_pairs
        decoder = self._decoder_at(pairs)
        f = brdf.eval(pairs.wi, pairs.wo).T  # [B, P]
        if isinstance(self.space, MaterialSpace):
            values = f[self._embedding_bands].reshape(1, -1)
            latent = decoder.encode(values)
            return Embedded(latent[0], None, decoder.relative_error(latent, values))
        structure = decoder.encode(f[self.space.sample_bands])[0, : self.settings.latent_dim]
        colours = decoder.encode_colours(structure, f)
        latents = self.space.join(structure[None], colours.T)
        return Embedded(structure, colours[:, 0], decoder.relative_error(latents, f))

    @cached_property
    def _encoding_pairs(self) -> EncodingPairs:
        return EncodingPairs.of_grid(RusinkiewiczGrid.named("default"))

    @property
    def _embedding_bands(self) -> Array:
        """Bands whose values find a latent."""
        if isinstance(self.space, CurveSpace):
            return self.space.sample_bands
        return evenly_spaced(self.bands.count, _EMBEDDING_BANDS)

    def _decoder_at(self, pairs: EncodingPairs) -> Decoder:
        """What turns latents into values at direction pairs: of all embedding bands, or of one band."""
        is_curves = isinstance(self.space, CurveSpace)
        cosines = pairs.cosines
        rows = []
        located = DirectionPairs(pairs.wi, pairs.wo)
        for material in self._sampled_materials():
            f = np.empty((len(located), material.bands.count))
            material.eval_into(located, f)
            rows.append(self.mapping.forward(f, cosines).T)  # [B_s, P]
        mapped = np.concatenate(rows) if is_curves else np.stack([row.reshape(-1) for row in rows])
        weight = cosines if is_curves else np.tile(cosines, len(rows[0]))
        return Decoder(
            gp=self.gp,
            n_structure=self.settings.latent_dim,
            group=len(rows[0]) if is_curves else 1,
            mapped=mapped,
            mapping=self.mapping,
            cosines=weight,
            gram_weight=weight,
            prior=self.settings.prior,
        )

    # -- files ---------------------------------------------------------------------------------------------

    def save(self, path: Path | str) -> None:
        """Write the model as HDF5, atomically.

        Raises:
            UsageError: the file cannot be written.
        """
        record = ModelRecord(
            self.library.path, self.library.content_hash, self.names, dict(vars(self.settings)), self.statistics,
            self.space.arrays,
        )  # fmt: skip
        write_model(Path(path), record)

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
        stored = read_model(path)
        settings, space = _restored(path, stored)
        if library is None:
            library = stored.library
            if not library.exists():
                raise LibraryError(f"{path}: its library is not at {library}; say where with --library")
        if not isinstance(library, Library):
            library = Library.open(library)
        missing = sorted(set(stored.names) - set(library.names))
        if missing:
            shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
            raise LibraryError(
                f"{library.path.name} lacks {len(missing)} of the {len(stored.names)} materials of {path.name} "
                f"({shown}); import them again, name the right library with --library, or embed again"
            )
        if isinstance(space, CurveSpace) and space.colours.shape[1] != library.bands.count:
            raise LibraryError(
                f"{library.path.name} has {library.bands}, {path.name} was fitted to {space.colours.shape[1]} bands; "
                "name the right library with --library, or embed again"
            )
        if library.content_hash != stored.library_hash:
            warnings.warn(
                f"{library.path.name} is not what {path.name} was fitted to (hash {library.content_hash[:12]}, "
                f"expected {stored.library_hash[:12]}); predictions use the present files: embed again",
                LibraryChangedWarning,
                stacklevel=2,
            )
        return cls(library, stored.names, space, settings, stored.statistics)


def _reflectance_pairs() -> tuple[EncodingPairs, Array]:
    """Direction pairs (P, 3) of an integrating sphere, and what makes a reflectance of values f there, (P,)."""
    wi = from_spherical(np.deg2rad(REFLECTANCE_INCIDENCE_DEG), 0.0)
    wo, measure = mirrored_quadrature(wi)
    return EncodingPairs(np.broadcast_to(wi, wo.shape), wo), measure * wo[:, 2]


def _restored(path: Path, stored: ModelRecord) -> tuple[Settings, MaterialSpace | CurveSpace]:
    """Settings and latent space of a model file, checked.

    Raises:
        ModelError: they do not fit each other.
    """
    try:
        known = {
            "kernel": "se"
        } | stored.settings  # models written before kernels could be chosen have no name
        settings = Settings(**{field.name: known[field.name] for field in fields(Settings)})
        kind = CurveSpace if settings.kind == "monochrome" else MaterialSpace
        space = kind.from_arrays(stored.arrays, settings.covariance())
        expected = (len(stored.names), settings.latent_dim)
        if space.X.shape != expected:
            raise ValueError(f"dataset 'X' has shape {space.X.shape}, expected {expected}")
    except (KeyError, TypeError, ValueError, IndexError, UsageError) as error:
        raise damaged(path, error) from error
    return settings, space
