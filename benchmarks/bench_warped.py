"""Prediction in RGL's own coordinates, against prediction at pairs of directions: do highlights widen or cross-fade?

    python benchmarks/bench_warped.py --midpoints            # between two synthetic roughnesses, against the truth
    python benchmarks/bench_warped.py FOLDER --model "whole 6"

An isotropic RGL file follows from its profile of normals D(theta_h), 128 numbers, and its spectra on the warped unit
square: projected area and visible normals are integrals of D. Materials are combined there: T'^-1 of the sum of
T'(D), T^-1 of the sum of T(spectra). Encoding minimises the mapped residual, then the decoded error, by differences.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_held_out import MODELS
from scipy.ndimage import distance_transform_edt
from scipy.optimize import minimize
from trial_models import CUBE_ROOT, fit_gram

from manifold.brdf import cells, goniometer
from manifold.brdf.analytic import GGX, Plastic, RoughConductor
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.directions import from_spherical
from manifold.io_rgl import read_bsdf
from manifold.latent.criteria import Products, mapped_residual
from manifold.latent.encoder import Encoder
from manifold.metrics import RusinkiewiczGrid, cosine_weight, relative_error
from manifold.records import Array, Bands, BsdfFile, evenly_spaced
from manifold.system.parallel import one_blas_thread

NODES = 128  # of a profile
SIDE = 63  # of the common unit square; the 32 nodes of a file are among them
BANDS = 5  # at most
_U = np.linspace(0.0, 1.0, NODES)
_PROFILES: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "log": (np.log, np.exp),
    "power -1/2": (lambda D: D**-0.5, lambda L: np.maximum(L, 5e-3) ** -2.0),
    "power -1/4": (lambda D: D**-0.25, lambda L: np.maximum(L, 5e-2) ** -4.0),
}  # T' and its inverse; D^-1/2 of a GGX lobe is linear in the squared tangent over the roughness


@dataclass(frozen=True, eq=False)
class Warped:
    """A material in RGL's coordinates: profile (128,), spectra (T, B, SIDE, SIDE) at common elevations (T,)."""

    profile: Array
    spectra: Array

    @classmethod
    def of_file(cls, file: BsdfFile, theta: Array, bands: Array) -> Warped:
        """Resampled; cells that hold nothing take their nearest neighbour's values."""
        spectra = file.spectra[0][:, bands].astype(np.float64)
        for t in range(len(spectra)):
            unmeasured = np.all(spectra[t] == 0, axis=0)
            if unmeasured.any() and not unmeasured.all():
                nearest = distance_transform_edt(unmeasured, return_distances=False, return_indices=True)
                spectra[t] = spectra[t][:, nearest[0], nearest[1]]
        for axis in (2, 3):
            spectra = _resampled(
                spectra, np.linspace(0.0, 1.0, spectra.shape[axis]), np.linspace(0.0, 1.0, SIDE), axis
            )
        spectra = _resampled(spectra, file.theta_i_rad.astype(np.float64), theta, 0)
        return cls(np.maximum(file.ndf[0].astype(np.float64), 1e-12), spectra)

    def build(self, template: BsdfFile, theta: Array) -> MeasuredBRDF:
        """The BRDF, with projected area and visible normals of the profile."""
        B = self.spectra.shape[1]
        sigma = _AREA @ self.profile
        visible = np.stack(
            [goniometer._visible_normals(np.tile(self.profile, (NODES, 1)), w) for w in _incident(theta)]
        )
        return MeasuredBRDF(
            replace(
                template, ndf=np.tile(self.profile, (2, 1)), sigma=np.tile(sigma, (2, 1)), vndf=visible[None],
                spectra=self.spectra[None].astype(np.float32), luminance=self.spectra.mean(axis=1)[None],
                theta_i_rad=theta, wavelengths_nm=None if B == 3 else np.linspace(400.0, 700.0, B),
            )
        )  # fmt: skip


def _resampled(values: Array, old: Array, new: Array, axis: int) -> Array:
    k = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 2)
    t = np.clip((new - old[k]) / (old[k + 1] - old[k]), 0.0, 1.0).reshape(-1, *[1] * (values.ndim - 1 - axis))
    return np.take(values, k, axis=axis) * (1.0 - t) + np.take(values, k + 1, axis=axis) * t


def _incident(theta: Array) -> Array:
    return from_spherical(np.minimum(theta, np.deg2rad(89.0)), 0.0)


