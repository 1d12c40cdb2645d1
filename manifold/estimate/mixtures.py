"""Evaluates mixtures of two atoms and a Lambertian, with prior and posterior probabilities.

A few readings, or the pixels of one picture, do not determine which library materials a material resembles, and
therefore not its highlight in unobserved directions: many mixtures fit. All mixtures are evaluated, and averaged with
their posterior probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular

from manifold.colour.conversion import luminance
from manifold.core.directions import from_spherical
from manifold.core.records import Array, Bands, Indices, Mask
from manifold.estimate.gloss import gloss_differences, value_of_unit
from manifold.estimate.residual import cells, coordinates, covariance
from manifold.formats.readings import GlossUnits
from manifold.gp.nonnegative import nonnegative_weights

# These constants, and those below, were chosen by completions of left-out RGB files. Multiplied or divided by 1.5, each
# changes the geometric mean of ball and cube-root errors of six such files by at most 6 %, and that of ball errors by
# at most 2 % (`tools/constants.py estimate.mixtures`). NOISE, MODEL_ERROR, SCALE_SPREAD and _EXPONENT trade one error
# for the other. _TEMPERED and _WORLD_COATED act on expected errors only; _MOST_PAIRS bounds the work.
SHARES = (0.5, 0.2, 0.8)  # shares of the first atom of two; one alone has 1
_MOST_PAIRS = 40_000  # pairs of atoms of two materials; of larger libraries as many at random
_FREEDOM = 3.0  # degrees of freedom of Student's t: the variances of noise and residual are estimates
_TWO_COATS = 0.8  # share of mixtures of two coats among those that a coat is part of

_TEMPERED = (
    0.25  # power of the likelihood of `Alike`: errors of their highlights are then nearest to true ones
)
_LEAST_SCALE = 0.1  # of atoms: beside smaller ones, the Lambertian is what is seen
_WORLD_COATED = 0.2  # the same for `Alike`, where kinds that a library lacks count: plastics, varnishes

LIKE_ONE = 0.8
"""Prior probability that a material resembles a single library material, in one of its bands or between two bands."""

COATED = 0.05
"""Prior probability that a material resembles the dielectric coats instead of library materials."""

SCALE_SPREAD = 0.15
"""Prior standard deviation of the scale of atoms about 1."""

LAMBERTIAN_SPREAD = 0.5
"""Prior standard deviation of the weight of the Lambertian."""


@dataclass(frozen=True, eq=False)
class Mixtures:
    """H mixtures `a (x g_i + (1 - x) g_j) + l L` of two of n atoms and a Lambertian.

    Attributes:
        first, second: i and j, shape (H,).
        share: x, shape (H,).
        scale, lambertian: a and l, shape (H,).
        log_prior: logarithms of the prior probabilities, shape (H,).
        misfit: squared errors over their variance, shape (H,).
        n_atoms: n; the Lambertian has index n.
        log_posterior: logarithms of the posterior probabilities, shape (H,); the prior ones before `weighed`.
        evidence: logarithm of the marginal likelihood of the observations, up to a constant.
        count: number of independent errors in the misfit.
    """

    first: Indices
    second: Indices
    share: Array
    scale: Array
    lambertian: Array
    log_prior: Array
    misfit: Array
    n_atoms: int
    log_posterior: Array
    evidence: float = 0.0
    count: float = 0.0

    @classmethod
    def fitted(cls, X: Array, y: Array, material_of: Indices, n_library: int | None = None) -> Mixtures:
        """Fit all mixtures of atoms, with the scale and Lambertian of each that have the largest posterior density.

        X (n + 1, R) holds the atoms and, last, the Lambertian at R observations, and y (R,) the observations. Both
        are whitened, so that errors have variance 1. `material_of` and `n_library` are described in `posterior`.
        """
        return cls.of_products(X @ X.T, X @ y, float(y @ y), material_of, n_library)

    @classmethod
    def of_products(
        cls,
        inner: Array,
        with_seen: Array,
        square: float,
        material_of: Indices,
        n_library: int | None = None,
    ) -> Mixtures:
        """Fit all mixtures to observations of which only inner products are given.

        Args:
            inner: inner products of the atoms and, last, the Lambertian, shape (n + 1, n + 1).
            with_seen: inner products of these with the observations, shape (n + 1,).
            square: squared norm of the observations.
            material_of, n_library: see `posterior`.
        """
        N = int(material_of[-1])
        n = len(material_of) - 1
        first, second, share = atom_pairs(N, n // N)
        log_prior = _log_prior(N, n // N, n_library)
        aa, al, ll = products(inner, first, second, share)
        # Gaussian priors of scale and Lambertian, as terms of the normal equations.
        of_scale, of_lambertian = SCALE_SPREAD**-2, LAMBERTIAN_SPREAD**-2
        aa, ll = aa + of_scale, ll + of_lambertian
        of_mixture = share * with_seen[first] + (1.0 - share) * with_seen[second] + of_scale
        scale, lambertian = two_nonnegative(aa, al, ll, of_mixture, float(with_seen[-1]))
        # Where both are optimal, the quadratic terms are half of minus the linear ones.
        misfit = np.maximum(square + of_scale - of_mixture * scale - with_seen[-1] * lambertian, 0.0)
        return cls(first, second, share, scale, lambertian, log_prior, misfit, n, log_prior)

    def weighed(self, count: float, norm: Array, exponent: float) -> Mixtures:
        """Return the mixtures with posterior probabilities.

        The likelihood is Student's t, divided by a power of the norm. Without the norm, the darkest mixture would be
        the most probable. The misfit is the sum of `count` independent errors. `norm` (H,) > 0 is the squared norm of
        each mixture over all directions, plus that of its residual.
        """
        log = self.log_prior + log_likelihood(self.misfit, count) - 0.5 * exponent * np.log(norm)
        evidence = log_sum(log)
        return replace(self, log_posterior=log - evidence, evidence=evidence, count=count)

    def alike(self, material_of: Indices, n_library: int | None = None) -> Alike:
        """Return the single atoms that explain the observations about as well as the best.

        The arguments are described in `posterior`.
        """
        n = self.n_atoms
        prior = material_prior(int(material_of[-1]), n_library, _WORLD_COATED)[material_of[:n]]
        log = np.log(prior) + _TEMPERED * log_likelihood(self.misfit[:n], self.count)
        return Alike(np.exp(log - log_sum(log)), np.arange(n), self.scale[:n], self.lambertian[:n], n)

    @property
    def probability(self) -> Array:
        """Posterior probabilities, which sum to 1, shape (H,)."""
        return np.exp(self.log_posterior)

    def of(self, values: Array) -> Array:
        """Return a linear functional of the mixtures (H,) from its values for the atoms and the Lambertian (n + 1,)."""
        of_pair = self.share * values[self.first] + (1.0 - self.share) * values[self.second]
        return self.scale * of_pair + self.lambertian * values[-1]

    def norm(self, inner: Array) -> Array:
        """Return the squared norms of the mixtures, shape (H,).

        `inner` holds the inner products of the atoms and, last, the Lambertian, shape (n + 1, n + 1).
        """
        return self.norm_of(products(inner, self.first, self.second, self.share))

    def norm_of(self, products: tuple[Array, Array, float]) -> Array:
        """Return the squared norms of the mixtures, shape (H,), from the `products` of unscaled mixtures."""
        aa, al, ll = products
        return self.scale**2 * aa + 2.0 * self.scale * self.lambertian * al + self.lambertian**2 * ll

    def weights(self, chosen: Indices) -> Array:
        """Return the weights of the atoms and the Lambertian in h chosen mixtures, shape (h, n + 1)."""
        weights, k = np.zeros((len(chosen), self.n_atoms + 1)), np.arange(len(chosen))
        weights[k, self.first[chosen]] += self.scale[chosen] * self.share[chosen]
        weights[k, self.second[chosen]] += self.scale[chosen] * (1.0 - self.share[chosen])
        weights[:, -1] += self.lambertian[chosen]
        return weights

    def most_probable(self, count: int) -> Indices:
        """Return the indices of the `count` most probable mixtures, most probable first."""
        count = min(count, len(self.log_posterior))
        some = np.sort(np.argpartition(-self.log_posterior, count - 1)[:count])
        return some[np.argsort(-self.log_posterior[some], kind="stable")]


@dataclass(frozen=True, eq=False)
class Alike:
    """Single atoms with a Lambertian, `a g + l L`, that explain observations about as well as the best atom.

    Their likelihood is tempered, because the posterior probabilities of mixtures are overconfident about unmeasured
    highlights: a few close fits take all the probability.

    Attributes:
        probability: probabilities of A atoms, which sum to 1, shape (A,).
        atoms: indices of the atoms, shape (A,).
        scale, lambertian: a and l, shape (A,).
        base: index of the Lambertian among the atoms.
    """

    probability: Array
    atoms: Indices
    scale: Array
    lambertian: Array
    base: int

    @property
    def as_bright_as_atoms(self) -> Alike:
        """Return the atoms scaled so that `scale` is 1, as bright as the library's materials."""
        scale = np.maximum(self.scale, _LEAST_SCALE)
        return replace(self, scale=self.scale / scale, lambertian=self.lambertian / scale)

    def of(self, values: Array) -> Array:
        """Return P linear functionals of these atoms, shape (A, P), from those of all atoms (n, P)."""
        return np.asarray(
            self.scale[:, None] * values[self.atoms] + np.outer(self.lambertian, values[self.base])
        )

    def geometric_mean(self, errors: Array) -> float:
        """Return the geometric mean of errors (A,), weighted by probability; each is limited to 0.001 to 1000."""
        return float(np.exp(self.probability @ np.log(np.clip(errors, 1e-3, 1e3))))


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses about an observed material: mixtures of one or two materials.

    Attributes:
        probability: probabilities of H hypotheses, which sum to 1, most probable first, shape (H,).
        weights: weights of n atoms, averaged over the bands, shape (H, n).
        mean: weights in every band, averaged over the hypotheses, shape (B, n).
        alike: single atoms that explain the observations about as well.
    """

    probability: Array
    weights: Array
    mean: Array
    alike: Alike

    def among(self, index: Indices, n: int) -> Hypotheses:
        """Return the hypotheses with weights of n atoms, zero for atoms that the hypotheses lack.

        `index` holds the positions of the hypotheses' atoms among the n.
        """
        weights, mean = np.zeros((len(self.weights), n)), np.zeros((len(self.mean), n))
        weights[:, index], mean[:, index] = self.weights, self.mean
        alike = replace(self.alike, atoms=index[self.alike.atoms], base=int(index[self.alike.base]))
        return replace(self, weights=weights, mean=mean, alike=alike)


def material_prior(N: int, n_library: int | None = None, coated: float = COATED) -> Array:
    """Return the prior probabilities (N,) of N materials; all except the first `n_library` are coats."""
    n = N if n_library is None else n_library
    coated = coated if n < N else 0.0
    return np.repeat([(1.0 - coated) / n, coated / max(N - n, 1)], [n, N - n])


def log_prior_of(first: Indices, second: Indices, prior: Array) -> Array:
    """Return the log prior probabilities (H,) of pairs of N materials; equal indices mean a single material.

    Mixtures of one material together have the probability `LIKE_ONE`, shared by the materials' prior (N,), see
    `material_prior`. Mixtures of two materials have the rest: pairs of measured materials get the prior share of
    measured materials, and all other pairs the share of coats, most of which goes to pairs of coats, a highlight and
    its haze.
    """
    is_one = first == second
    one = prior[first] / np.maximum(np.bincount(first[is_one], minlength=len(prior)), 1)[first]
    is_coat = prior != prior[0]
    n_coats = is_coat[first].astype(int) + is_coat[second]
    coated = prior[is_coat].sum()
    shares = np.array([1.0 - coated, coated * (1.0 - _TWO_COATS), coated * _TWO_COATS])
    two = (shares / np.maximum(np.bincount(n_coats[~is_one], minlength=3), 1))[n_coats]
    return np.log(np.where(is_one, LIKE_ONE * one, (1.0 - LIKE_ONE) * two))


def log_likelihood(misfit: Array, count: float) -> Array:
    """Return the log density of Student's t, up to a constant, for a sum of `count` standardised squared errors."""
    return np.asarray(-0.5 * (_FREEDOM + count) * np.log1p(misfit / _FREEDOM))


