"""Ways to predict a material from others: baselines, and the models of this package. One registry for all.

A method is fitted to some of the materials and then *encodes* any material: it finds the weights by which the
fitted ones combine to a prediction of it. `standard_methods` lists them; a new method is one more entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from manifold.experiments.evaluation.tabulated import MAX_BANDS, Data
from manifold.gplvm import GPLVM
from manifold.gpr import GPWeights
from manifold.mapping import Mapping, mapping_named
from manifold.model.combination import Combination
from manifold.models.encoding import PAIR_STRIDE, Decoder
from manifold.models.likelihood_encoding import LikelihoodEncoder
from manifold.models.per_band import MonochromeGPLVM
from manifold.records import Array

SAMPLE_BANDS = 5  # bands per material that are samples of a monochrome model
_REFIT_TOLERANCE = 1e-5  # of fits that are made once per left-out material
_IDENTITY = mapping_named("identity")

Encode = Callable[[int], Combination]
"""From the index of a material to its prediction."""

Fit = Callable[[Data, Array], Encode]
"""From data and the indices of the materials to learn from to what encodes any material."""


@dataclass(frozen=True)
class Method:
    """A way to predict materials.

    Attributes:
        key: name in JSON.
        title: for people.
        numbers: how many numbers describe a material of B bands.
        fit: learns from some materials, and encodes any.
        is_held_out: whether the prediction of a material is made from the others only.
        refits: whether every left-out material needs a fit without it; False: one fit to all serves, and
            `fit` keeps the held-out promise itself.
        sample_bands: bands of the measured files that predictions need, at most; None is all.
        fits_model: whether a fit searches for latents, which takes long.
    """

    key: str
    title: str
    numbers: Callable[[int], int]
    fit: Fit
    is_held_out: bool = True
    refits: bool = True
    sample_bands: int | None = None
    fits_model: bool = False

    def leave_out(self, data: Data, i: int) -> Combination:
        """The prediction of material i."""
        everything = np.arange(data.n_materials)
        return self.fit(data, np.delete(everything, i) if self.refits else everything)(i)

    def predict(self, data: Data, i: int) -> Array:
        """The predicted values of material i at the data's pairs and bands, shape (P, B')."""
        return self.leave_out(data, i).in_bands(data.bands).evaluate(data)


def standard_methods() -> list[Method]:
    """Methods that need no fitted model: baselines first, the setting of Hikichi & Iwasaki, then models."""
    return [*baseline_methods(), *gplvm_methods()]


def baseline_methods() -> list[Method]:
    """What a model of this package has to beat."""
    return [
        Method("nearest", "nearest material", lambda B: 1, fit_nearest),
        Method("linear", "linear, two nearest", lambda B: 3, fit_linear),
        Method("oracle", "best mix of two (an oracle)", lambda B: 3, fit_oracle),
        Method("pca_6_identity", "PCA, 6, identity", lambda B: 6, fit_pca("identity", 6)),
        Method("pca_6_cube_root", "PCA, 6, cube root", lambda B: 6, fit_pca("cube-root", 6)),
        Method("pca_6_log_relative", "PCA, 6, log-relative", lambda B: 6, fit_pca("log-relative", 6)),
        Method("published", "Hikichi & Iwasaki, 2-D", lambda B: 2, fit_published, fits_model=True),
    ]


def gplvm_methods() -> list[Method]:
    """Models of this package at settings of their own."""
    return [
        Method("gplvm_2", "GPLVM, 2, cube root", lambda B: 2, fit_gplvm(2), fits_model=True),
        Method("gplvm_6", "GPLVM, 6, cube root", lambda B: 6, fit_gplvm(6, prior=0.1), fits_model=True),
        _monochrome("monochrome_2_1", "monochrome, 2 + 1 per band", 2, 1),
        _monochrome("monochrome_3_1", "monochrome, 3 + 1 per band", 3, 1),
        _monochrome("monochrome_0_2", "monochrome, 2 per band", 0, 2),
    ]


def _monochrome(key: str, title: str, n_structure: int, n_colour: int) -> Method:
    def numbers(B: int) -> int:
        return n_structure + n_colour * (B if n_colour == 1 else min(B, MAX_BANDS))

    fit = fit_monochrome(n_structure, n_colour)
    return Method(key, title, numbers, fit, sample_bands=SAMPLE_BANDS, fits_model=True)


# -- baselines ---------------------------------------------------------------------------------------------


def fit_nearest(data: Data, training: Array) -> Encode:
    """The material whose values are nearest, weighted as the error is."""
    G = data.gram(_IDENTITY, power=2)

    def encode(i: int) -> Combination:
        nearest = training[np.argmin(_squared_distances(G, i, training))]
        return _whole(data, training, (training == nearest).astype(float), _IDENTITY)

    return encode


def fit_linear(data: Data, training: Array) -> Encode:
    """The best point between the two nearest materials (Hikichi & Iwasaki, eq. 23)."""
    G = data.gram(_IDENTITY, power=2)

    def encode(i: int) -> Combination:
        pair = np.argsort(_squared_distances(G, i, training), kind="stable")[:2]
        return _best_mix(data, G, i, training, pair)

    return encode


def fit_oracle(data: Data, training: Array) -> Encode:
    """The best point on a line between any two materials: what linear interpolation cannot beat."""
    G = data.gram(_IDENTITY, power=2)

    def encode(i: int) -> Combination:
        return _best_mix(data, G, i, training, np.arange(len(training)))

    return encode


def fit_pca(mapping_name: str, count: int) -> Fit:
    """Projection on the first principal components in a mapped domain, weighted by the cosines."""
    mapping = mapping_named(mapping_name)

    def fit(data: Data, training: Array) -> Encode:
        S = data.gram(mapping)
        among = S[np.ix_(training, training)]
        mean = among.mean(axis=1)
        values, vectors = np.linalg.eigh(among - mean[:, None] - mean[None] + mean.mean())
        kept = min(count, len(training) - 1)
        U, scale = vectors[:, ::-1][:, :kept], values[::-1][:kept]

        def encode(i: int) -> Combination:
            cross = S[i, training]
            centred = cross - cross.mean() - mean + mean.mean()  # products with the others less their mean
            shift = U @ ((U.T @ centred) / scale)
            weights = 1.0 / len(training) + shift - shift.mean()
            return _whole(data, training, weights, mapping)

        return encode

    return fit


def _squared_distances(G: Array, i: int, training: Array) -> Array:
    """From material i to the training materials, by inner products G (N, N)."""
    return G[i, i] + np.diag(G)[training] - 2.0 * G[i, training]


def _best_mix(data: Data, G: Array, i: int, training: Array, among: Array) -> Combination:
    """The best point between any two of some training materials, or at one of them."""
    chosen = training[among]
    squared = _squared_distances(G, i, chosen)
    inner = G[np.ix_(chosen, chosen)] - G[i, chosen][:, None] - G[i, chosen][None] + G[i, i]
    span = squared[:, None] + squared[None] - 2.0 * inner
    t = np.divide(squared[None] - inner, span, out=np.zeros_like(span), where=span > 0)
    t = np.clip(t, 0.0, 1.0)  # share of the row's material, [k, k]
    error = t * t * squared[:, None] + (1.0 - t) ** 2 * squared[None] + 2.0 * t * (1.0 - t) * inner
    a, b = np.unravel_index(np.argmin(error), error.shape)
    weights = np.zeros(len(training))
    weights[among[b]] += 1.0 - t[a, b]
    weights[among[a]] += t[a, b]
    return _whole(data, training, weights, _IDENTITY)


def _whole(
    data: Data,
    training: Array,
    weights: Array,
    mapping: Mapping,
    *,
    is_clipped: bool = False,
    variance: float | None = None,
) -> Combination:
    """A combination of whole materials, by weights of the training materials."""
    spread = np.zeros(data.n_materials)
    spread[training] = weights
    return Combination(mapping, spread, is_clipped=is_clipped, variance=variance)


# -- models ------------------------------------------------------------------------------------------------


def fit_published(data: Data, training: Array) -> Encode:
    """As Hikichi & Iwasaki: raw values, 2-D, mu = 1e-4, direct local search; the latent by mapped residual."""
    S = data.gram(_IDENTITY)
    gplvm = GPLVM(2, mu=1e-4, optimizer="dls", tol=_REFIT_TOLERANCE)
    fitted = gplvm.fit_gram(S[np.ix_(training, training)], data.n_outputs)

    def encode(i: int) -> Combination:
        x = fitted.transform_gram(S[i, training][None], S[i, i][None], criterion="residual")
        variance = fitted.output_variance_ * float(fitted.gp_.variance(x)[0])
        return _whole(data, training, fitted.weights(x)[0], _IDENTITY, variance=variance)

    return encode


def fit_gplvm(
    count: int,
    *,
    mapping: str = "cube-root",
    mu: float = 1e-4,
    length_scale: float = 1.0,
    kernel: str = "se",
    prior: float = 0.0,
    optimizer: str = "l-bfgs",
    by_likelihood: bool = False,
) -> Fit:
    """The whole-material GPLVM; a material is encoded by its decoded error, or by its likelihood.

    Args:
        count: Q; fewer where there are not enough materials.
        mapping, mu, length_scale, kernel, prior, optimizer: of the model.
        by_likelihood: how to encode.
    """
    T = mapping_named(mapping)

    def fit(data: Data, training: Array) -> Encode:
        S = data.gram(T)[np.ix_(training, training)]
        fitted = GPLVM(
            min(count, len(training) - 1), mu=mu, length_scale=length_scale, kernel=kernel, prior=prior,
            optimizer=optimizer, tol=_REFIT_TOLERANCE,
        ).fit_gram(S, data.n_outputs)  # fmt: skip
        if by_likelihood:
            return _likelihood_in_materials(data, training, fitted.gp_, T, prior)
        return encode_in_materials(data, training, fitted.gp_, T, prior, fitted.output_variance_)

    return fit


def _likelihood_in_materials(
    data: Data, training: Array, gp: GPWeights, mapping: Mapping, prior: float
) -> Encode:
    """Encode by likelihood, in a process on the latents of whole training materials."""
    S = data.gram(mapping)
    encoder = LikelihoodEncoder(gp, S[np.ix_(training, training)], data.n_outputs, gp.X.shape[1], prior=prior)

    def encode(i: int) -> Combination:
        x = encoder.encode(S[i, training][None], S[i, i][None])
        variance = encoder.output_variance * float(gp.variance(x)[0])
        return _whole(data, training, gp.weights(x)[0], mapping, is_clipped=True, variance=variance)

    return encode


def encode_in_materials(
    data: Data, training: Array, gp: GPWeights, mapping: Mapping, prior: float, output_variance: float
) -> Encode:
    """Encode by the decoded error, in a process on the latents of whole training materials."""
    some = slice(None, None, PAIR_STRIDE)
    rows = data.mapped(mapping)[training, some].reshape(len(training), -1)
    cosines = np.repeat(data.cosines[some], data.f.shape[2])
    decoder = Decoder(gp, gp.X.shape[1], 1, rows, mapping, cosines, cosines, prior)

    def encode(i: int) -> Combination:
        x = decoder.encode(data.f[i, some].reshape(1, -1))
        variance = output_variance * float(gp.variance(x)[0])
        return _whole(data, training, gp.weights(x)[0], mapping, is_clipped=True, variance=variance)

    return encode


def fit_monochrome(
    n_structure: int,
    n_colour: int,
    *,
    mapping: str = "cube-root",
    mu: float = 1e-3,
    length_scale: float = 1.0,
    kernel: str = "se",
    prior: float = 0.1,
    sample_bands: int = SAMPLE_BANDS,
    by_likelihood: bool = False,
) -> Fit:
    """The monochrome GPLVM, encoded as `encode_in_curves` does, or by likelihood.

    Args:
        n_structure, n_colour, mu, length_scale, kernel, prior: of the model.
        mapping: its name.
        sample_bands: bands per material that are samples.
        by_likelihood: how to encode.
    """
    T = mapping_named(mapping)

    def fit(data: Data, training: Array) -> Encode:
        bands = data.available_bands(sample_bands)
        S = data.sample_gram(T, bands)
        columns = sample_columns(training, len(bands))
        model = MonochromeGPLVM(
            n_structure, n_colour, mu=mu, length_scale=length_scale, kernel=kernel, prior=prior
        ).fit_gram(S[np.ix_(columns, columns)], len(training), data.f.shape[1])  # fmt: skip
        encode = _likelihood_in_curves if by_likelihood else encode_in_curves
        return encode(data, training, model.gp_, n_structure, bands, T, prior)

    return fit


def encode_in_curves(
    data: Data, training: Array, gp: GPWeights, n_structure: int, bands: Array, mapping: Mapping, prior: float
) -> Encode:
    """Encode by the decoded error, in a process on the latents of monochrome samples, bands (B_s,) of each.

    Structure and colours of the samples are found together, then the colour of every band. Two and more colour
    coordinates are searched for in the data's bands, and the curve between these is linear.
    """
    columns = sample_columns(training, len(bands))
    some = slice(None, None, PAIR_STRIDE)
    rows = data.samples(mapping, bands)[columns][:, some]
    cosines = data.cosines[some]
    decoder = Decoder(gp, n_structure, len(bands), rows, mapping, cosines, cosines, prior)
    S = data.sample_gram(mapping, bands)[np.ix_(columns, columns)]
    output_variance = gp.output_variance(S, data.f.shape[1])

    def encode(i: int) -> Combination:
        values = np.ascontiguousarray(data.full_values(i).T)  # [B, P_s]
        latents = decoder.encode(values[bands])
        structure = latents[0, :n_structure]
        if len(bands) == data.n_bands:
            colours = latents[:, n_structure:]
        elif gp.X.shape[1] - n_structure == 1:
            colours = decoder.encode_colours(structure, values)
        else:
            colours = _interpolated(data, decoder.encode_colours(structure, values[data.bands]))
        latents = np.hstack([np.tile(structure, (data.n_bands, 1)), colours])
        return curve(data, columns, gp, latents, bands, mapping, output_variance)

    return encode


def _likelihood_in_curves(
    data: Data, training: Array, gp: GPWeights, n_structure: int, bands: Array, mapping: Mapping, prior: float
) -> Encode:
    """Encode by likelihood: structure and the colours of the data's bands together; the curve between is linear."""
    columns = sample_columns(training, len(bands))
    samples = data.samples(mapping, bands)[columns]
    S = data.sample_gram(mapping, bands)[np.ix_(columns, columns)]
    encoder = LikelihoodEncoder(gp, S, data.f.shape[1], n_structure, len(bands), prior)

    def encode(i: int) -> Combination:
        T = data.mapped(mapping)[i].T  # [B', P]
        nodes = encoder.encode((T * data.cosines) @ samples.T, (T * T) @ data.cosines)
        latents = _interpolated(data, nodes)
        return curve(data, columns, gp, latents, bands, mapping, encoder.output_variance)

    return encode


def _interpolated(data: Data, nodes: Array) -> Array:
    """Coordinates (B, Q) of all bands from those of the data's bands, (B', Q)."""
    every = np.arange(data.n_bands)
    return np.column_stack([np.interp(every, data.bands, node) for node in nodes.T])


def curve(
    data: Data,
    columns: Array,
    gp: GPWeights,
    latents: Array,
    bands: Array,
    mapping: Mapping,
    output_variance: float,
    weights: Array | None = None,
) -> Combination:
    """The combination that latents (B, Q) of all bands stand for, of the samples in `columns`.

    `weights` (B, len(columns)) stand in for those of the process where they are given.
    """
    spread = np.zeros((data.n_bands, data.n_materials * len(bands)))
    spread[:, columns] = gp.weights(latents) if weights is None else weights
    return Combination(mapping, spread, bands, variance=output_variance * gp.variance(latents))


def sample_columns(materials: Array, n_bands: int) -> Array:
    """Where the samples of materials (n,) stand among all, shape (n * B_s,)."""
    return (materials[:, None] * n_bands + np.arange(n_bands)).reshape(-1)
