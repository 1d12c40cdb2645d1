"""Steps that call the package from Python, by its public names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import manifold as mf
from golden.values import direction_pairs
from manifold.registries import MAPPINGS


def python_model(folder: Path) -> dict[str, Any]:
    """Predictions, weights, expected errors and searches of a map."""
    model = mf.Manifold.load(folder / "corpus.h5")
    wi, wo = direction_pairs()
    places = np.stack(np.meshgrid(np.linspace(-2, 2, 5), np.linspace(-2, 2, 5)), axis=-1).reshape(-1, 2)
    brdf = mf.MeasuredBRDF(mf.read_bsdf(folder / "corpus-left-out" / "syn_satin_rose_rgb.bsdf"))
    found = model.embed(brdf)
    nearest = model.reconstruct(brdf)
    few = model.reconstruct(brdf, numbers=12)
    halfway = model.interpolate("syn_satin_gold", "syn_metal_copper", 0.5)
    decoded = model.predict(found.latent, found.colours)
    colours, reached = model.colours.of_reflectance([0.3, 0.5], np.array([0.4, 0.2, 0.1]))
    return {
        "latents": model.X,
        "weights": model.weights(places),
        "expected": [model.expected_error(place).to_json() for place in places],
        "predicted": np.stack([model.predict(place).eval(wi, wo) for place in places[::6]]),
        "painted": model.predict([0.3, 0.5], colours).eval(wi, wo),
        "reached": reached,
        "halfway": halfway.eval(wi, wo),
        "halfway albedo": halfway.albedo(wi[::8]),
        "halfway density": halfway.pdf(wi, wo),
        "latent": found.latent,
        "colours": found.colours,
        "relative error": found.relative_error,
        "reconstructed": nearest.eval(wi, wo),
        "in 12 numbers": few.eval(wi, wo),
        "errors": [errors(brdf, other) for other in (decoded, nearest, few, halfway)],
    }


def python_fit_of_a_model(folder: Path) -> dict[str, Any]:
    """Maps of some of the materials, with settings."""
    names = [f.name.removesuffix("_rgb.bsdf") for f in sorted((folder / "corpus").iterdir())]
    made: dict[str, Any] = {}
    for title, settings in {
        "blend": mf.BlendSettings(latent_dim=3),
        "material": mf.GplvmSettings(optimizer="l-bfgs", mapping="log", mu=1e-3),
    }.items():
        model = mf.Manifold.fit(folder / "corpus.zarr", settings, names=names[:6], calibrate=title == "blend")
        made[title] = {"latents": model.X, "statistics": model.statistics}
    return made


def python_measured(folder: Path) -> dict[str, Any]:
    """Evaluation, sampling and integrals of measured files; errors between them."""
    wi, wo = direction_pairs()
    u = np.stack([(0.618 * np.arange(48)) % 1.0, (0.755 * np.arange(48)) % 1.0], axis=1)
    made: dict[str, Any] = {}
    for path in (
        folder / "spectral" / "syn_metal_copper_spec.bsdf",
        folder / "corpus" / "syn_gloss_red_rgb.bsdf",
    ):
        brdf = mf.MeasuredBRDF(mf.read_bsdf(path))
        made[path.stem] = {
            "f": brdf.eval(wi, wo), "cosine": brdf.eval_cos(wi, wo), "albedo": brdf.albedo(wi[::4]),
            "density": brdf.pdf(wi, wo),
            "sampled": [np.asarray(part) for part in as_parts(brdf.sample(wi, u))],
        }  # fmt: skip
    return made


def python_analytic(folder: Path) -> dict[str, Any]:
    """The materials of the corpus before they are measured, and readings of instruments."""
    wi, wo = direction_pairs()
    materials = mf.analytic.corpus.isotropic_materials()
    bands = mf.Bands(tuple(np.linspace(400.0, 700.0, 31).tolist()))
    return {m.name: m.recipe(bands).eval(wi, wo) for m in materials[::3]}


def python_completion(folder: Path) -> dict[str, Any]:
    """Readings at directions of one's own completed."""
    from manifold.estimate import Completion, LibraryAtoms, calibrate, suggest
    from manifold.formats import Readings, geometry_ma_t12

    library = mf.Library.open(folder / "corpus.zarr")
    brdf = mf.MeasuredBRDF(mf.read_bsdf(folder / "corpus-left-out" / "syn_felt_yellow_rgb.bsdf"))
    wi, wo = geometry_ma_t12()
    readings = Readings("sample", "by hand", wi, wo, None, brdf.eval(wi, wo), gloss={60.0: 3.0})
    atoms = LibraryAtoms.of_library(library)
    completed = Completion.of(atoms, readings)
    at = direction_pairs()
    return {
        "f": completed.brdf.eval(*at),
        "made of": completed.made_of,
        "gloss": completed.gloss,
        "misfits": completed.misfits,
        "expected": calibrate(atoms, readings).expected(completed).to_json(),
        "errors": errors(brdf, completed.brdf),
        "suggested": suggest(atoms, 3, completed).angles_deg,
    }


