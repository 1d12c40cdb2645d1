"""Failure modes of manifolds: settings, libraries, points and searches that give unreliable predictions.

Most modes predict a plastic that lies between the measured ones, and divide its error by that of the nearest
measured material.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.core.records import Array, BsdfFile
from manifold.gp.kernels import SquaredExponential
from manifold.gp.likelihood import centre_gram, pca_start
from manifold.gplvm import GPLVM
from manifold.gpr import GaussianProcess
from manifold.model.combination import Combination
from manifold.model.decoding import REFLECTANCE_INCIDENCE_DEG
from manifold.model.gplvm_space import GplvmSpace
from manifold.model.manifold import Manifold
from manifold.model.prediction import PredictedBRDF
from manifold.registries import MAPPINGS
from manifold.study.stability.testbed import ALPHAS, COLOURS, MIDDLE, TestBed, in_space, named, predict
from manifold.study.stability.trials import BALL, HALF_OF_NEAREST, Limit, Measurement, Mode, Trial

KINDS = ("gplvm", "blend")


def held_out(bed: TestBed, alpha: float = MIDDLE) -> MeasuredBRDF:
    """Return the left-out plastic, which is measured but not in the family."""
    return MeasuredBRDF(bed.file(alpha, COLOURS[1]))


def in_error_of_nearest(bed: TestBed, found: BRDF) -> float:
    """Return the prediction error of the left-out plastic, divided by the error of the nearest material."""
    truth = held_out(bed)
    nearest = bed.cached(
        "error of the nearest", lambda: min(bed.error(MeasuredBRDF(file), truth) for file in bed.family)
    )
    return bed.error(found, truth) / nearest


def _held_out_in(bed: TestBed, model: Manifold) -> Measurement:
    """Measure the left-out plastic, embedded in a model."""
    truth = held_out(bed)
    brdf, messages = bed.embed(model, truth)
    return Measurement(in_error_of_nearest(bed, brdf), messages)


def _of_kinds(trial: Callable[[str, TestBed, float], Measurement]) -> dict[str, Trial]:
    """Return a trial for each kind of manifold."""
    return {kind: partial(trial, kind) for kind in KINDS}


def _fitted(files: Callable[[TestBed, float], Sequence[BsdfFile]]) -> dict[str, Trial]:
    """Return trials of the left-out plastic in models of each kind, fitted to files that depend on severity."""
    return _of_kinds(partial(_fitted_to, files))


def _fitted_to(
    files: Callable[[TestBed, float], Sequence[BsdfFile]], kind: str, bed: TestBed, severity: float
) -> Measurement:
    return _held_out_in(bed, bed.fit(files(bed, severity), kind))


# -- the kernel --------------------------------------------------------------------------------------------


def _rescaled(kind: str, bed: TestBed, length_scale: float) -> Measurement:
    """Measure the left-out plastic under a length scale other than that for which the latents were fitted."""
    truth, fitted = held_out(bed), bed.model(kind)
    known = fitted.embed(truth)
    kernel = replace(fitted.space.kernel, length_scale=length_scale)
    model = in_space(fitted, replace(fitted.space, kernel=kernel))  # type: ignore[type-var]
    brdf, messages = predict(model, known.latent, known.colours)
    return Measurement(in_error_of_nearest(bed, brdf), messages)


def _with_prior(kind: str, bed: TestBed, length_scale: float) -> Measurement:
    """Measure the left-out plastic under a length scale to which the prior keeps the latents from adapting."""
    prior = {"prior": 1.0} if kind == "gplvm" else {}  # blends have none
    return _held_out_in(bed, bed.fit(bed.family, kind, length_scale=length_scale, **prior))


def _with_noise(bed: TestBed, power: float) -> Measurement:
    return _held_out_in(bed, bed.fit(bed.family, "gplvm", mu=10.0**-power))


# -- the library -------------------------------------------------------------------------------------------


def _with_copies(bed: TestBed, count: float) -> list[BsdfFile]:
    """Return the family, and copies of one member."""
    return [*bed.family, *(replace(bed.family[4], name=f"copy_{k}") for k in range(int(count)))]


def _scaled(file: BsdfFile, factor: float, name: str) -> BsdfFile:
    return replace(file, name=name, spectra=(file.spectra * factor).astype(np.float32))


def _with_near_copy(bed: TestBed, power: float) -> list[BsdfFile]:
    return [*bed.family, _scaled(bed.family[4], 1.0 + 10.0**-power, "near_copy")]


def _with_outlier(bed: TestBed, factor: float) -> list[BsdfFile]:
    return [*bed.family, _scaled(bed.family[4], factor, "outlier")]


def _of_few(kind: str, bed: TestBed, left_out: float) -> Measurement:
    # The smoothest are left out first: what is held out comes to lie outside.
    files = bed.family[int(left_out) :]
    truth, model = held_out(bed), bed.fit(files, kind, latent_dim=2 if len(files) > 2 else 1)
    brdf, messages = bed.embed(model, truth)
    return Measurement(bed.ball_difference(brdf, truth), messages)


def _in_dimensions(kind: str, bed: TestBed, count: float) -> Measurement:
    return _held_out_in(bed, bed.fit(bed.family, kind, latent_dim=int(count)))


def _sharper(kind: str, bed: TestBed, ratio: float) -> Measurement:
    """Measure the prediction of a lobe that is sharper than all of the library, by a factor of roughness."""
    truth = held_out(bed, ALPHAS[0] / ratio)
    brdf, messages = bed.embed(bed.model(kind), truth)
    return Measurement(bed.ball_difference(brdf, truth), messages)


# -- colours -----------------------------------------------------------------------------------------------


def _requested(bed: TestBed, reflectance: float) -> list[Measurement]:
    """Measure predictions at several materials' latents in a requested grey."""
    model = bed.model("blend")
    requested = np.full(model.bands.count, reflectance)
    found = []
    for x in model.X[::3]:
        colours, claimed = model.colours.of_reflectance(x, requested)
        brdf, messages = predict(model, x, colours, float(np.abs(claimed - requested).max()))
        reached = brdf.albedo(from_spherical(np.deg2rad(REFLECTANCE_INCIDENCE_DEG), 0.0))
        found.append(Measurement(float(np.abs(reached - requested).max()), messages))
    return found


