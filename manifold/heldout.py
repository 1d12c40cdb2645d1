"""Encode-decode leave-one-out: how well models predict a material they were fitted without.

Every method is fitted to N - 1 materials, finds the latent of the left-out one from its data, and decodes
it; the error is `||w (f* - f)|| / ||w f||` with `w = cos(theta_i) cos(theta_o)`. Latents that were fitted with the
left-out material, or the reconstruction of training data, would flatter.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from manifold import gram
from manifold.brdf import BRDF
from manifold.encoding import Decoder
from manifold.gplvm import GPLVM, blas_threads
from manifold.mapping import Mapping, mapping_named
from manifold.metrics import RusinkiewiczGrid, cosine_weight
from manifold.monochrome import MonochromeGPLVM
from manifold.records import Array

MAX_BANDS = 20  # bands that errors are measured in, evenly spaced: about every tenth of 195
MAX_SAMPLE_BANDS = 5  # bands per material that are samples of a monochrome model
ENCODE_STRIDE = 6  # of the direction pairs, one in this many serves to find the latent

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Data:
    """Values of all materials.

    Attributes:
        f: in 1/sr, shape (N, P, B).
        cosines: cos(theta_i) cos(theta_o) per direction pair, shape (P,).
    """

    f: Array
    cosines: Array
    _mapped: dict[str, Array] = field(default_factory=dict, repr=False)

    @classmethod
    def evaluate(cls, materials: Sequence[BRDF], grid: RusinkiewiczGrid) -> Data:
        """Evaluate materials on a grid, in at most MAX_BANDS bands."""
        count = materials[0].bands.count
        bands = np.unique(np.linspace(0, count - 1, min(count, MAX_BANDS)).round().astype(int))
        blocks = [(cosine_weight(wi, wo), f[..., bands]) for wi, wo, f in gram.value_blocks(materials, grid)]
        return cls(np.concatenate([f for _, f in blocks], axis=1), np.concatenate([c for c, _ in blocks]))

    def mapped(self, mapping: Mapping) -> Array:
        """T(f) of all materials, shape (N, P, B); remembered per mapping."""
        if mapping.name not in self._mapped:
            cosines = np.broadcast_to(self.cosines, self.f.shape[:2])
            self._mapped[mapping.name] = mapping.forward(self.f, cosines)
        return self._mapped[mapping.name]

    @property
    def squared_weight(self) -> Array:
        """w^2 per direction pair, shape (P,)."""
        return self.cosines**2

    def relative_error(self, i: int, predicted: Array) -> float:
        """Of a prediction (P, B) of material i."""
        w2 = self.squared_weight[:, None]
        wrong = np.sum(w2 * (predicted - self.f[i]) ** 2)
        return float(np.sqrt(wrong / np.sum(w2 * self.f[i] ** 2)))


@dataclass(frozen=True)
class Method:
    """A way to predict left-out materials.

    Attributes:
        title: for people.
        numbers: how many numbers describe a material of B bands.
        predict: from data and the index of the left-out material to (P, B).
    """

    title: str
    numbers: Callable[[int], int]
    predict: Callable[[Data, int], Array]


@dataclass(frozen=True)
class Result:
    """Errors of one method over all materials.

    Attributes:
        title: of the method.
        numbers: that describe a material.
        relative_error: per material.
        median, p90: of them.
        negative_share: of all predicted values.
        seconds: for all materials.
    """

    title: str
    numbers: int
    relative_error: tuple[float, ...]
    median: float
    p90: float
    negative_share: float
    seconds: float


def compare(
    materials: Sequence[BRDF],
    methods: Sequence[Method] | None = None,
    grid: RusinkiewiczGrid | None = None,
    on_progress: Progress | None = None,
) -> list[Result]:
    """Leave every material out once with every method.

    Args:
        materials: at least four, of the same bands.
        methods: by default `standard_methods()`.
        grid: direction pairs; by default the 45 x 23 x 12 Rusinkiewicz grid.
        on_progress: called with (done, total, title).
    """
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default") if grid is None else grid)
    methods = standard_methods() if methods is None else methods
    results = []
    total = len(methods) * len(materials)
    for m, method in enumerate(methods):
        start = time.perf_counter()
        errors, negative = [], 0.0
        for i in range(len(materials)):
            with blas_threads(0):  # the matrices are small: a second thread costs more than it does
                predicted = method.predict(data, i)
            errors.append(data.relative_error(i, predicted))
            negative += float(np.mean(predicted < 0)) / len(materials)
            if on_progress is not None:
                on_progress(m * len(materials) + i + 1, total, method.title)
        results.append(
            Result(
                title=method.title,
                numbers=method.numbers(data.f.shape[2]),
                relative_error=tuple(errors),
                median=float(np.median(errors)),
                p90=float(np.percentile(errors, 90)),
                negative_share=negative,
                seconds=time.perf_counter() - start,
            )
        )
    return results


def standard_methods() -> list[Method]:
    """Baselines first, the seed's setting, then the models of this package."""
    return [
        Method("nearest material", lambda B: 1, _nearest),
        Method("best mix of any two (sees the answer)", lambda B: 3, _oracle),
        Method("PCA, 6, identity", lambda B: 6, _pca("identity", 6)),
        Method("PCA, 6, cube root", lambda B: 6, _pca("cube-root", 6)),
        Method("seed: GPLVM, 2, identity", lambda B: 2, _whole("identity", 2, refine_decoded=False)),
        Method("GPLVM, 2, cube root", lambda B: 2, _whole("cube-root", 2)),
        Method("GPLVM, 6, cube root", lambda B: 6, _whole("cube-root", 6, prior=0.1)),
        Method("monochrome, 2 shared + 1 per band", lambda B: 2 + B, _monochrome(2, 1)),
        Method("monochrome, 3 shared + 1 per band", lambda B: 3 + B, _monochrome(3, 1)),
        Method("monochrome, 2 per band", lambda B: 2 * B, _monochrome(0, 2)),
    ]