def python_colour(folder: Path) -> dict[str, Any]:
    """Spectra, illuminants and differences."""
    bands = mf.Bands(tuple(np.linspace(400.0, 700.0, 31).tolist()))
    rgb = np.array([[0.7, 0.1, 0.1], [0.2, 0.5, 0.3], [0.9, 0.9, 0.8]])
    spectra = np.stack([mf.colour.srgb_reflectance(c, bands) for c in rgb])
    return {
        "reflectances": spectra,
        "sRGB": [mf.colour.to_srgb(spectra, bands, name) for name in ("D65", "A", "F11", "LED-B3")],
    }


def python_mappings(folder: Path) -> dict[str, Any]:
    """Mappings, metrics and coordinates of directions."""
    wi, wo = direction_pairs()
    a = 0.1 + np.abs(np.sin(np.arange(48.0)))[:, None] * [1.0, 0.5, 2.0]
    b = a * (1.0 + 0.1 * np.cos(np.arange(48.0)))[:, None]
    return {
        "rusinkiewicz": [np.asarray(part) for part in mf.directions.to_rusinkiewicz(wi, wo)],
        "cube root": mf.metrics.cube_root_error(a, b),
        "mapped": {name: MAPPINGS[name].forward(a) for name in ("identity", "cube-root", "log")},
    }


def python_latent_models(folder: Path) -> dict[str, Any]:
    """Gaussian-process latent variables, regression, direct search, kernels and non-negative weights."""
    from manifold.gp import estimators, nonnegative
    from manifold.gp.kernels import kernel_named

    t = np.linspace(0.0, 3.0, 12)
    Y = np.stack([np.sin(t), np.cos(2 * t), t * t / 9, np.exp(-t)], axis=1)
    made: dict[str, Any] = {}
    for optimizer in ("dls", "l-bfgs"):
        model = mf.gplvm.GPLVM(2, optimizer=optimizer).fit(Y)
        made[optimizer] = {"latents": model.embedding_, "objective": model.objective_}
    regressor = estimators.GPRegressor().fit(t[:, None], Y)
    mean, std = regressor.predict(t[:, None] + 0.1, return_std=True)
    kernels = {name: kernel_named(name).smooth(t[:, None], t[:, None] + 0.1) for name in ("se", "matern52")}
    least = mf.dls.hooke_jeeves(lambda x: float((x[0] - 1) ** 2 + 3 * (x[1] + 2) ** 2), np.zeros(2))
    weights = nonnegative.nonnegative_weights(Y.T @ Y + np.eye(4), np.abs(Y[:3]))
    return made | {"mean": mean, "std": std, "kernels": kernels, "least": least.x, "weights": weights}


def python_fit(folder: Path) -> dict[str, Any]:
    """A BSDF fitted to a prediction, and a render of it."""
    model = mf.Manifold.load(folder / "corpus.h5")
    material = model.predict([0.2, -0.4])
    fit = mf.fit_bsdf(material)
    return {
        "values": fit.values,
        "picture": np.asarray(mf.render_ball(material, size=32, samples=8)),
    }


def python_report(folder: Path) -> dict[str, Any]:
    """Errors of a map in 3 dimensions."""
    from manifold.evaluate import make_report

    model = mf.Manifold.fit(folder / "corpus.zarr", mf.BlendSettings(latent_dim=3))
    return make_report(model).to_json()


def errors(truth: Any, other: Any) -> Any:
    """The errors of reports between two BRDFs."""
    from manifold.model import brdf_errors

    return brdf_errors(truth, other).to_json()


def as_parts(value: Any) -> list[Any]:
    """The arrays of a tuple or a record."""
    return list(value) if isinstance(value, tuple) else list(vars(value).values())


def vars_or_value(value: Any) -> Any:
    """A record as a mapping."""
    if hasattr(value, "__dataclass_fields__"):
        return {key: getattr(value, key) for key in value.__dataclass_fields__}
    return value


ALL = (
    python_report, python_model, python_fit_of_a_model, python_measured, python_analytic, python_completion,
    python_colour, python_mappings, python_latent_models, python_fit,
)  # fmt: skip