def _area_matrix(fine: int = 2048, n_phi: int = 256) -> Array:
    """From D at its nodes to the projected area at the incident elevations of the nodes, (128, 128)."""
    u = (np.arange(fine) + 0.5) / fine
    theta, incident = cells.u_to_theta(u), cells.u_to_theta(_U)
    cos_phi = np.cos((np.arange(n_phi) + 0.5) * 2.0 * np.pi / n_phi)
    measure = np.pi * u * np.sin(theta) * 2.0 * np.pi / fine
    hats = np.maximum(1.0 - np.abs(u[:, None] * (NODES - 1) - np.arange(NODES)), 0.0)
    rows = []
    for a in incident:
        cosine = np.sin(theta)[:, None] * np.sin(a) * cos_phi + np.cos(theta)[:, None] * np.cos(a)
        rows.append((np.maximum(cosine, 0.0).mean(axis=1) * measure) @ hats)
    return np.array(rows)


_AREA = _area_matrix()


def _pairs() -> tuple[Array, Array, Array]:
    wi, wo, above = RusinkiewiczGrid.named("default").directions()
    return wi[above], wo[above], cosine_weight(wi[above], wo[above])


def midpoints() -> None:
    """Between two roughnesses: the best point on the line between two files, against the analytic truth."""
    bands = Bands((450.0, 550.0, 650.0))
    kinds: dict[str, Callable[[float], BRDF]] = {
        "plastic": lambda a: Plastic(GGX.isotropic(a), np.array(1.5), np.array([0.1, 0.3, 0.5]), bands),
        "metal": lambda a: RoughConductor(
            GGX.isotropic(a), np.array([0.2, 0.5, 1.2]), np.array([3.0, 2.5, 2.4]), bands
        ),
    }
    wi, wo, weight = _pairs()
    theta = goniometer.default_theta_i(8).astype(np.float32).astype(np.float64)
    shares = np.linspace(0.0, 1.0, 21)
    print(
        "| material | roughnesses | measured | identity | cube root | "
        + " | ".join(f"D {k}" for k in _PROFILES)
        + " |"
    )
    print("|---" * (5 + len(_PROFILES)) + "|")
    for name, make in kinds.items():
        for a, c in ((0.04, 0.16), (0.1, 0.25), (0.1, 0.4), (0.2, 0.6)):
            middle = float(np.sqrt(a * c))
            truth = make(middle).eval(wi, wo)
            files = [goniometer.measure(make(x), name, theta_i_rad=theta) for x in (a, c, middle)]
            f, g, measured = (MeasuredBRDF(file).eval(wi, wo) for file in files)
            first, second = (Warped.of_file(file, theta, np.arange(3)) for file in files[:2])
            rows = [relative_error(truth, measured, weight)]
            rows.append(min(relative_error(truth, (1 - t) * f + t * g, weight) for t in shares))
            rows.append(
                min(
                    relative_error(truth, ((1 - t) * np.cbrt(f) + t * np.cbrt(g)) ** 3, weight)
                    for t in shares
                )
            )
            for forward, inverse in _PROFILES.values():
                errors = []
                for t in shares:
                    profile = inverse((1 - t) * forward(first.profile) + t * forward(second.profile))
                    spectra = ((1 - t) * np.cbrt(first.spectra) + t * np.cbrt(second.spectra)) ** 3
                    between = Warped(profile, spectra).build(files[0], theta)
                    errors.append(relative_error(truth, between.eval(wi, wo), weight))
                rows.append(min(errors))
            cells = " | ".join(f"{row:.3f}" for row in rows)
            print(f"| {name} | {a:g}, {c:g} to {middle:.2f} | {cells} |", flush=True)


