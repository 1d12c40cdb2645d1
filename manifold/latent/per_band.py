"""The monochrome manifold: every band of every material is a sample, a material is a curve.

A sample's latent joins *structure* coordinates (gloss, layers), which all bands of a material share, with
*colour* coordinates, which are the band's own. Whole-material models are bounded by the span of the training
materials; a monochrome one combines 195 times as many samples, and the map of the structure coordinates is independent
of colour.

Samples are ordered material by material: sample n * B + b is band b of material n.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from manifold.latent.gp_weights import GPWeights
from manifold.latent.kernels import kernel_named, require_mu
from manifold.latent.objective import (
    LatentObjective,
    blas_threads,
    centre_gram,
    fix_gauge,
    require_different,
    require_gram,
    require_prior,
)
from manifold.records import Array

_COMPONENTS = 10  # principal components of the samples that starts are made of


class MonochromeGPLVM:
    """Gaussian-process latent variable model of monochrome samples with shared structure coordinates.

    Minimises the objective of `GPLVM` over structure (N, Q_s) and colour (N, B, Q_c) by L-BFGS from two starts,
    and keeps the better end. Larger colour coordinates are brighter.

    Args:
        n_structure: Q_s, coordinates that the bands of a material share; 0 is allowed.
        n_colour: Q_c, coordinates of each band, at least 1.
        mu, length_scale, kernel: of the covariance function; the kernel's name as `kernel_named` takes it.
        prior: weight of the Gaussian prior on the latents per output and sample.
        max_iter: limit on iterations of L-BFGS from each start.

    Attributes:
        structure_: shape (N, Q_s).
        colour_: shape (N, B, Q_c).
        embedding_: latents of all samples, structure first, shape (N * B, Q_s + Q_c).
        gp_: `GPWeights` of the embedding.
        objective_, objective_start_: at the end and at the better start.
    """

    def __init__(
        self,
        n_structure: int = 2,
        n_colour: int = 1,
        *,
        mu: float = 1e-4,
        length_scale: float = 1.0,
        kernel: str = "se",
        prior: float = 0.1,
        max_iter: int = 300,
    ) -> None:
        require_mu(mu)
        require_prior(prior)
        self.n_structure = n_structure
        self.n_colour = n_colour
        self.kernel = kernel_named(kernel, mu, length_scale)
        self.prior = prior
        self.max_iter = max_iter

    def fit_gram(self, S: Array, n_materials: int, n_outputs: int) -> MonochromeGPLVM:
        """Fit to the Gram matrix of all samples.

        Args:
            S: shape (N * B, N * B), samples ordered material by material; centred here.
            n_materials: N, at least 2, a divisor of the side of S.
            n_outputs: direction pairs behind S.
        Raises:
            ShapeError: S is not square, symmetric and finite, or all samples are identical.
        """
        S = require_gram(S, n_outputs)
        centred = centre_gram(S)
        require_different(centred, float(np.trace(S)))
        n_bands = S.shape[0] // n_materials
        objective = LatentObjective(centred, n_outputs, self.kernel, self.prior)
        best: tuple[float, float, Array, Array] | None = None
        with blas_threads(S.shape[0]):
            for structure, colour in self._starts(centred, n_materials, n_bands):
                start, end, structure, colour = self._refine(objective, structure, colour)
                if best is None or end < best[1]:
                    best = (start, end, structure, colour)
        assert best is not None
        self.objective_start_, self.objective_, structure, colour = best
        centre = not self.kernel.has_origin
        colour = _towards_brighter(colour - colour.mean(axis=0) if centre else colour, np.diag(S))
        self.structure_ = fix_gauge(structure, centre=centre)
        self.colour_ = colour.reshape(n_materials, n_bands, -1)
        latents = join_latents(self.structure_, self.colour_)
        self.embedding_ = latents.reshape(-1, self.n_structure + self.n_colour)
        self.gp_ = GPWeights(self.embedding_, self.kernel)
        self.gp_.warn_of_fit(centred)
        return self

    def _refine(
        self, objective: LatentObjective, structure: Array, colour: Array
    ) -> tuple[float, float, Array, Array]:
        """F at the start and at the end of L-BFGS, and the latents there: (N, Q_s), (N * B, Q_c)."""
        N, B = structure.shape[0], colour.shape[0] // structure.shape[0]
        split = N * self.n_structure

        def unpack(z: Array) -> tuple[Array, Array]:
            return z[:split].reshape(N, self.n_structure), z[split:].reshape(N * B, self.n_colour)

        def value_and_gradient(z: Array) -> tuple[float, Array]:
            s, c = unpack(z)
            F, gradient = objective(np.hstack([np.repeat(s, B, axis=0), c]))
            shared = gradient[:, : self.n_structure].reshape(N, B, self.n_structure).sum(axis=1)
            return F, np.concatenate([shared.ravel(), gradient[:, self.n_structure :].ravel()])

        z0 = np.concatenate([structure.ravel(), colour.ravel()])
        found = minimize(
            value_and_gradient, z0, jac=True, method="L-BFGS-B", options={"maxiter": self.max_iter}
        )
        return (value_and_gradient(z0)[0], float(found.fun), *unpack(found.x))

    def _starts(self, S: Array, N: int, B: int) -> list[tuple[Array, Array]]:
        """Two ways to separate structure from colour by principal components: (N, Q_s) and (N * B, Q_c) each."""
        count = min(_COMPONENTS, S.shape[0])
        values, vectors = np.linalg.eigh(S)
        scores = vectors[:, ::-1][:, :count] * np.sqrt(np.maximum(values[::-1][:count], 0.0))
        colour = _unit_components(scores, self.n_colour)
        if self.n_structure == 0:
            return [(np.zeros((N, 0)), colour)]
        # Colour first: it is regressed out of the samples before materials are compared.
        design = np.column_stack([np.ones(N * B), colour])
        rest = scores - design @ np.linalg.lstsq(design, scores, rcond=None)[0]
        means = scores.reshape(N, B, -1).mean(axis=1)
        return [
            (_unit_components(rest.reshape(N, B, -1).mean(axis=1), self.n_structure), colour),
            # Structure first: colour is how a band differs from its material's mean.
            (
                _unit_components(means, self.n_structure),
                _unit_components(scores - np.repeat(means, B, axis=0), self.n_colour),
            ),
        ]


def join_latents(structure: Array, colour: Array) -> Array:
    """Latents of samples (N, B, Q_s + Q_c) from structure (N, Q_s) and colour (N, B, Q_c)."""
    shared = np.broadcast_to(structure[:, None, :], (*colour.shape[:2], structure.shape[1]))
    return np.concatenate([shared, colour], axis=2)


def _towards_brighter(colour: Array, brightness: Array) -> Array:
    """Colours (N B, Q_c) with every axis turned so that samples of larger norm have larger coordinates."""
    slope = (brightness - brightness.mean()) @ colour
    return colour * np.where(slope < 0, -1.0, 1.0)


def _unit_components(A: Array, count: int) -> Array:
    """The first principal components of the rows of A, of unit variance; 0 where A does not span them."""
    U, singular, _ = np.linalg.svd(A - A.mean(axis=0), full_matrices=False)
    spanned = min(count, int(np.count_nonzero(singular > 1e-10 * max(singular[0], 1e-300))))
    out = np.zeros((A.shape[0], count))
    out[:, :spanned] = U[:, :spanned] * np.sqrt(A.shape[0])
    return out
