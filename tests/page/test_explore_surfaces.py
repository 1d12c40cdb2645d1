"""Surfaces on the page: its balls are those of the previews, and a link or a click shows them again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.browser import control, follow, settle, shown, state, unpacked, visit
from helpers.small_library import measured, spectral_files
from scipy.ndimage import gaussian_filter

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import decode_srgb, srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.core.errors import UsageError
from manifold.core.records import Bands
from manifold.page.page import make_page
from manifold.page.page_data import tabulate, to_document
from manifold.page.page_surfaces import components_of
from manifold.page.tabulated_pairs import tabulated_pairs
from manifold.surface import preview
from manifold.surface.response import shaded
from manifold.surface.sparkle import Flakes
from manifold.surface.tiling import Textures
from manifold.surface.written import WrittenSurface

SIZE = 294  # pixels of the page's ball, which are then as large as those of the preview
PREVIEW = 320


def rough(rng):
    field = gaussian_filter(rng.standard_normal((512, 512)), 4.0, mode="wrap")
    return field / field.std()


@pytest.fixture(scope="module")
def surface():
    """A satin paint in spectra, of two colours, with relief and flakes; the map is in RGB."""
    rng = np.random.default_rng(5)
    slope = 0.1 * np.stack([rough(rng), rough(rng)], axis=-1)
    albedo = np.exp(0.2 * rough(rng)[..., None] * [1.0, 0.5, 0.2])
    textures = Textures(albedo / albedo.mean(axis=(0, 1)), slope, np.zeros((512, 512)))
    flakes = Flakes(60.0, 40.0, 0.3, 0.15, 0.1).drawn(512, rng)
    return WrittenSurface("twin", MeasuredBRDF(spectral_files()["syn_satin_gold"]), textures, flakes, 1.5)


@pytest.fixture(scope="module")
def opened(browser, model, surface, tmp_path_factory):
    """The page of a map with the surface, and with its mean alone."""
    flat = replace(
        surface,
        name="flat",
        textures=Textures(np.ones((192, 192, 3)), np.zeros((192, 192, 2)), np.zeros((192, 192))),
        flakes=None,
    )
    page = tmp_path_factory.mktemp("page") / "map.html"
    page.write_text(make_page(to_document(model, tabulate(model), [surface, flat])), encoding="utf-8")
    opened = visit(browser, page.as_uri())
    yield opened
    assert opened.errors == []
    assert opened.requests == []


def ball(page, fragment, lamp=None):
    """Linear sRGB of the page's ball at rest and where it is whole, (SIZE, SIZE, 3); rows from the top."""
    follow(page, fragment)
    script = """([size, lamp]) => {
      const { balls } = explorer, own = balls._show;
      balls.refine(0);
      balls._show = (k, normals, corner, side, light) => own.call(balls, k, normals, corner, side, { ...light, lamp });
      const { data } = balls.image(0, size);
      delete balls._show;
      return packed(data);
    }"""
    picture = unpacked(shown(page, script, [SIZE, lamp])).reshape(SIZE, SIZE, 4) / 255.0
    return decode_srgb(picture[..., :3]), picture[..., 3] == 1.0


def difference(own, other):
    """CIEDE2000 between linear colours (..., 3)."""
    xyz = (srgb_to_xyz(np.clip(each, 0.0, 1.0)) for each in (own, other))
    return delta_e_2000(*xyz, srgb_to_xyz(np.ones(3)))


