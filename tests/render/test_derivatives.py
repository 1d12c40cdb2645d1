"""Derivatives of renders by what `mi.traverse` finds in the plugin `manifold`, beside central differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_library import measured, small_library

from manifold.analytic import corpus
from manifold.core.errors import LatentError, UsageError
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.settings import BlendSettings, GplvmSettings
from manifold.render import backend, scenes
from manifold.render.plugin import mixture
from manifold.render.plugin.evaluation import Evaluation, VaryingWeights
from manifold.render.render import rgb_film

pytestmark = pytest.mark.skipif(not backend.choose().is_llvm, reason="needs a libLLVM that Dr.Jit can use")


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> dict[str, Path]:
    """Models by bands and kind."""
    folder = tmp_path_factory.mktemp("derivatives")
    materials = {m.name: m for m in corpus.isotropic_materials()}
    for name in ("syn_felt_orange", "syn_metal_copper", "syn_paper_blue"):
        file = corpus.measure(materials[name])
        few = replace(file, wavelengths_nm=file.wavelengths_nm[::13], spectra=file.spectra[:, :, ::13])
        write_bsdf(folder / f"{name}_spec.bsdf", few)
    assert not import_files(folder / "library.zarr", [folder]).failed
    rgb, spectral = small_library(tmp_path_factory.mktemp("rgb")), folder / "library.zarr"
    file, fewer = measured("syn_gloss_red"), [0, 1, 2, 3, 4, 6, 7]  # tables of another size: another loop
    coarse = {name: getattr(file, name)[:, fewer] for name in ("vndf", "luminance", "spectra")}
    coarse["valid"] = np.packbits(np.unpackbits(file.valid).reshape(file.luminance.shape)[:, fewer])
    write_bsdf(
        folder / "coarse_rgb.bsdf",
        replace(file, name="coarse", theta_i_rad=file.theta_i_rad[fewer], **coarse),
    )
    assert not import_files(rgb, [folder / "coarse_rgb.bsdf"]).failed
    paths = {}
    for name, source, settings in (
        ("rgb blend", rgb, BlendSettings()),
        ("rgb material", rgb, GplvmSettings(kernel="matern32")),
        ("spectral blend", spectral, BlendSettings()),
    ):
        paths[name] = folder / f"{name}.h5"
        Manifold.fit(Library.open(source), settings, calibrate=False).save(paths[name])
    return paths


def mitsuba_for(model: Manifold):
    return backend.mitsuba("rgb" if model.bands.is_rgb else "spectral")


def textures(mi, latents) -> dict:
    """Textures of latents (H, W, Q)."""
    return {
        f"latent_{k}": {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(latents[..., k : k + 1].astype(np.float32))}
        for k in range(latents.shape[-1])
    }  # fmt: skip


def fixed(model: Manifold, path: Path, latent, **given) -> dict:
    """A BSDF of one latent."""
    return {
        "type": "manifold",
        "model": str(path),
        "latent": ",".join(repr(float(v)) for v in latent),
        **given,
    }


def two_balls(mi, bsdf, integrator: str, size: int = 4):
    """A ball that mirrors itself in another one of the same material, in studio light."""
    scene = scenes.material_ball(mi, {"type": "ref", "id": "material"}, rgb_film(size))
    scene = {"type": scene.pop("type"), "material": bsdf, **scene}
    scene["second"] = {
        "type": "sphere",
        "center": [0.0, -1.2, 0.6],
        "radius": 0.6,
        "bsdf": {"type": "ref", "id": "material"},
    }
    scene["integrator"] = {"type": integrator} | ({"max_depth": 4} if integrator == "prb" else {})
    return mi.load_dict(scene)


def uniform_sampling(monkeypatch) -> None:
    """Draw all materials with equal shares: a picture of equal seeds then is a smooth function of the weights."""
    choose, weight, set_weights = Evaluation._choose, Evaluation._weight, Evaluation.set_weights
    monkeypatch.setattr(Evaluation, "_choose", lambda self, lobes, sample: choose(self, None, sample))

    def set_with_equal_shares(self, found, *given):
        n = len(found.names)
        set_weights(self, replace(found, lobes=np.full(n, 1.0 / n)), *given)

    def with_equal_share(self, lobes, *given):
        v, _, slopes = weight(self, lobes, *given)
        return v, 1.0 / self._n, slopes

    monkeypatch.setattr(Evaluation, "_weight", with_equal_share)
    monkeypatch.setattr(Evaluation, "set_weights", set_with_equal_shares)


def derivative(mi, scene, key: str, direction, spp: int = 64) -> tuple[float, float]:
    """Derivative of a weighted mean of the picture along a direction of a parameter, and its central difference."""
    dr = backend.drjit()
    params = mi.traverse(scene)
    factors = np.random.default_rng(3).random((4, 4, 3)).astype(np.float32)

    def mean(seed=5):
        return dr.mean(
            mi.render(scene, params, spp=spp, seed=seed, seed_grad=5) * mi.TensorXf(factors), axis=None
        )

    start = np.array(params[key]).astype(np.float32)
    kind = type(params[key])
    dr.enable_grad(params[key])
    params.update()
    dr.backward(mean(seed=4))
    slope = float(np.sum(np.array(dr.grad(params[key])) * direction))
    dr.disable_grad(params[key])
    found = []
    for step in (1e-2, -1e-2):
        params[key] = kind((start + step * direction).astype(np.float32))
        params.update()
        found.append(
            float(dr.mean(mi.render(scene, spp=spp, seed=5) * mi.TensorXf(factors), axis=None).array[0])
        )
    params[key] = kind(start)
    params.update()
    return slope, (found[0] - found[1]) / 2e-2


@pytest.mark.parametrize("kind", ["rgb blend", "rgb material"])
def test_weights_of_textures_are_those_of_the_model_and_slopes_their_differences(models, rng, kind):
    model = Manifold.load(models[kind])
    mi, dr = mitsuba_for(model), backend.drjit()
    varying = mixture.varying_mixture(model)
    on_drjit = VaryingWeights(mi, dr, varying)
    places = np.float32(rng.dirichlet(np.ones(len(model.names)), 20) @ model.X).astype(np.float64)
    latent = [mi.Float(column.copy()) for column in places.T]
    dr.enable_grad(latent)
    lobes = on_drjit.at(latent)
    order, h = list(varying.order), 1e-5
    for j in range(len(model.names)):
        v, slopes = on_drjit.weight(lobes, mi.UInt32(j))
        np.testing.assert_allclose(
            v, model.space.material_weights(places, None)[:, order[j]], atol=1e-5, rtol=1e-5
        )
        for q, step in enumerate(h * np.eye(2)):
            above, below = (
                model.space.material_weights(places + s * step, None)[:, order[j]] for s in (1, -1)
            )
            np.testing.assert_allclose(slopes[q], (above - below) / (2 * h), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "integrator"),
    [
        pytest.param("rgb blend", "prb", marks=pytest.mark.slow),
        ("rgb material", "direct"),
        pytest.param("spectral blend", "prb", marks=pytest.mark.slow),
    ],
)
def test_derivatives_by_textures_are_central_differences(models, rng, monkeypatch, kind, integrator):
    model = Manifold.load(models[kind])
    mi = mitsuba_for(model)
    uniform_sampling(monkeypatch)
    at = model.between(model.names[0], model.names[1], 0.4)
    latents = at + 0.1 * rng.normal(size=(3, 4, 2))
    bsdf = {"type": "manifold", "model": str(models[kind]), **textures(mi, latents)}
    scene = two_balls(mi, bsdf, integrator)
    for k in range(2):
        direction = 1.0 + 0.5 * rng.random((3, 4, 1))
        found, expected = derivative(mi, scene, f"material.latent_{k}.data", direction)
        assert abs(found - expected) < 0.01 * abs(expected)


@pytest.mark.parametrize(
    ("kind", "given", "integrator"),
    [
        ("rgb blend", {}, "prb"),
        ("rgb material", {"tolerance": 0.05}, "direct"),
        pytest.param("spectral blend", {"srgb": "#b06030"}, "direct", marks=pytest.mark.slow),
    ],
)
def test_derivatives_by_one_latent_and_its_colours_are_central_differences(
    models, rng, monkeypatch, kind, given, integrator
):
    model = Manifold.load(models[kind])
    mi = mitsuba_for(model)
    uniform_sampling(monkeypatch)
    at = model.between(model.names[0], model.names[1], 0.4)
    scene = two_balls(mi, fixed(model, models[kind], at, **given), integrator)
    offered = {"latent": 2} | ({"colours": model.bands.count} if "srgb" in given else {})
    for name, size in offered.items():
        found, expected = derivative(mi, scene, f"material.{name}", 1.0 + 0.5 * rng.random(size))
        assert abs(found - expected) < 0.01 * abs(expected)


@pytest.mark.parametrize("kind", ["rgb blend", pytest.param("rgb material", marks=pytest.mark.slow)])
def test_a_changed_latent_gives_the_picture_of_a_bsdf_with_that_latent(models, kind):
    model = Manifold.load(models[kind])
    mi, dr = mitsuba_for(model), backend.drjit()
    start, end = (np.float32(model.between(*model.names[:2], t)) for t in (0.3, 0.7))
    scene = two_balls(mi, fixed(model, models[kind], start), "direct")
    params = mi.traverse(scene)
    for latent in (model.X[2], end):  # a measured file, and back to a mixture
        params["material.latent"] = mi.Float(latent)
        dr.enable_grad(params["material.latent"])
        params.update()
        expected = mi.render(two_balls(mi, fixed(model, models[kind], latent), "direct"), spp=16)
        np.testing.assert_allclose(mi.render(scene, spp=16), expected, rtol=1e-4, atol=1e-5)


def test_a_latent_of_the_wrong_size_is_refused_as_in_a_scene(models):
    model = Manifold.load(models["rgb blend"])
    mi = mitsuba_for(model)
    bsdf = mi.load_dict(fixed(model, models["rgb blend"], model.X[0]))
    params = mi.traverse(bsdf)
    params["latent"] = mi.Float([0.1, 0.2, 0.3])
    with pytest.raises(LatentError, match="found 3 coordinates"):
        params.update()


def test_derivatives_by_directions_are_refused(models):
    model = Manifold.load(models["rgb blend"])
    mi, dr = mitsuba_for(model), backend.drjit()
    bsdf = mi.load_dict(fixed(model, models["rgb blend"], [0.1, 0.2]))
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.0, 0.6, 0.8)
    dr.enable_grad(si.wi)
    with pytest.raises(UsageError, match="derivatives with respect to directions"):
        bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0.0, 0.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("is_texture", [False, True])
def test_an_optimiser_recovers_latents_of_two_balls_that_light_each_other(models, is_texture):
    model = Manifold.load(models["rgb blend"])
    mi, dr = mitsuba_for(model), backend.drjit()
    first, last = (model.between("syn_metal_copper", "syn_satin_gold", t) for t in (0.4, 0.6))
    share = np.linspace(0.0, 1.0, 16).reshape(4, 4, 1)
    unknown = first + share * (last - first) if is_texture else first
    # The start is near copper: a search that starts halfway to white paper ends in another minimum.
    start = np.zeros_like(unknown) + model.between("syn_metal_copper", "syn_paper_white", 0.25)

    def bsdf(latents):
        path = models["rgb blend"]
        if is_texture:
            return {"type": "manifold", "model": str(path), **textures(mi, latents)}
        return fixed(model, path, latents)

    given = mi.render(two_balls(mi, bsdf(unknown), "prb", 12), spp=512, seed=99)
    scene = two_balls(mi, bsdf(start), "prb", 12)
    params = mi.traverse(scene)
    keys = ["material.latent_0.data", "material.latent_1.data"] if is_texture else ["material.latent"]
    optimizer = mi.ad.Adam(lr=0.1)
    for key in keys:
        optimizer[key] = params[key]
    params.update(optimizer)
    steps = 160
    for step in range(steps):
        optimizer.set_learning_rate(0.1 * 0.3 ** (step / steps))
        picture = mi.render(scene, params, spp=64, seed=step)
        dr.backward(dr.mean(dr.square((picture - given) / (given + 0.02)), axis=None))
        optimizer.step()
        params.update(optimizer)
    found = np.stack([np.array(params[key]) for key in keys], axis=-1).reshape(np.shape(unknown))
    off, off_before = (np.median(np.linalg.norm(x - unknown, axis=-1)) for x in (found, start))
    assert off < 0.4 * off_before  # after 160 steps: a blend changes slowly near its materials