# -- away from the materials -------------------------------------------------------------------------------

_RAYS = 6

Places = Callable[[TestBed, float], Iterator[tuple[PredictedBRDF, tuple[str, ...]]]]
"""A function that yields predictions at a distance outside the materials, with their diagnostics."""


def _from_outermost(
    kind: str, settings: dict[str, str], bed: TestBed, distance: float
) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
    """Yield predictions beyond the outermost material in each of several directions."""
    model = bed.model(kind, **settings)
    angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
    for ray in np.stack([np.cos(angles), np.sin(angles)], axis=1):
        outermost = model.X[np.argmax(model.X @ ray)]
        yield predict(model, outermost + distance * model.space.kernel.length_scale * ray)


def _brighter(bed: TestBed, distance: float) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
    """Yield predictions at the latents of materials, in colours brighter than theirs."""
    model = bed.model("blend")
    for x, colours in zip(model.X[::3], model.space.own_colours[::3], strict=True):
        yield predict(model, x, colours + distance * model.space.kernel.length_scale)


def _outside(places: Places, bed: TestBed, distance: float) -> list[Measurement]:
    """Measure the difference between the ball of each prediction and that of the nearest plastic."""
    return [
        Measurement(bed.ball_difference_to_plastics(brdf), messages)
        for brdf, messages in places(bed, distance)
    ]


def _across(ratio: float) -> tuple[str, str, float]:
    """Return two members of the family, whose roughness differs by a ratio, and the roughness halfway."""
    rough = ALPHAS[-1]
    smooth = min(ALPHAS, key=lambda alpha: abs(rough / alpha - ratio))
    return named(smooth, 1), named(rough, 1), float(np.sqrt(smooth * rough))


def _on_the_map(kind: str, bed: TestBed, a: str, b: str, t: float) -> BRDF:
    """Return the prediction between two materials on a map."""
    model = bed.model(kind)
    return model.predict(model.between(a, b, t))


def _on_the_walk(bed: TestBed, a: str, b: str, t: float) -> BRDF:
    return bed.model("blend").interpolate(a, b, t)


def _on_the_way(walk: Callable[[TestBed, str, str, float], BRDF], bed: TestBed, ratio: float) -> Measurement:
    """Measure the best of nine predictions between two materials against the plastic halfway."""
    a, b, middle = _across(ratio)
    truth = held_out(bed, middle)
    ends = [MeasuredBRDF(file) for file in bed.family if file.name in (a, b)]
    nearest = min(bed.error(end, truth) for end in ends)
    found = min(bed.error(walk(bed, a, b, float(t)), truth) for t in np.linspace(0.1, 0.9, 9))
    return Measurement(found / nearest)


