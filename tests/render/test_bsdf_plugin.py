"""The plugin `manifold` beside the package's own predictions and beside Mitsuba's `measured` plugin."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from helpers.small_library import measured, small_library
from scipy import stats

from manifold import mitsuba as plugin
from manifold.analytic import corpus
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf import goniometer
from manifold.colour.illuminants import Illuminant
from manifold.core.directions import from_spherical, normalize
from manifold.core.errors import LatentError, MissingModelError, UnknownNameError, UsageError
from manifold.core.records import Bands
from manifold.estimate import predictions
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.colours import ColourChoice
from manifold.model.combination import Combination
from manifold.model.manifold import LibraryChangedWarning, Manifold, load_model
from manifold.model.output_file import OutputOptions
from manifold.model.prediction import PredictedBRDF
from manifold.model.settings import BlendSettings, GplvmSettings
from manifold.registries import MAPPINGS
from manifold.render import backend, scenes
from manifold.render.measured_plugin import load_bsdf
from manifold.render.plugin import mixture
from manifold.render.plugin.bsdf import NAME
from manifold.render.render import RenderSettings, colorimetric_film, render_scene, rgb_film

pytestmark = pytest.mark.skipif(not backend.choose().is_llvm, reason="needs a libLLVM that Dr.Jit can use")

SPECTRAL = ("syn_felt_orange", "syn_gloss_red", "syn_metal_copper", "syn_paper_blue", "syn_satin_gold")


@cache
def spectral_library(folder: Path) -> Path:
    """A library of a few spectral materials."""
    materials = {m.name: m for m in corpus.isotropic_materials()}
    for name in SPECTRAL:
        write_bsdf(folder / f"{name}_spec.bsdf", corpus.measure(materials[name]))
    assert not import_files(folder / "library.zarr", [folder]).failed
    return folder / "library.zarr"


def library_of_six_bands(library: Path, folder: Path) -> Path:
    """The same materials in every 38th band, as few as are read together."""
    opened = Library.open(library)
    for file in map(opened.read, opened.names):
        assert file.wavelengths_nm is not None
        few = replace(file, wavelengths_nm=file.wavelengths_nm[::38], spectra=file.spectra[:, :, ::38])
        write_bsdf(folder / f"{file.name}_spec.bsdf", few)
    assert not import_files(folder / "library.zarr", [folder]).failed
    return folder / "library.zarr"


def brushed_library(folder: Path) -> Path:
    """Materials brushed in three directions, one measured over a quarter turn, aligned; and an isotropic one."""
    brushed = {
        "along_x": GGX.anisotropic(0.2, 0.4), "along_y": GGX.anisotropic(0.5, 0.3),
        "aslant": GGX.anisotropic(0.25, 0.5, 0.6),
    }  # fmt: skip
    files = [measured("syn_satin_gold")]
    for k, (name, normals) in enumerate(brushed.items()):
        material = Plastic(normals, np.array(1.5), np.roll([0.4, 0.2, 0.1], k), Bands(None))
        files.append(goniometer.measure(material, name, resolution=24, n_theta_i=8, n_phi_i=9))
    whole = files[1]
    quarter = {key: getattr(whole, key)[:5] for key in ("phi_i_rad", "vndf", "luminance", "spectra")}
    files[1] = replace(whole, valid=goniometer.pack_valid(whole.measured_mask[:5], whole.version), **quarter)
    for file in files:
        write_bsdf(folder / f"{file.name}_rgb.bsdf", file)
    assert not import_files(folder / "library.zarr", [folder], rotation_rad="auto").failed
    return folder / "library.zarr"


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> dict[str, Path]:
    """Models by kind and bands."""
    folder = tmp_path_factory.mktemp("plugin")
    library = spectral_library(folder)
    rgb = small_library(tmp_path_factory.mktemp("rgb"))
    few = library_of_six_bands(library, tmp_path_factory.mktemp("few"))
    brushed = brushed_library(tmp_path_factory.mktemp("brushed"))
    paths = {}
    for name, source, settings in (
        ("rgb", rgb, GplvmSettings()),
        ("material", library, GplvmSettings()),
        ("six bands", few, GplvmSettings()),
        ("blend", rgb, BlendSettings()),
        ("spectral blend", library, BlendSettings()),
        ("brushed", brushed, BlendSettings()),
    ):
        paths[name] = folder / f"{name}.h5"
        Manifold.fit(Library.open(source), settings, calibrate=False).save(paths[name])
    return paths


def random_directions(rng, n):
    """Directions above the horizon, shape (n, 3), not quite at it."""
    return from_spherical(np.arccos(0.02 + 0.98 * rng.random(n)), 2 * np.pi * rng.random(n))


def words(latent) -> str:
    """A latent as scenes name it."""
    return ",".join(repr(float(v)) for v in latent)


class InMitsuba:
    """A BSDF of Mitsuba with the interface of `manifold.brdf.interface.BRDF`, at fixed wavelengths."""

    def __init__(self, mi, scene, wavelengths_nm=None):
        self.mi, self.dr = mi, backend.drjit()
        self.bsdf = load_bsdf(mi, scene)
        self.wavelengths_nm = wavelengths_nm
        self.rng = np.random.default_rng(7)

    def _interaction(self, wi):
        si = self.dr.zeros(self.mi.SurfaceInteraction3f, len(wi))
        si.wi = self.mi.Vector3f(wi.T)
        if self.wavelengths_nm is not None:
            si.wavelengths = self.mi.Spectrum(*map(float, self.wavelengths_nm))
        return si

    def eval_pdf(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        shape, wi, wo = wi.shape[:-1], wi.reshape(-1, 3), wo.reshape(-1, 3)
        value, pdf = self.bsdf.eval_pdf(
            self.mi.BSDFContext(), self._interaction(wi), self.mi.Vector3f(wo.T.copy())
        )
        return np.array(value).T.reshape(*shape, -1), np.array(pdf).reshape(shape)

    def pdf(self, wi, wo):
        return self.eval_pdf(wi, wo)[1].astype(np.float64)

    def sample(self, wi, u):
        first = self.mi.Float(self.rng.random(len(u)).astype(np.float32))
        record, weight = self.bsdf.sample(
            self.mi.BSDFContext(), self._interaction(wi), first, self.mi.Point2f(u.T.copy())
        )
        self.weight = np.array(weight).T
        return np.array(record.wo).T.astype(np.float64), np.array(record.pdf).astype(np.float64)


@pytest.mark.parametrize("kind", ["rgb", "material", "six bands", "brushed"])
def test_values_and_densities_are_those_of_the_prediction(models, rng, kind):
    model = Manifold.load(models[kind])
    is_rgb = model.bands.is_rgb
    mi = backend.mitsuba("rgb" if is_rgb else "spectral")
    bands = [0, 1, 2] if is_rgb else [1, 2, 3, 4] if kind == "six bands" else [15, 40, 77, 130]
    nm = None if is_rgb else np.array(model.bands.wavelengths_nm)[bands]
    x = model.between(model.names[0], model.names[2], 0.4)
    plugin = InMitsuba(mi, {"type": "manifold", "model": str(models[kind]), "latent": words(x)}, nm)
    wi, wo = random_directions(rng, 2000), random_directions(rng, 2000)
    near_mirror = wi[:1000] * [-1, -1, 1] + 0.03 * rng.normal(size=(1000, 3))  # highlights too
    near_mirror[:, 2] = np.abs(near_mirror[:, 2])
    wo[:1000] = normalize(near_mirror)
    value, pdf = plugin.eval_pdf(wi, wo)
    expected = model.predict(x)
    f_cos = np.maximum(expected.eval_cos(wi, wo), 0.0)[:, bands]
    # Halves hold spectra to 2^-11, and a cube magnifies that where weights of both signs cancel.
    tolerance = 1e-3 if is_rgb else 1e-2
    np.testing.assert_allclose(value, f_cos, rtol=tolerance, atol=tolerance * np.median(f_cos))
    np.testing.assert_allclose(pdf, expected.pdf(wi, wo), rtol=1e-3, atol=1e-5)


@dataclass(frozen=True)
class FourthRoot:
    """A mapping as another package may add it."""

    name = "fourth-root"

    def forward(self, values, cosine_weight=None, xp=np):
        return xp.sqrt(xp.sqrt(xp.maximum(values, 0.0)))

    def inverse(self, mapped, cosine_weight=None, xp=np):
        return xp.maximum(mapped, 0.0) ** 4

    def slope(self, values, cosine_weight=None):
        return 4.0 * np.maximum(values, 0.0) ** 0.75


def test_the_plugin_evaluates_a_mapping_of_another_package(tmp_path, monkeypatch, rng):
    monkeypatch.setitem(MAPPINGS, "fourth-root", FourthRoot())
    model = Manifold.fit(small_library(tmp_path), GplvmSettings(mapping="fourth-root"), calibrate=False)
    model.save(tmp_path / "own.h5")
    x = model.between(model.names[0], model.names[2], 0.4)
    scene = {"type": "manifold", "model": str(tmp_path / "own.h5"), "latent": words(x)}
    wi, wo = random_directions(rng, 500), random_directions(rng, 500)
    value, _ = InMitsuba(backend.mitsuba("rgb"), scene).eval_pdf(wi, wo)
    expected = model.predict(x).eval_cos(wi, wo)
    np.testing.assert_allclose(
        value, expected, rtol=2e-3, atol=2e-3 * np.median(expected)
    )  # halves, as above


@pytest.mark.parametrize(("kind", "share"), [("material", 0.0), ("six bands", 0.3)])
def test_between_bands_the_nearest_counts_where_they_are_dense_and_both_where_not(models, rng, kind, share):
    """At a measured material, whose values between bands are known."""
    model = Manifold.load(models[kind])
    nm = np.array(model.bands.wavelengths_nm)
    bands = np.array([1, 2, 3, 4]) if kind == "six bands" else np.array([15, 40, 77, 130])
    plugin = InMitsuba(
        backend.mitsuba("spectral"),
        {"type": "manifold", "model": str(models[kind]), "latent": words(model.X[2])},
        nm[bands] + 0.3 * (nm[bands + 1] - nm[bands]),
    )
    wi, wo = random_directions(rng, 500), random_directions(rng, 500)
    f_cos = model.material(model.names[2]).eval_cos(wi, wo)
    expected = (1.0 - share) * f_cos[:, bands] + share * f_cos[:, bands + 1]
    np.testing.assert_allclose(
        plugin.eval_pdf(wi, wo)[0], expected, rtol=5e-3, atol=5e-3 * np.median(expected)
    )


def test_at_a_training_latent_it_is_the_measured_material_with_its_negative_values(models, rng):
    model = Manifold.load(models["rgb"])
    mi = backend.mitsuba("rgb")
    name = model.names[3]
    plugin = InMitsuba(
        mi, {"type": "manifold", "model": str(models["rgb"]), "latent": words(model.latent(name))}
    )
    wi, wo = random_directions(rng, 1000), random_directions(rng, 1000)
    np.testing.assert_allclose(
        plugin.eval_pdf(wi, wo)[0], model.material(name).eval_cos(wi, wo), rtol=2e-3, atol=1e-5
    )


@pytest.mark.parametrize(
    ("kind", "theta_deg"), [("rgb", 12.0), ("material", 50.0), ("brushed", 12.0), ("brushed", 78.0)]
)
def test_samples_follow_the_density(models, rng, kind, theta_deg):
    model = Manifold.load(models[kind])
    mi = backend.mitsuba("rgb" if model.bands.is_rgb else "spectral")
    nm = None if model.bands.is_rgb else (450.0, 520.0, 580.0, 650.0)
    x = model.between(model.names[0], model.names[1], 0.5)
    plugin = InMitsuba(mi, {"type": "manifold", "model": str(models[kind]), "latent": words(x)}, nm)
    wi = from_spherical(np.deg2rad(theta_deg), 0.7)
    assert chi_square_p_value(plugin, wi, rng, n_samples=100_000) > 1e-3 / 4  # four tests of this kind


def test_an_anisotropic_prediction_is_that_of_its_written_file_in_mitsuba(models, rng, tmp_path):
    model = Manifold.load(models["brushed"])
    x = model.between("along_y", "aslant", 0.5)
    path = tmp_path / "between_rgb.bsdf"
    predictions.predict(model, x, path, options=OutputOptions(resolution=40, incidences=16))
    mi = backend.mitsuba("rgb")
    plugin = InMitsuba(mi, {"type": "manifold", "model": str(models["brushed"]), "latent": words(x)})
    written = InMitsuba(mi, {"type": "measured", "filename": str(path)})
    wo = random_directions(rng, 3000)
    for phi in np.deg2rad([-50.0, 130.0]):
        wi = from_spherical(np.deg2rad(35.0), phi)
        value, expected = plugin.eval_pdf(wi, wo)[0], written.eval_pdf(wi, wo)[0]
        error = np.linalg.norm(value - expected) / np.linalg.norm(expected)
        turned = plugin.eval_pdf(from_spherical(np.deg2rad(35.0), phi + np.deg2rad(40.0)), wo)[0]
        assert error < 0.03  # a file interpolates between 17 azimuths and 16 elevations
        assert np.linalg.norm(turned - expected) / np.linalg.norm(expected) > 10 * error


@pytest.mark.parametrize("theta_deg", [5.0, 70.0])
def test_the_mean_sample_weight_is_the_albedo(models, rng, theta_deg):
    """The white furnace."""
    model = Manifold.load(models["rgb"])
    x = model.between(model.names[2], model.names[4], 0.3)
    plugin = InMitsuba(
        backend.mitsuba("rgb"), {"type": "manifold", "model": str(models["rgb"]), "latent": words(x)}
    )
    wi = from_spherical(np.deg2rad(theta_deg), 0.0)
    n = 100_000
    plugin.sample(np.broadcast_to(wi, (n, 3)).copy(), rng.random((n, 2)))
    albedo = model.predict(x).albedo(wi)
    np.testing.assert_allclose(plugin.weight.mean(axis=0), albedo, rtol=0.02)  # of 100,000 samples


def passes(mi, material, film, first_seed, count=12):
    """Independent pictures of the ball, (count, 20, 20, 3)."""
    scene = mi.load_dict(scenes.material_ball(mi, load_bsdf(mi, material), film))
    settings = [RenderSettings(size=20, samples=25, seed=first_seed + k) for k in range(count)]
    return np.array([render_scene(mi, scene, s) for s in settings])


def require_same_picture(a, b):
    """A z-test per pixel and channel, corrected for their number."""
    p = stats.ttest_ind(a, b, axis=0, equal_var=False).pvalue
    p = p[np.isfinite(p)]
    assert p.min() > 1e-4 / p.size
    assert np.mean(p < 0.01) < 0.03


@pytest.mark.parametrize(
    ("t", "illuminant"),
    [
        (0.8, "F11"),
        *(
            pytest.param(t, illuminant, marks=pytest.mark.slow)
            for t, illuminant in ((0.2, "D65"), (0.5, "D65"), (0.8, "D65"), (0.2, "F11"), (0.5, "F11"))
        ),
    ],
)
def test_the_written_file_and_the_plugin_make_the_same_picture(models, tmp_path, t, illuminant):
    model = Manifold.load(models["material"])
    x = model.between(model.names[1], model.names[4], t)
    path = tmp_path / "between_spec.bsdf"
    predictions.predict(model, x, path, options=OutputOptions(resolution=48, incidences=24))
    mi = backend.mitsuba("spectral")
    film = colorimetric_film(mi, 20, Illuminant.named(illuminant))
    written = passes(mi, {"type": "measured", "filename": str(path)}, film, 0)
    direct = passes(
        mi, {"type": "manifold", "model": str(models["material"]), "latent": words(x)}, film, 1000
    )
    require_same_picture(written, direct)


def test_a_texture_with_a_texel_that_is_no_number_is_refused(models):
    mi = backend.mitsuba("rgb")
    fields = {
        f"latent_{k}": {"type": "bitmap", "bitmap": mi.Bitmap(np.float32([[[0.1], [value]]])), "raw": True}
        for k, value in enumerate((0.2, np.nan))
    }
    with pytest.raises(Exception, match="latent_1 has texels that are not finite"):
        mi.load_dict({"type": "manifold", "model": str(models["rgb"]), **fields})


@pytest.mark.parametrize("mapping", MAPPINGS.values(), ids=MAPPINGS)
def test_the_plugin_has_every_mapping_both_ways(rng, mapping):
    mi, dr = backend.mitsuba("rgb"), backend.drjit()
    f, cosines = 10.0 ** rng.uniform(-2.0, 3.0, 50), rng.random(50)
    mapped = mapping.forward(f, cosines)
    for found, expected in (
        (mapping.forward(mi.Float(f), mi.Float(cosines), dr), mapped),
        (mapping.inverse(mi.Float(mapped), mi.Float(cosines), dr), f),
    ):
        np.testing.assert_allclose(
            np.array(found), expected, rtol=1e-4
        )  # float32, of whose digits exp loses two


@pytest.mark.parametrize("kind", ["rgb", "blend", "brushed"])
def test_a_texture_of_latents_carries_a_field_of_materials(models, rng, kind):
    model = Manifold.load(models[kind])
    mi, dr = backend.mitsuba("rgb"), backend.drjit()
    places = [rng.dirichlet(np.ones(len(model.names))) @ model.X for _ in range(2)] + [model.X[1]]
    fields = {
        f"latent_{k}": {
            "type": "bitmap", "bitmap": mi.Bitmap(np.array([[[x[k]] for x in places]], dtype=np.float32)), "raw": True,
            "filter_type": "nearest",
        }
        for k in range(2)
    }  # fmt: skip
    bsdf = mi.load_dict({"type": "manifold", "model": str(models[kind]), **fields})
    wi, wo = random_directions(rng, 600), random_directions(rng, 600)
    si = dr.zeros(mi.SurfaceInteraction3f, 600)
    si.wi = mi.Vector3f(wi.T.copy())
    si.uv = mi.Point2f(np.tile([1 / 6, 3 / 6, 5 / 6], 200).astype(np.float32), 0.5)
    value = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.copy()))).T
    for k, x in enumerate(places):  # a field has no unmeasured cells, not even at a measured material
        closed = PredictedBRDF(model.materials.filled(), Combination(model.mapping, model.weights(x)))
        expected = np.maximum(closed.eval_cos(wi[k::3], wo[k::3]), 0.0)
        # Latents are float32 there, and weights of both signs cancel.
        np.testing.assert_allclose(value[k::3], expected, rtol=0.02, atol=0.02 * np.median(expected))


@pytest.mark.parametrize(("kind", "integrator"), [("rgb", "direct"), ("spectral blend", "direct")])
def test_a_ball_with_a_texture_of_latents_is_rendered(models, kind, integrator):
    """A render compiles loops and virtual calls that `eval` alone does not."""
    model = Manifold.load(models[kind])
    mi = backend.mitsuba("rgb" if model.bands.is_rgb else "spectral")
    ends = (
        model.latent("syn_gloss_red"),
        model.latent("syn_felt_orange" if not model.bands.is_rgb else "syn_felt_green"),
    )

    def picture(*latents):
        fields = {
            f"latent_{k}": {"type": "bitmap", "raw": True, "filter_type": "nearest",
                            "bitmap": mi.Bitmap(np.array([[[x[k]] for x in latents]], dtype=np.float32))}
            for k in range(2)
        }  # fmt: skip
        scene = scenes.material_ball(
            mi, {"type": "manifold", "model": str(models[kind]), **fields}, rgb_film(16)
        )
        scene["integrator"] = {"type": integrator}
        return np.array(mi.render(mi.load_dict(scene), spp=16))

    first, second, both = picture(ends[0]), picture(ends[1]), picture(*ends)
    ball = scenes.ball_interior(16, 0.1)
    means = [one[ball].mean() for one in (first, second)]
    assert np.isfinite(both).all()
    assert min(means) * 0.98 < both[ball].mean() < max(means) * 1.02


@pytest.mark.parametrize(
    ("kind", "integrator"),
    [
        ("blend", "path"),
        pytest.param("spectral blend", "direct", marks=pytest.mark.slow),
        pytest.param("rgb", "direct", marks=pytest.mark.slow),
        pytest.param("material", "path", marks=pytest.mark.slow),
    ],
)
def test_constant_textures_make_the_picture_of_fixed_latents(models, kind, integrator):
    """Two textured objects that light each other; their latents are exact in single precision."""
    model = Manifold.load(models[kind])
    mi = backend.mitsuba("rgb" if model.bands.is_rgb else "spectral")
    first, second = (np.float32(model.between(*model.names[:2], t)) for t in (0.3, 0.7))

    def textured(x):
        return {f"latent_{k}": {"type": "bitmap", "raw": True, "filter_type": "bilinear",
                                "bitmap": mi.Bitmap(np.full((2, 3, 1), v, np.float32))}
                for k, v in enumerate(x)}  # fmt: skip

    def picture(*properties):
        balls = [{"type": "manifold", "model": str(models[kind]), **given} for given in properties]
        scene = scenes.material_ball(mi, balls[0], rgb_film(16))
        scene["second"] = {"type": "sphere", "center": [0.0, -1.2, 0.6], "radius": 0.6, "bsdf": balls[1]}
        scene["integrator"] = {"type": integrator}
        return np.array(mi.render(mi.load_dict(scene), spp=16))

    fixed = picture({"latent": words(first)}, {"latent": words(second)})
    found = picture(textured(first), textured(second))
    np.testing.assert_allclose(found, fixed, rtol=2e-3, atol=2e-3 * fixed.mean())


def test_leaving_out_materials_states_its_error_and_keeps_to_it(rng):
    values = rng.random((12, 500))
    weights = np.concatenate([rng.normal(size=5), 0.01 * rng.normal(size=7)])
    kept, fitted, error = mixture.leave_out(weights, values @ values.T, 0.05)
    assert len(kept) <= 5
    assert error <= 0.05
    full, part = weights @ values, fitted @ values[kept]
    np.testing.assert_allclose(np.linalg.norm(full - part) / np.linalg.norm(full), error, rtol=1e-6)
    plain = weights[kept] @ values[kept]
    assert error < np.linalg.norm(full - plain) / np.linalg.norm(full)  # fitting again pays
    assert list(mixture.leave_out(weights, values @ values.T, 0.0)[0]) == list(range(12))
    with pytest.raises(UsageError, match="expected a share"):
        mixture.leave_out(weights, values @ values.T, 1.0)


def test_a_reflectance_colours_a_prediction(models, rng, tmp_path):
    model = Manifold.load(models["spectral blend"])
    x = model.between(model.names[0], model.names[2], 0.4)
    spectrum = tmp_path / "blue.txt"
    spectrum.write_text("380 0.6\n480 0.5\n550 0.1\n780 0.05\n")
    chosen = model.choose_colour(x, ColourChoice(reflectance=spectrum))
    mi, bands = backend.mitsuba("spectral"), [15, 40, 77, 130]
    scene = {"type": "manifold", "model": str(models["spectral blend"]), "latent": words(x)}
    plugin = InMitsuba(
        mi, scene | {"reflectance": str(spectrum)}, np.array(model.bands.wavelengths_nm)[bands]
    )
    wi, wo = random_directions(rng, 500), random_directions(rng, 500)
    expected = np.maximum(model.predict(x, chosen.colours).eval_cos(wi, wo), 0.0)[:, bands]
    np.testing.assert_allclose(
        plugin.eval_pdf(wi, wo)[0], expected, rtol=0.01, atol=0.01 * np.median(expected)
    )


def test_a_model_is_read_again_after_its_library_has_changed(models, tmp_path):
    model = Manifold.load(models["rgb"])
    shutil.copytree(model.library.path, tmp_path / "library.zarr")
    shutil.copy(models["rgb"], tmp_path / "model.h5")
    before = load_model(tmp_path / "model.h5", tmp_path / "library.zarr")
    assert load_model(tmp_path / "model.h5", tmp_path / "library.zarr") is before
    name = before.names[0]
    file = before.library.read(name)
    write_bsdf(tmp_path / f"{name}_rgb.bsdf", replace(file, spectra=0.5 * file.spectra))
    import_files(tmp_path / "library.zarr", [tmp_path / f"{name}_rgb.bsdf"], replace=True)
    with pytest.warns(LibraryChangedWarning):
        after = load_model(tmp_path / "model.h5", tmp_path / "library.zarr")
    assert after is not before


def test_a_name_is_the_latent_of_its_material(models, rng):
    model = Manifold.load(models["rgb"])
    by_name, by_latent = (
        InMitsuba(backend.mitsuba("rgb"), {"type": "manifold", "model": str(models["rgb"]), "latent": latent})
        for latent in (model.names[1], words(model.X[1]))
    )
    wi, wo = from_spherical(0.5, 0.0), random_directions(rng, 50)
    np.testing.assert_array_equal(by_name.eval_pdf(wi, wo)[0], by_latent.eval_pdf(wi, wo)[0])


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ({}, "no latent; give `latent`"),
        ({"latent": "0.1"}, "found 1 coordinate,"),
        ({"latent": "a,b"}, "'a,b', expected coordinates such as"),
        ({"latent": "syn_gloss_red:syn_felt_green:0.5"}, "a step of a walk"),
        ({"latent": "0.1,0.2", "tolerance": 50.0}, "expected a share"),
        ({"latent": "0.1,0.2", "model": "nothing.h5"}, "nothing.h5"),
        ({"latent": "0.1,0.2", "srgb": "#ff0000"}, "colours cannot be given"),
        ({"latent_0": 0.1, "latent_1": 0.2, "like": "syn_gloss_red"}, "like needs one latent"),
    ],
)
def test_properties_that_cannot_be_used_are_one_clear_line(models, properties, message):
    mi = backend.mitsuba("rgb")
    with pytest.raises(Exception, match=message):
        mi.load_dict({"type": "manifold", "model": str(models["rgb"]), **properties})


def test_a_library_of_other_bands_than_the_variant_is_refused(models):
    mi = backend.mitsuba("rgb")
    with pytest.raises(Exception, match="spectral materials; set a spectral variant"):
        mi.load_dict({"type": "manifold", "model": str(models["material"]), "latent": "0,0"})


def test_importing_render_registers_the_plugin_in_every_variant(models):
    assert NAME == "manifold"  # what scenes say
    for colour, model in (("rgb", "rgb"), ("spectral", "six bands")):
        mi = backend.mitsuba(colour)
        scene = f'<bsdf version="3.0.0" type="manifold"><string name="model" value="{models[model]}"/>'
        bsdf = mi.load_string(scene + '<string name="latent" value="0.0,0.1"/></bsdf>')
        assert "materials" in str(bsdf)


def test_a_latent_may_be_a_list_a_point_or_an_array(models, rng):
    mi = backend.mitsuba("rgb")
    by_list = plugin.bsdf(models["rgb"], [0.1, -0.2])
    by_point = {"type": "manifold", "model": str(models["rgb"]), "latent": mi.ScalarPoint2f(0.1, -0.2)}
    wi, wo = from_spherical(0.5, 0.0), random_directions(rng, 50)
    first, second = (InMitsuba(mi, properties).eval_pdf(wi, wo)[0] for properties in (by_list, by_point))
    np.testing.assert_allclose(first, second, rtol=1e-5)  # points are single precision


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("nothing.h5", [0, 0]), MissingModelError),
        ((None, [0, 0, 0]), LatentError),
        ((None, "nobody"), UnknownNameError),
        ((None, "{}:{}:0.5"), UsageError),
    ],
)
def test_the_dictionary_of_a_bsdf_is_refused_in_one_line(models, arguments, error):
    model, latent = arguments
    if latent == "{}:{}:0.5":
        latent = latent.format(*Manifold.load(models["rgb"]).names[:2])
    with pytest.raises(error) as caught:
        plugin.bsdf(model or models["rgb"], latent)
    assert "\n" not in str(caught.value)
    assert "FROM:TO:T" not in str(caught.value)  # which the plugin refuses
    assert ("model.between('" in str(caught.value)) == (error is UsageError)


def test_a_mono_variant_is_refused_when_the_scene_loads(models):
    mi = backend.mitsuba("rgb")
    before = mi.variant()
    mi.set_variant("llvm_ad_mono")
    try:
        with pytest.raises(Exception, match="needs an RGB or spectral variant"):
            mi.load_dict({"type": "manifold", "model": str(models["rgb"]), "latent": "0,0"})
    finally:
        mi.set_variant(before)