class Held:
    """Held-out errors of a model whose outputs are profiles and spectra."""

    def __init__(self, folder: Path, model: str, profile: str, share: float) -> None:
        self.setting = MODELS[model]
        self.files = [read_bsdf(path) for path in sorted(folder.glob("*.bsdf"))]
        self.theta = (
            np.mean([file.theta_i_rad for file in self.files], axis=0).astype(np.float32).astype(np.float64)
        )
        bands = evenly_spaced(self.files[0].spectra.shape[2], BANDS)
        warped = [Warped.of_file(file, self.theta, bands) for file in self.files]
        self.wi, self.wo, self.weight = _pairs()
        self.truth = [MeasuredBRDF(f).select_bands(bands.tolist()).eval(self.wi, self.wo) for f in self.files]
        N, B = len(warped), len(bands)
        self.group = 1 if self.setting.whole else B
        forward, self.inverse = _PROFILES[profile]
        T = np.moveaxis(
            CUBE_ROOT.forward(np.stack([w.spectra for w in warped])), 2, 1
        )  # [N, B, T, SIDE, SIDE]
        elevations = np.cos(self.theta) * np.sin(self.theta) + 0.02
        self.spectra = T.reshape(N * self.group, -1)
        self.profiles = np.repeat(forward(np.stack([w.profile for w in warped])), self.group, axis=0)
        left = (T * np.sqrt(elevations)[:, None, None]).reshape(N * self.group, -1)
        right = self.profiles * np.sqrt(_U * np.sin(cells.u_to_theta(_U)) + 1e-3)
        left, right = left - left.mean(axis=0), right - right.mean(axis=0)
        self.features = np.hstack([left, right * np.sqrt(share * np.sum(left**2) / np.sum(right**2))])
        self.S = self.features @ self.features.T
        self.shape = (B, len(self.theta), SIDE, SIDE)

    def error(self, V: Array, columns: Array, i: int, stride: slice = slice(None)) -> float:
        """Of material i, predicted by weights V (R, n) of samples."""
        spectra = CUBE_ROOT.inverse(np.maximum(V @ self.spectra[columns], 0.0)).reshape(self.shape)
        profile = np.clip(self.inverse((V @ self.profiles[columns]).mean(axis=0)), 1e-8, 1e7)
        brdf = Warped(profile, np.moveaxis(spectra, 0, 1)).build(self.files[i], self.theta)
        f = brdf.eval(self.wi[stride], self.wo[stride])
        return relative_error(self.truth[i][stride], f, self.weight[stride])

    def leave_out(self, i: int) -> float:
        """The held-out error of material i."""
        setting, Qs = self.setting, self.setting.structure
        others = np.delete(np.arange(len(self.files)), i)
        columns = (others[:, None] * self.group + np.arange(self.group)).reshape(-1)
        S = self.S[np.ix_(columns, columns)]
        D = self.features.shape[1]
        process = fit_gram(S, len(others), D, setting)[0]
        own = np.arange(i * self.group, (i + 1) * self.group)
        cross, norm = self.S[np.ix_(own, columns)], np.diag(self.S)[own]
        weights = setting.priors
        encoder = Encoder(process, S, D, Qs, self.group, weights, "mapped")
        products = Products.centred(S, cross, norm)
        residual = mapped_residual(products)
        ends = [encoder.minimise(residual, start)[0] for start in encoder.starts(products)]
        R, Q = ends[0].shape

        def unpack(z: Array) -> Array:
            return np.hstack([np.tile(z[:Qs], (R, 1)), z[Qs:].reshape(R, Q - Qs)])

        def decoded(z: Array) -> float:
            x = unpack(z)
            error = self.error(process.weights(x), columns, i, slice(None, None, 18))
            return R * float(np.log(error)) + 0.5 * float(np.sum(weights * x * x))

        starts = sorted((np.concatenate([x[0, :Qs], x[:, Qs:].ravel()]) for x in ends), key=decoded)[:3]
        options = {"maxiter": 15, "eps": 1e-4}
        found = [minimize(decoded, z, method="L-BFGS-B", options=options) for z in starts]
        best = min(found, key=lambda end: end.fun).x
        return self.error(process.weights(unpack(best)), columns, i)


def main() -> None:
    """Print one row, or the table of midpoints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--midpoints", action="store_true")
    parser.add_argument("--model", default="whole 6", choices=MODELS)
    parser.add_argument("--profile", default="log", choices=_PROFILES)
    parser.add_argument("--share", type=float, default=1.0, help="of the profile beside the spectra")
    parser.add_argument("--every", type=int, default=1, help="leave out only every Nth material")
    args = parser.parse_args()
    if args.midpoints or args.folder is None:
        midpoints()
        return
    start = time.perf_counter()
    held = Held(args.folder, args.model, args.profile, args.share)
    with one_blas_thread:
        errors = np.array([held.leave_out(i) for i in range(0, len(held.files), args.every)])
    print("| row | geometric mean | median | 90th pct. | seconds |\n|---|---|---|---|---|")
    print(
        f"| {args.model}, warped, D {args.profile} | {np.exp(np.log(errors).mean()):.3f} | {np.median(errors):.3f} "
        f"| {np.percentile(errors, 90):.3f} | {time.perf_counter() - start:.0f} |"
    )


if __name__ == "__main__":
    main()