def under_lamp(surface, lamp):
    """The ball of a surface under a lamp (right, up, towards the viewer), point by point; (SIZE, SIZE, 3)."""
    across = ((np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0) * 1.02
    x, y = np.meshgrid(across, -across)
    inside = x**2 + y**2 < 0.98
    x, y = x[inside], y[inside]
    z = np.sqrt(1.0 - x**2 - y**2)
    ring = np.sqrt(1.0 - y**2)
    right = np.stack([z / ring, 0.0 * x, -x / ring], axis=-1)
    up = np.stack([-x * y / ring, ring, -y * z / ring], axis=-1)
    row, column = (
        (512 * np.stack([np.arccos(y) / np.pi, 0.5 + np.arctan2(x, z) / np.pi])).astype(int).clip(0, 511)
    )

    def lit(facets, slope):
        normal = np.stack([x, y, z], axis=-1) + slope[:, :1] * right + slope[:, 1:] * up
        above = np.array([0.0, 0.0, 1.0])
        return shaded(facets, normal[:, :2] / np.maximum(normal[:, 2:], 0.045), lamp, above) * lamp[2]

    made = surface.textures.albedo[row, column] * lit(surface.brdf, surface.textures.slope[row, column])
    flakes = surface.flakes
    normal, covered = flakes.normal[row, column], flakes.mask[row, column]
    facets = lit(flakes.facet, normal[:, :2] / normal[:, 2:])
    made[covered] += flakes.share * (facets - made)[covered]
    picture = np.zeros((SIZE, SIZE, 3))
    picture[inside] = made
    return picture


def test_the_ball_of_a_surface_is_that_of_its_preview(opened, surface):
    own, is_whole = ball(opened.page, "#surface=0")
    edge = (PREVIEW - SIZE) // 2
    expected = preview.strip(surface.brdf, surface.textures, surface.flakes)[:, -PREVIEW:]
    flat, _ = ball(opened.page, "#surface=1")
    assert difference(own, expected[edge:-edge, edge:-edge])[is_whole].mean() < 1.0  # 0.8
    assert difference(flat, own)[is_whole].mean() > 3.0  # relief and colours; 4.5


@pytest.mark.parametrize("lamp", [(-0.4, 0.5, 0.77), (0.6, 0.2, 0.77)])
def test_a_lamp_lights_relief_and_flakes_of_the_page_as_those_of_the_package(opened, surface, lamp):
    lamp = np.array(lamp) / np.linalg.norm(lamp)
    own, is_whole = ball(opened.page, "#surface=0", lamp.tolist())
    expected = under_lamp(surface, lamp)
    seen = is_whole & (expected.max(axis=-1) > 0.02)
    assert difference(own, expected)[seen].mean() < 1.0  # 0.7
    none = replace(surface.flakes, mask=np.zeros_like(surface.flakes.mask))
    assert difference(own, under_lamp(replace(surface, flakes=none), lamp))[seen].mean() > 2.0  # 2.4


@pytest.mark.parametrize("shape", ["ball", "cloth", "box"])
def test_textures_cover_every_shape(opened, shape):
    script = """() => {
      const { balls, light } = explorer, size = 96, values = new Float32Array(4 * size * size), { gl } = balls;
      balls._compared([0], light, size);
      gl.readPixels(0, 0, size, size, gl.RGBA, gl.FLOAT, values);
      return packed(values);
    }"""
    pictures = []
    for surface in (0, 1):
        follow(opened.page, f"#surface={surface}&light=overcast&shape={shape},20")
        pictures.append(unpacked(shown(opened.page, script), np.float32).reshape(96, 96, 4))
    is_whole = pictures[0][..., 3] > 0.9  # of a box the distance at which the march ends takes a little
    textured, flat = (decode_srgb(each[is_whole][:, :3] / each[is_whole][:, 3:]) for each in pictures)
    assert np.isfinite(textured).all()
    assert difference(textured, flat).mean() > 2.0
    np.testing.assert_allclose(textured.mean(axis=0), flat.mean(axis=0), rtol=0.1)


def test_the_page_begins_with_a_surface_and_finds_back_to_it(opened, surface):
    page = opened.page
    page.evaluate("explorer.reset()")
    settle(page)
    start = state(page)
    assert (start["colour"], start["guest"]) == ("own", 0)
    assert shown(page, "document.getElementById('caption').textContent") == surface.name
    assert "1.5 (CIEDE2000" in page.inner_text("#error-value")
    page.click("#keep")
    page.focus("#map")
    page.keyboard.press("ArrowRight")
    assert state(page)["colour"] == "blend"
    assert shown(page, "explorer.prediction.textures") is None
    assert page.locator("#guests li").count() == 2
    control(page, "#guests li:nth-child(2) button:first-of-type").click()
    assert state(page)["guest"] == 1
    kept = page.evaluate("location.hash")
    page.evaluate("explorer.reset()")
    follow(page, kept)
    assert (state(page)["colour"], state(page)["guest"]) == ("own", 1)
    assert state(page)["variants"][0]["guest"] == 0
    follow(page, "#surface=7&x=0.5,-0.25")
    assert (state(page)["colour"], state(page)["x"]) == ("blend", [0.5, -0.25])
    follow(page, "#surface=__proto__")
    assert state(page)["guest"] == 0  # as at the start


def test_a_surface_without_spectra_is_refused_on_a_map_of_spectra(surface):
    rgb = replace(surface, brdf=MeasuredBRDF(measured("syn_satin_gold")))
    with pytest.raises(UsageError, match="the map is spectral"):
        components_of(rgb, Bands((450.0, 550.0)), tabulated_pairs(), np.eye(2))
