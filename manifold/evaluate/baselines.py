"""Baselines: nearest materials, linear combinations of two, principal components, non-negative combinations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold.core.mapping import Identity, ValueMapping
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Indices
from manifold.evaluate.cross_validation import Encode, Fit
from manifold.evaluate.method_data import Data
from manifold.model.combination import Combination
from manifold.model.reconstruction import DICTIONARY, ComparedValues
from manifold.model.settings import LEARNT_BANDS
from manifold.registries import MAPPINGS

_IDENTITY = MAPPINGS["identity"]


def fit_nearest(data: Data, training: Indices) -> Encode:
    """Return a function that predicts a material by the nearest training material, measured by the linear error."""
    G = data.gram(_IDENTITY, power=2)

    def encode(i: int) -> Combination:
        nearest = training[np.argmin(_squared_distances(G, i, training))]
        return _in_all_bands(data, training, (training == nearest).astype(float), _IDENTITY)

    return encode


def fit_linear(data: Data, training: Indices) -> Encode:
    """Return a function that predicts the best point between the two nearest materials (Hikichi & Iwasaki, eq. 23)."""
    G = data.gram(_IDENTITY, power=2)

    def encode(i: int) -> Combination:
        pair = np.argsort(_squared_distances(G, i, training), kind="stable")[:2]
        return _best_mix(data, G, i, training, pair)

    return encode


def fit_oracle(data: Data, training: Indices) -> Encode:
    """Return a function that predicts the best point between any two materials, a bound for linear interpolation."""
    G = data.gram(_IDENTITY, power=2)

    def encode(i: int) -> Combination:
        return _best_mix(data, G, i, training, np.arange(len(training)))

    return encode


def fit_pca(mapping_name: str, count: int) -> Fit:
    """Return a method that projects on the first principal components in a mapped domain, weighted by the cosines."""
    mapping = MAPPINGS[mapping_name]

    def fit(data: Data, training: Indices) -> Encode:
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
            return _in_all_bands(data, training, weights, mapping)

        return encode

    return fit


def principal_components(
    mapping_name: str, count: int, data: Data
) -> tuple[Array, Callable[[Array], Combination]]:
    """Return the scores (N, Q) of all materials, and the prediction at scores (Q,)."""
    mapping, N = MAPPINGS[mapping_name], data.n_materials
    S = data.gram(mapping)
    mean = S.mean(axis=1)
    values, vectors = np.linalg.eigh(S - mean[:, None] - mean[None] + mean.mean())
    kept = min(count, N - 1)
    U, scale = vectors[:, ::-1][:, :kept], np.sqrt(values[::-1][:kept])

    def at(x: Array) -> Combination:
        shift = U @ (x / scale)
        return Combination(mapping, 1.0 / N + shift - shift.mean())

    return U * scale, at


def _squared_distances(G: Array, i: int, training: Indices) -> Array:
    """Return squared distances of material i from the training materials, by inner products G (N, N)."""
    return G[i, i] + np.diag(G)[training] - 2.0 * G[i, training]


def _best_mix(data: Data, G: Array, i: int, training: Indices, among: Indices) -> Combination:
    """Return the best point between any two of some training materials, or at one of them."""
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
    return _in_all_bands(data, training, weights, _IDENTITY)


def _in_all_bands(data: Data, training: Indices, weights: Array, mapping: ValueMapping) -> Combination:
    """Return a combination of whole materials, by weights of the training materials; negative values are kept."""
    spread = np.zeros(data.n_materials)
    spread[training] = weights
    return Combination(mapping, spread, is_clipped=False)


NUMBERS_PER_BAND = 30
"""Weights of a reconstruction and indices of their atoms: in RGB 90, the median of 20 files."""


def few_numbers(B: int) -> int:
    """Return the number of parameters of three atoms with one weight per band: 12 for RGB."""
    return 3 * (min(B, LEARNT_BANDS) + 1)


def fit_nonnegative(sample_bands: int, numbers: Callable[[int], int] | None = None) -> Fit:
    """Return the method that fits all samples and lobes by non-negative weights, see `manifold.model.reconstruction`.

    Samples are `sample_bands` bands per material. `numbers` is a function of the number of bands that limits the
    number of parameters, see `few_atoms`; None sets no limit.
    """

    def fit(data: Data, training: Indices) -> Encode:
        bands = data.available_bands(sample_bands)

        def compare() -> tuple[ComparedValues, Array]:
            compared = ComparedValues(Pairs(data.wi[:: data.stride], data.wo[:: data.stride]))
            return compared, compared.of_atoms([m.select_bands(bands.tolist()) for m in data.materials])

        compared, atoms = data.cached(("reconstruction", sample_bands), compare)
        n_samples = data.n_materials * len(bands)
        of_training = np.isin(np.arange(n_samples) // len(bands), training)
        most = None if numbers is None else numbers(data.n_bands)
        columns = np.append(
            np.tile(of_training, len(DICTIONARY.exponents)), np.ones(len(DICTIONARY.lobes), bool)
        )

        def encode(i: int) -> Combination:
            weights = np.zeros((data.n_bands, len(atoms)))
            weights[:, columns] = compared.weights(atoms[columns], data.materials[i], most)
            return Combination(Identity(), weights, bands, dictionary=DICTIONARY)

        return encode

    return fit