# -- the search for latents --------------------------------------------------------------------------------

_MAPPING = MAPPINGS["cube-root"]
_SEARCHES = ("dls", "l-bfgs")


def _gram(bed: TestBed) -> Array:
    """Return inner products of the family, in the order of its models."""
    names = [file.name for file in bed.family]
    order = [names.index(name) for name in bed.model("gplvm").names]
    return bed.data.gram(_MAPPING)[np.ix_(order, order)]


def _fit(bed: TestBed, S: Array, optimizer: str, start: Array | None = None) -> GPLVM:
    return GPLVM(2, optimizer=optimizer).fit_gram(S, bed.data.n_outputs, X0=start)


def _held_out_by(bed: TestBed, fitted: GPLVM) -> Measurement:
    """Measure the left-out plastic, embedded in a manifold with these latents of the family."""
    truth = held_out(bed)
    space = GplvmSpace(fitted.embedding_, fitted.gram_, fitted.n_outputs_, fitted.gp_.kernel)
    brdf, messages = bed.embed(in_space(bed.model("gplvm"), space), truth)
    return Measurement(in_error_of_nearest(bed, brdf), messages)


# -- starts and ambiguities --------------------------------------------------------------------------------


def _from_start(optimizer: str, bed: TestBed, scale: float) -> Measurement:
    """Measure a fit that starts at principal components with random noise of a standard deviation."""
    S = _gram(bed)
    start = pca_start(centre_gram(S), 2) + scale * np.random.default_rng(0).normal(size=(len(S), 2))
    return _held_out_by(bed, _fit(bed, S, optimizer, start))


def _again(optimizer: str, bed: TestBed, change: float) -> Measurement:
    """Measure how far latents move after a small change of the library's order and values."""
    S, rng = _gram(bed), np.random.default_rng(0)
    first = bed.cached(("fit", optimizer), lambda: _fit(bed, S, optimizer).embedding_)
    order, scale = rng.permutation(len(S)), 1.0 + change * rng.normal(size=len(S))
    other = (S * scale[:, None] * scale)[np.ix_(order, order)]
    X = np.empty_like(first)
    X[order] = _fit(bed, other, optimizer).embedding_
    return Measurement(float(np.abs(X - first).max() / np.ptp(first)))


# -- numbers -----------------------------------------------------------------------------------------------


def _ill_conditioned(bed: TestBed, length_scale: float) -> Measurement:
    """Measure the left-out plastic with the weights of a kernel without observation noise."""
    model, truth = bed.model("gplvm"), held_out(bed)
    x = bed.cached("latent of the left-out plastic", lambda: model.embed(truth).latent)
    weights = GaussianProcess(model.X, SquaredExponential(0.0, length_scale)).weights(x[None])[0]
    brdf = PredictedBRDF(model.materials.filled(), Combination(model.mapping, weights))
    return Measurement(in_error_of_nearest(bed, brdf))