def log_sum(log: Array) -> float:
    """Return the logarithm of the sum of values, given their logarithms, without overflow; one at least must be finite.

    SciPy's `logsumexp` checks cases that do not occur here, and takes six times as long.
    """
    most = float(log.max())
    return most + float(np.log(np.exp(log - most).sum()))


def products(inner: Array, first: Indices, second: Indices, share: Array) -> tuple[Array, Array, float]:
    """Return the inner products of mixtures `x g_i + (1 - x) g_j` with themselves (H,) and with the Lambertian (H,).

    The third value is the Lambertian's squared norm. `inner` holds the inner products of the atoms and, last, the
    Lambertian, shape (n + 1, n + 1).
    """
    rest, own, last = 1.0 - share, np.diagonal(inner).copy(), inner[:, -1].copy()
    of_pairs = np.take(inner, first * len(inner) + second)  # four times as fast as by two indices
    aa = share**2 * own[first] + 2.0 * share * rest * of_pairs + rest**2 * own[second]
    return aa, share * last[first] + rest * last[second], float(inner[-1, -1])


@lru_cache(maxsize=4)
def atom_pairs(N: int, per_material: int) -> tuple[Indices, Indices, Array]:
    """Return the two atom indices and the share of all mixtures: each atom alone, and every pair in every share."""
    of = np.repeat(np.arange(N), per_material)
    i, j = np.triu_indices(len(of), 1)
    is_one = of[i] == of[j]
    two = np.flatnonzero(~is_one)
    if len(two) > _MOST_PAIRS:
        two = np.sort(np.random.default_rng(0).choice(two, _MOST_PAIRS, replace=False))
    kept = np.concatenate([np.flatnonzero(is_one), two])
    alone, i, j = np.arange(len(of)), i[kept], j[kept]
    first = np.concatenate([alone, *([i] * len(SHARES))])
    second = np.concatenate([alone, *([j] * len(SHARES))])
    return first, second, np.concatenate([np.ones(len(of)), np.repeat(SHARES, len(i))])