def _others(N: int, i: int) -> Array:
    return np.delete(np.arange(N), i)


def _nearest(data: Data, i: int) -> Array:
    """The other material whose values are nearest, weighted as the error is."""
    others = _others(len(data.f), i)
    w2 = data.squared_weight[:, None]
    return data.f[min(others, key=lambda n: float(np.sum(w2 * (data.f[n] - data.f[i]) ** 2)))]


def _oracle(data: Data, i: int) -> Array:
    """The best point on a line between any two other materials: what linear interpolation cannot beat."""
    others = _others(len(data.f), i)
    weighted = data.cosines[:, None] * (data.f[others] - data.f[i])
    flat = weighted.reshape(len(others), -1)
    G = flat @ flat.T
    best = (np.inf, 0, 0, 0.0)
    for a in range(len(others)):
        for b in range(a):
            span = G[a, a] + G[b, b] - 2.0 * G[a, b]
            t = np.clip((G[b, b] - G[a, b]) / span, 0.0, 1.0) if span > 0 else 0.0
            error = t * t * G[a, a] + (1 - t) ** 2 * G[b, b] + 2 * t * (1 - t) * G[a, b]
            best = min(best, (float(error), a, b, float(t)))
    _, a, b, t = best
    return t * data.f[others[a]] + (1.0 - t) * data.f[others[b]]


def _pca(name: str, count: int) -> Callable[[Data, int], Array]:
    """Projection on the principal components of the others."""
    mapping = mapping_named(name)

    def predict(data: Data, i: int) -> Array:
        others = _others(len(data.f), i)
        T = data.mapped(mapping)
        root = np.repeat(np.sqrt(data.cosines), T.shape[2])
        A = T[others].reshape(len(others), -1) * root
        mean = A.mean(axis=0)
        A -= mean
        values, vectors = np.linalg.eigh(A @ A.T)
        kept = min(count, len(others) - 1)
        U, scale = vectors[:, ::-1][:, :kept], values[::-1][:kept]
        shift = U @ ((A @ (T[i].reshape(-1) * root - mean)) @ U / scale)
        weights = 1.0 / len(others) + shift - shift.mean()
        combined = np.tensordot(weights, T[others], axes=1)
        return mapping.inverse(combined, data.cosines)

    return predict


def _whole(
    name: str, count: int, *, prior: float = 0.0, refine_decoded: bool = True
) -> Callable[[Data, int], Array]:
    """The whole-material GPLVM, refined by direct local search."""
    mapping = mapping_named(name)

    def predict(data: Data, i: int) -> Array:
        others = _others(len(data.f), i)
        N, P, B = data.f.shape
        T = data.mapped(mapping)
        flat = T.reshape(N, P * B)
        cosines = np.repeat(data.cosines, B)
        S = (flat[others] * cosines) @ flat[others].T
        optimizer = "dls" if count <= 2 else "l-bfgs"
        fitted = GPLVM(count, prior=prior, optimizer=optimizer, tol=1e-5).fit_gram(S, P * B)
        if refine_decoded:
            some = np.arange(0, P, ENCODE_STRIDE)
            d = Decoder(
                fitted.gp_, count, 1, T[others][:, some].reshape(N - 1, -1), mapping,
                np.repeat(data.cosines[some], B), np.repeat(data.cosines[some], B), prior,
            )  # fmt: skip
            x = d.encode(data.f[i][some].reshape(1, -1))
        else:
            x = fitted.transform_gram(
                ((flat[i] * cosines) @ flat[others].T)[None],
                np.array([np.sum(cosines * flat[i] ** 2)]),
                criterion="residual",
            )
        combined = np.tensordot(fitted.weights(x)[0], T[others], axes=1)
        predicted = mapping.inverse(combined, data.cosines)
        return np.maximum(predicted, 0.0) if refine_decoded else predicted

    return predict


def _monochrome(n_structure: int, n_colour: int) -> Callable[[Data, int], Array]:
    """The monochrome model: structure and colours of a few bands together, then every band's colour."""
    mapping = mapping_named("cube-root")

    def predict(data: Data, i: int) -> Array:
        N, P, B = data.f.shape
        others = _others(N, i)
        bands = np.unique(np.linspace(0, B - 1, min(B, MAX_SAMPLE_BANDS)).round().astype(int))
        T = np.moveaxis(data.mapped(mapping)[others][..., bands], 2, 1).reshape(-1, P)
        model = MonochromeGPLVM(n_structure, n_colour, mu=1e-3).fit_gram((T * data.cosines) @ T.T, N - 1, P)
        some = np.arange(0, P, ENCODE_STRIDE)
        cosines = data.cosines[some]
        d = Decoder(model.gp_, n_structure, len(bands), T[:, some], mapping, cosines, cosines, model.prior)
        values = np.ascontiguousarray(data.f[i][some].T)  # [B, P]
        latents = d.encode(values[bands])
        if len(bands) < B:
            colours = d.encode_colours(latents[0, :n_structure], values)
            latents = np.hstack([np.tile(latents[0, :n_structure], (B, 1)), colours])
        combined = model.gp_.weights(latents) @ T
        return np.maximum(mapping.inverse(combined.T, data.cosines), 0.0)

    return predict