MODES: tuple[Mode, ...] = (
    Mode(
        "short_length_scale", "the kernel of a shorter length scale with latents that were fitted for l = "
        "1", "length scale l",
        (1.0, 0.3, 0.1, 0.01), HALF_OF_NEAREST, _of_kinds(_rescaled),
        "Predictions between materials revert to the mean: fit again with the default `length_scale`.",
    ),
    Mode(
        "long_length_scale", "fits with a long length scale, whose prior keeps the latents near the "
        "centre", "length scale l",
        (1.0, 100.0, 1000.0), HALF_OF_NEAREST, _of_kinds(_with_prior),
        "The map becomes linear: fit again with the default `length_scale` and `prior`.",
    ),
    Mode(
        "no_noise", "the observation noise mu of a fit", "-log10 mu", (3.0, 10.0, 11.0), HALF_OF_NEAREST,
        {"gplvm": _with_noise},
        "Keep the default mu; below 1e-10 the covariance cannot be factorised, and the fit is refused.",
    ),
    Mode(
        "duplicates", "copies of one material in the library", "copies", (1, 6), HALF_OF_NEAREST,
        _fitted(_with_copies),
        "No action needed: copies share a latent and only cost time.",
    ),
    Mode(
        "near_duplicates", "a second measurement of a material in the library", "-log10 of the difference",
        (1.0, 6.5), HALF_OF_NEAREST, _fitted(_with_near_copy),
        "No action needed: nearly equal measurements get nearby latents.",
    ),
    Mode(
        "outlier", "one material of the library that is too bright by a factor", "factor", (1.0, 10.0, 1000.0),
        HALF_OF_NEAREST, _fitted(_with_outlier),
        "Look for a material far from all others on `manifold map`, and build the library without it.",
    ),
    Mode(
        "few_materials", "a library of only the roughest materials", "materials left out of 12", (4, 8, 10, 11),
        replace(
            BALL,
            reason=f"{BALL.reason}: with a visible difference, 1 (Paravina et al. 2015), blends of two materials "
            "are silently wrong",
        ),
        _of_kinds(_of_few),
        "Import more materials, on both sides of the requested one; a handful does not span a manifold.",
    ),
    Mode(
        "many_dimensions", "latent dimensions, of 12 materials", "Q", (2, 11, 12), HALF_OF_NEAREST,
        _of_kinds(_in_dimensions),
        "Ask for fewer dimensions than materials; 2 or 3 suffice for most libraries.",
    ),
    Mode(
        "sharper_than_library", "embedding of a lobe sharper than any measured", "times sharper",
        (1.0, 1.25, 1.5, 2.0, 10.0),
        BALL,
        _of_kinds(_sharper),
        "Import materials as sharp as that one: combining the lobes of a library does not give a sharper lobe.",
    ),
    Mode(
        "impossible_reflectance", "a requested reflectance that no material has", "reflectance",
        (0.3, 0.6, 0.9, 3.0),
        Limit(
            "difference between the requested and the predicted reflectance", 0.05,
            "a step of 3 to 6 in CIELAB lightness between reflectances of 0.6 and 0.2",
        ),
        {"blend": _requested},
        "Request a reflectance between those of the surrounding materials; the warning gives the error of the "
        "nearest one.",
    ),
    Mode(
        "outside_materials", "predictions outside the materials", "length scales from the outermost material",
        (0.0, 0.25, 0.5, 1.0, 2.0),
        Limit("CIEDE2000 (studio 0) between the balls of the prediction and of the nearest "
        "plastic", BALL.value, BALL.reason),
        {
            "gplvm": partial(_outside, partial(_from_outermost, "gplvm", {})),
            "raw values": partial(_outside, partial(_from_outermost, "gplvm", {"mapping": "identity"})),
            "blend": partial(_outside, partial(_from_outermost, "blend", {})),
            "brighter": partial(_outside, _brighter),
        },
        "Stay between the materials, or write a physical file: negative values are clipped, the albedo is scaled, "
        "and f made reciprocal.",
    ),
    Mode(
        "across_classes", "path between a smooth and a rough material", "ratio of roughness",
        (ALPHAS[3] / ALPHAS[2], ALPHAS[3] / ALPHAS[1], ALPHAS[3] / ALPHAS[0]),
        HALF_OF_NEAREST,
        {
            "GPLVM": partial(_on_the_way, partial(_on_the_map, "gplvm")),
            "blend": partial(_on_the_way, partial(_on_the_map, "blend")),
            "walk": partial(_on_the_way, _on_the_walk),
        },
        "Use `interpolate`: a straight path of latents may pass other materials, and an average of a narrow and a "
        "wide lobe has both lobes, not one of intermediate width.",
    ),
    Mode(
        "bad_starts", "fits from disturbed principal components", "standard deviation, in length scales",
        (0.1, 1.0, 10.0, 100.0), HALF_OF_NEAREST, {name: partial(_from_start, name) for name in _SEARCHES},
        "Keep the start from principal components: from a distant start no search converges.",
    ),
    Mode(
        "run_to_run", "a second fit, with another order of materials and perturbed values", "relative change",
        (0.0, 1e-9, 1e-6, 1e-4),
        Limit(
            "largest shift of a latent, in widths of the map", 0.25,
            "a material moves to another quarter of the map",
        ),
        {name: partial(_again, name) for name in _SEARCHES},
        "Compare distances, not coordinates, between maps of different libraries; axes may be mirrored.",
    ),
    Mode(
        "ill_conditioned_kernel", "weights of a kernel without observation noise", "length scale l",
        (1.0, 10.0, 1e2, 1e4, 1e7), HALF_OF_NEAREST, {"GP": _ill_conditioned},
        "Raise mu to the value in the warning; with a nearly singular kernel matrix, digits are lost.",
    ),
)  # fmt: skip