@lru_cache(maxsize=4)
def _log_prior(N: int, per_material: int, n_library: int | None) -> Array:
    """Return the logarithms of the prior of `atom_pairs`, (H,), see `log_prior_of`."""
    first, second, _ = atom_pairs(N, per_material)
    return log_prior_of(first // per_material, second // per_material, material_prior(N, n_library))


def two_nonnegative(aa: Array, ab: Array, bb: float, a: Array, b: float) -> tuple[Array, Array]:
    """Return the x, y >= 0 that minimise `aa x^2 + 2 ab x y + bb y^2 - 2 (a x + b y)`, for each of several problems."""
    determinant = aa * bb - ab**2
    x, y = (a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant
    x, y = np.where(y < 0.0, a / aa, x), np.maximum(y, 0.0)
    y = np.where(x < 0.0, max(b, 0.0) / bb, y)
    return np.maximum(x, 0.0), y


NOISE = 0.02
"""Standard deviation of the noise of cube roots, relative to their value and to their root mean square."""

MODEL_ERROR = 0.04
"""Standard deviation of the residual of the best mixture, relative to the cube roots and their root mean square."""

_REACH = 2.0  # correlation length of the residual of mixtures, in lengths of `residual`
_EXPONENT = 5.0  # power of the norm of mixtures by which their likelihood is divided
_COUNT = 100  # most hypotheses
_ALIKE = 0.07  # standard deviation between bands of the shares of materials
_COLOUR = 0.7  # weight of the differences between bands against their mean


@dataclass(frozen=True, eq=False)
class ReadingRoots:
    """Cube roots of a material and of atoms at P readings, whose errors are correlated at nearby directions.

    Attributes:
        atoms: cube roots of n atoms and, last, of the Lambertian, shape (n + 1, P).
        material: cube roots of the material in B bands, NaN if not measured, shape (B, P).
        weights: weights of the readings, shape (P,).
        where: coordinates of the directions, see `residual.coordinates`, shape (P, 3).
    """

    atoms: Array
    material: Array
    weights: Array
    where: Array

    def part(self, bands: Indices, readings: Mask) -> ReadingRoots:
        """Return the cube roots in some bands, given by index, at some readings, given by a mask."""
        material = self.material[bands][:, readings]
        return ReadingRoots(self.atoms[:, readings], material, self.weights[readings], self.where[readings])

    def whitened(self) -> tuple[Array, Array]:
        """Return atoms (n + 1, C) and material (B, C) transformed to independent differences of variance 1.

        C is the number of readings, or of averages over readings in the same cell.
        """
        cell = cells(self.where)
        total = np.bincount(cell, self.weights)

        def averaged(rows: Array) -> Array:
            return np.array([np.bincount(cell, row * self.weights) for row in rows]) / total

        atoms, material, where = averaged(self.atoms), averaged(self.material), averaged(self.where.T).T
        square = np.mean(material**2, axis=0)
        level = np.sqrt(square + np.average(square, weights=total) + 1e-12)
        noise = np.diag(NOISE**2 / total) + MODEL_ERROR**2 * covariance(where / _REACH, where / _REACH)
        L = np.linalg.cholesky(noise)
        white = [solve_triangular(L, (rows / level).T, lower=True).T for rows in (atoms, material)]
        return white[0], white[1]


@dataclass(frozen=True, eq=False)
class GlossReadings:
    """G readings of gloss: means of the luminance over apertures around mirror directions.

    The luminance is a sum over bands before the cube root, so gloss is not an `Observation` of one band.

    Attributes:
        atoms: cube roots of the means of n atoms and, last, of the Lambertian, shape (n + 1, G).
        roots: cube roots of the material's mean luminance, shape (G,).
        luminance: weight of each band of the readings in the luminance, shape (B,).
        where: coordinates of the mirror directions, see `residual.coordinates`, shape (G, 3).
        unit: mean of f over the apertures that makes one gloss unit, in 1/sr, shape (G,).
    """

    atoms: Array
    roots: Array
    luminance: Array
    where: Array
    unit: Array

    @classmethod
    def of(cls, gloss: GlossUnits, bands: Bands, atoms: Array) -> GlossReadings:
        """Return readings of gloss from gloss units by angle, given the cube roots (n + 1, G) of the atoms."""
        unit = np.array([value_of_unit(angle) for angle in gloss])
        mean = unit * list(gloss.values())
        theta = np.deg2rad(list(gloss), dtype=float)
        where = coordinates(from_spherical(theta, np.pi), from_spherical(theta, 0.0))
        return cls(atoms, np.cbrt(mean), luminance(np.eye(bands.count), bands), where, unit)

    def misfit(self, weights: Array, level: float) -> float:
        """Return the squared error of the gloss that weights (B, n + 1) predict, over its variance.

        `level` is the root mean square of the cube roots of the other readings.
        """
        variance = (NOISE**2 + MODEL_ERROR**2) * (self.roots**2 + level**2)
        return float(np.sum((self._luminous(weights @ self.atoms) - self.roots) ** 2 / variance))

    def differences(self, roots: Array) -> Array:
        """Return the relative differences (G,) of cube roots (B, G) from the measured gloss.

        Differences within one gloss unit are 0.
        """
        return gloss_differences(self._luminous(roots) ** 3 / self.unit, self.roots**3 / self.unit)

    def scaled(self, roots: Array) -> Array:
        """Scale cube roots (B, G) in every band so that their luminance is the measured one."""
        return np.asarray(roots * self.roots / np.maximum(self._luminous(roots), np.finfo(float).tiny))

    def _luminous(self, roots: Array) -> Array:
        return np.cbrt(np.maximum(self.luminance @ roots**3, 0.0))


def posterior(
    read: ReadingRoots, gram: Array, material_of: Indices, n_library: int | None = None
) -> Mixtures:
    """Return posterior probabilities of mixtures of two atoms, given readings of a material in one band.

    The likelihood is Student's t in cube roots, with residuals that are correlated at nearby directions; its heavy
    tails keep several mixtures probable if none fits the readings. It is divided by the fifth power of the mixture's
    norm, so that a predicted highlight that does not exist costs more than a missing one.

    `gram` (n + 1, n + 1) holds the inner products of the atoms over all directions. `material_of[k]` is the index of
    the material to which atom k belongs, N for the Lambertian; every material has the same number of atoms. The first
    `n_library` materials (None: all) are measured, the others are coats.
    """
    X, (y,) = read.whitened()
    mixtures, n_readings = Mixtures.fitted(X, y, material_of, n_library), len(y)
    share = np.sqrt(read.weights / len(read.weights))
    X, y = read.atoms * share, read.material[0] * share
    unexplained = np.maximum(mixtures.norm(X @ X.T) - 2.0 * mixtures.of(X @ y) + y @ y, 0.0)
    return mixtures.weighed(n_readings, mixtures.norm(gram) + unexplained, _EXPONENT)


def band_mixtures(
    mixtures: Mixtures,
    read: ReadingRoots,
    gram: Array,
    material_of: Indices,
    gloss: GlossReadings | None = None,
    n_library: int | None = None,
) -> Hypotheses:
    """Return posterior probabilities of mixtures of two materials, given readings in B bands.

    Single bands show better than their mean which materials the readings resemble, because the highlight of a coat is
    white and that of a metal coloured. In every band, weights >= 0 of the atoms of both materials and of the
    Lambertian are fitted; the shares of the materials stay near those of the mean over bands, to which `mixtures`
    were fitted. The likelihood, `gram`, `material_of` and `n_library` are those of `posterior`.
    """
    chosen = _of_different_materials(mixtures, material_of)
    structures = mixtures.weights(chosen)
    fitted = np.zeros((len(chosen), len(read.material), len(read.atoms)))
    misfit, count = ((mixtures.scale[chosen] - 1.0) / SCALE_SPREAD) ** 2, 0.0
    is_read = np.isfinite(read.material)
    any_read = is_read.any(axis=1)
    for mask in np.unique(is_read[any_read], axis=0):
        rows = np.flatnonzero((is_read == mask).all(axis=1))
        X, y = read.part(rows, mask).whitened()
        part = len(rows) / any_read.sum()
        count += part * (1.0 + _COLOUR) * y.shape[1]
        for h, structure in enumerate(structures):
            fitted[h, rows], of_bands = _fit_bands(X, y, structure, material_of)
            misfit[h] += part * of_bands
    of_mean = fitted[:, any_read].mean(axis=1)
    fitted[:, ~any_read] = of_mean[:, None]
    if gloss is not None:
        level = float(np.sqrt(np.mean(read.material[is_read] ** 2)))
        misfit += [gloss.misfit(weights, level) for weights in fitted]
        count += len(gloss.roots)
    residual = fitted @ read.atoms - np.where(is_read, read.material, 0.0)
    squares = np.sum(is_read * residual**2 * read.weights, axis=(1, 2)) / np.sum(is_read)
    norm = np.sum((of_mean @ gram) * of_mean, axis=1) + squares
    prior = material_prior(int(material_of[-1]), n_library)
    log_prior = log_prior_of(material_of[mixtures.first[chosen]], material_of[mixtures.second[chosen]], prior)
    probability = (
        replace(mixtures, log_prior=log_prior, misfit=misfit).weighed(count, norm, _EXPONENT).probability
    )
    order = np.argsort(-probability, kind="stable")
    mean = np.tensordot(probability, fitted, 1)
    return Hypotheses(probability[order], of_mean[order], mean, mixtures.alike(material_of, n_library))


def _of_different_materials(mixtures: Mixtures, material_of: Indices) -> Indices:
    """Return the most probable mixtures, one for every pair of materials and shares of them."""
    seen: dict[tuple[int, int, float], int] = {}
    for k in mixtures.most_probable(len(mixtures.log_posterior)).tolist():
        i, j = int(material_of[mixtures.first[k]]), int(material_of[mixtures.second[k]])
        share = float(mixtures.share[k])
        if i > j:
            i, j, share = j, i, 1.0 - share
        seen.setdefault((i, j, 1.0 if i == j else round(share, 3)), k)
        if len(seen) == _COUNT:
            break
    return np.array(list(seen.values()))


def _fit_bands(X: Array, y: Array, structure: Array, material_of: Indices) -> tuple[Array, float]:
    """Fit weights (b, n + 1) in some bands of the atoms of a mixture's materials; also return their misfit."""
    totals = np.bincount(material_of, structure)
    used = np.flatnonzero((totals[material_of] > 0.0) | (material_of == material_of[-1]))
    share = (material_of[used] == np.flatnonzero(totals[:-1] > 0.0)[:, None]) / _ALIKE
    towards = share @ structure[used]
    v = nonnegative_weights(X[used] @ X[used].T + share.T @ share, y @ X[used].T + towards @ share)
    residual = y - v @ X[used]
    mean = residual.mean(axis=0)
    apart = np.sum((v @ share.T - towards) ** 2) + _COLOUR * np.sum((residual - mean) ** 2)
    weights = np.zeros((len(y), len(material_of)))
    weights[:, used] = v
    return weights, float(mean @ mean + apart / len(y))
