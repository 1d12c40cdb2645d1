"""Surfaces from pictures: what is known is found again, and textures continue across their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import label
from surface_twins import (
    BORDER,
    CAPTIONS,
    SIZE,
    lamps_around,
    matte,
    photographed,
    rendered,
    rough,
    truth,
    workbook,
)

from manifold.colour.picture_files import read_picture
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Bands
from manifold.formats import ma_t12
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.render import backend
from manifold.render.bsdf_parameters import principled
from manifold.render.fitted_brdf import FittedBRDF
from manifold.surface import estimate, lamp_pictures
from manifold.surface.estimate import estimate_surface, integrated
from manifold.surface.lamp_pictures import SurfacePictures, files_in, read_folder, read_workbook
from manifold.surface.quilting import quilt
from manifold.surface.response import Response
from manifold.surface.sparkle import Flakes, sparkle_of
from manifold.surface.tiling import Textures, blend, dust_in, tile, uncropped


def test_slopes_in_the_plane_of_the_lamps_and_albedo_are_found(rng):
    _, slope = truth(rng)
    pictures, albedo = photographed(rng, slope)
    surface = estimate_surface(pictures)
    assert np.corrcoef(surface.slope[..., 1].ravel(), slope[..., 1].ravel())[0, 1] > 0.99
    fitted = np.polyfit(slope[..., 1].ravel(), surface.slope[..., 1].ravel(), 1)[0]
    assert 0.9 < fitted < 1.05  # the prior shrinks by a few per cent
    assert np.corrcoef(np.log(surface.albedo[..., 1]).ravel(), np.log(albedo[..., 1]).ravel())[0, 1] > 0.97
    assert surface.slope_std[1] < 0.5 * surface.slope_std[0]  # no lamp stands across the plane


def test_slopes_across_the_plane_follow_from_integrability(rng):
    _, slope = truth(rng)
    surface = estimate_surface(photographed(rng, slope)[0])
    assert np.corrcoef(surface.relief[..., 0].ravel(), slope[..., 0].ravel())[0, 1] > 0.6
    assert np.abs(surface.slope[..., 0]).max() < 1e-9  # pixel by pixel there is nothing to see


def test_lamps_around_a_sample_show_both_slopes(rng):
    _, slope = truth(rng)
    azimuth = np.arange(8) * np.pi / 4.0
    lamps = np.stack([0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), np.full(8, 0.8)], axis=-1)
    factors = Response.of(lamps, np.full((8, 3), 0.5)).factors
    values = 0.5 * np.exp(np.einsum("jk,hwk->jhw", factors[:, :2], slope))[..., None] * np.ones(3)
    found = estimate_surface(
        SurfacePictures(
            "all round", values, lamps, np.array([0.0, 0.0, 1.0]), ("",) * 8, np.full((8, 3), np.nan)
        )
    )
    for axis in range(2):
        assert np.corrcoef(found.slope[..., axis].ravel(), slope[..., axis].ravel())[0, 1] > 0.99


def steepness(found, slope):
    """Return the ratio of found slopes to true ones, by regression."""
    return np.polyfit(slope.ravel(), found.ravel(), 1)[0]


@pytest.mark.parametrize("angle_deg", [5.0, 15.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize("count", [3, 4, 8])
def test_slopes_of_a_matte_relief_are_exact_whatever_the_angle_of_the_lamps(angle_deg, count, rng):
    _, slope = truth(rng, (96, 110))
    found = estimate_surface(matte(rng, slope, lamps_around(count, angle_deg)))
    # 3 pictures leave no residual: their noise is taken from neighbouring pixels, which differ by the relief as well.
    np.testing.assert_allclose(found.slope, slope, atol=0.005 if count == 3 else 2e-3)
    assert steepness(found.slope, slope) == pytest.approx(1.0, abs=0.01)
    assert np.std(found.albedo) < 5e-4
    assert np.all(found.slope_std < 0.02)


def test_slopes_of_a_matte_relief_are_exact_for_coloured_points_and_lamps_of_any_strength_and_angle(rng):
    _, slope = truth(rng, (96, 110))
    albedo = np.exp(0.4 * rough(rng, (96, 110)))[..., None] * np.array([0.5, 0.2, 0.05])
    albedo[:, :55] = albedo[:, :55, ::-1]
    lamps = np.vstack([lamps_around(5, 20.0), lamps_around(4, 50.0), [[0.0, 0.0, 1.0]]])
    found = estimate_surface(matte(rng, slope, lamps, albedo=albedo, strengths=rng.uniform(0.3, 3.0, 10)))
    np.testing.assert_allclose(found.slope, slope, atol=3e-3)
    np.testing.assert_allclose(found.albedo, albedo / albedo.mean(axis=(0, 1)), rtol=5e-3)
    lamp = lamps_around(1, 40.0)[0]
    (true,) = matte(rng, slope, lamp[None], albedo=albedo).values
    np.testing.assert_allclose(found.lit(lamp, true.mean(axis=(0, 1))), true, rtol=0.01)


@pytest.mark.parametrize(("count", "noise"), [(8, 0.02), (8, 0.1), (3, 0.05)])
def test_noisy_slopes_shrink_as_far_as_their_noise_requires(count, noise, rng):
    _, slope = truth(rng, (128, 128))
    lamps = lamps_around(count, 30.0)
    found = estimate_surface(matte(rng, slope, lamps, noise=noise))
    off = np.sqrt(np.mean((found.slope - slope) ** 2))
    # Wiener: noise n and slopes s leave s n / sqrt(s^2 + n^2); n = noise / (tan(30) sqrt(J / 2) sqrt(3 channels)).
    n = noise / (np.tan(np.pi / 6.0) * np.sqrt(count / 2.0) * np.sqrt(3.0))
    assert off < 1.15 * 0.1 * n / np.hypot(0.1, n)
    np.testing.assert_allclose(found.slope_std, off, rtol=0.25)


def test_shadows_and_glints_in_some_pictures_leave_slopes_right(rng):
    _, slope = truth(rng, (96, 110))
    pictures = matte(rng, slope, lamps_around(12, 40.0), noise=0.01)
    values = pictures.values.copy()
    values[rng.random(values.shape[:3]) < 0.04] *= 0.1
    values[rng.random(values.shape[:3]) < 0.04] *= 4.0
    found = estimate_surface(replace(pictures, values=values))
    off = np.abs(found.slope - slope)
    assert np.median(off) < 0.005
    assert np.quantile(off, 0.9) < 0.02  # 5 standard deviations of the noise


def test_one_row_of_lamps_leaves_slopes_across_it_to_integrability(rng):
    _, slope = truth(rng, (96, 110))
    angle = np.deg2rad([-50.0, -30.0, -10.0, 20.0, 40.0])
    lamps = np.column_stack([0.0 * angle, np.sin(angle), np.cos(angle)])
    found = estimate_surface(matte(rng, slope, lamps))
    assert steepness(found.slope[..., 1], slope[..., 1]) == pytest.approx(1.0, abs=0.01)
    assert np.abs(found.slope[..., 0]).max() < 1e-6
    assert found.slope_std[0] == pytest.approx(0.1, rel=0.2)  # as steep as those along the row
    assert np.corrcoef(found.relief[..., 0].ravel(), slope[..., 0].ravel())[0, 1] > 0.6


@pytest.mark.parametrize("angle_deg", [15, 60])
def test_photographs_of_a_matte_relief_become_textures_with_its_slopes(angle_deg, tmp_path, rng):
    at = np.arange(256) * 2.0 * np.pi / 16.0
    slope = 0.1 * np.sqrt(2.0) * np.stack(np.broadcast_arrays(np.cos(at), np.cos(at)[:, None]), axis=-1)
    lamps = lamps_around(8, angle_deg)
    files = [tmp_path / f"{j}.png" for j in range(8)]
    for path, values in zip(files, matte(rng, slope, lamps, albedo=np.ones(3) * 0.8).values, strict=True):
        codes = (values[..., 0] * 65535.0).astype(np.uint16)  # 16 bits without a colour space are linear
        Image.fromarray(codes).save(path)
    np.savetxt(tmp_path / "lamps.txt", lamps)
    surface = estimate_surface(read_folder(files, tmp_path / "lamps.txt"))
    np.testing.assert_allclose(surface.relief.std(axis=(0, 1)), 0.1, rtol=0.002)
    textures = tile(surface, 256)
    np.testing.assert_allclose(
        textures.slope.std(axis=(0, 1)), 0.1, rtol=0.03
    )  # seams of the quilt are blended
    assert textures.albedo.std(axis=(0, 1)).max() < 1e-4


def test_slopes_of_heights_are_their_derivatives():
    row, column = (
        4.0 * np.pi / 65.0 * (np.arange(65)[:, None] + 0.5),
        20.0 * np.pi / 80.0 * (np.arange(80) + 0.5),
    )
    slope = np.stack(
        [
            20.0 * np.pi / 80.0 * np.cos(row) * np.sin(column),
            -4.0 * np.pi / 65.0 * np.sin(row) * np.cos(column),
        ],
        axis=-1,
    )
    np.testing.assert_allclose(estimate._slopes_of(np.cos(row) * np.cos(column)), slope, atol=1e-12)
    np.testing.assert_allclose(integrated(slope, np.ones(2)), np.cos(row) * np.cos(column), atol=1e-12)


def test_a_lamp_that_was_left_out_is_predicted_better_than_by_the_mean_of_the_others(rng):
    _, slope = truth(rng)
    pictures, _ = photographed(rng, slope)
    left_out = 1
    made = estimate_surface(pictures.without(left_out)).lit(
        pictures.lamps[left_out], pictures.means[left_out]
    )
    true = pictures.values[left_out]
    np.testing.assert_allclose(made.mean(axis=(0, 1)), pictures.means[left_out], rtol=1e-9)
    others = pictures.without(left_out).values
    mean = (others / others.mean(axis=(1, 2), keepdims=True)).mean(axis=0) * pictures.means[left_out]
    assert np.sqrt(np.mean((made - true) ** 2)) < 0.4 * np.sqrt(np.mean((mean - true) ** 2))


@pytest.mark.skipif(not backend.choose().is_llvm, reason="needs a libLLVM that Dr.Jit can use")
@pytest.mark.parametrize("roughness", [0.8, 0.45])
def test_slopes_of_a_rendered_relief_are_as_steep_as_they_were_whatever_its_gloss(roughness, rng):
    height, slope = (0.8 * each for each in truth(rng, (128, 128)))
    colour = np.array([0.5, 0.3, 0.2])
    reflectance = colour * np.exp(0.15 * rough(rng, height.shape))[..., None]
    pictures = rendered(
        rng,
        lambda texture: {"type": "principled", "base_color": texture, "roughness": roughness},
        height,
        reflectance,
    )
    brdf = FittedBRDF.of(
        principled(("base_color", "roughness")),
        {"base_color": colour, "roughness": roughness},
        Bands(None),
        {},
    )
    inner = slice(BORDER, -BORDER)
    slope, albedo = (
        slope[inner, inner],
        reflectance[inner, inner] / reflectance[inner, inner].mean(axis=(0, 1)),
    )
    found = estimate_surface(pictures, brdf)
    along = slope[..., 1].ravel()
    assert np.corrcoef(found.slope[..., 1].ravel(), along)[0, 1] > 0.95
    assert 0.75 < np.polyfit(along, found.slope[..., 1].ravel(), 1)[0] < 1.1  # pixels blur, the prior shrinks
    assert np.corrcoef(found.relief[..., 0].ravel(), slope[..., 0].ravel())[0, 1] > 0.75
    assert np.std(np.log(found.albedo / albedo)) < 0.06  # of 0.15
    if roughness < 0.5:  # a Lambertian's response takes gloss for steepness
        assert np.polyfit(along, estimate_surface(pictures).slope[..., 1].ravel(), 1)[0] > 1.3


def test_heights_are_those_that_the_slopes_came_from(rng):
    height, slope = truth(rng)
    found = integrated(slope, np.ones(2))
    assert np.corrcoef(found.ravel(), height.ravel())[0, 1] > 0.98  # slopes are finite differences
    row_slope = np.gradient(found, axis=0)
    assert np.corrcoef(row_slope.ravel(), slope[..., 1].ravel())[0, 1] > 0.98


def test_a_surface_does_not_depend_on_the_rows_that_are_fitted_at_once(rng, monkeypatch):
    pictures, _ = photographed(rng, truth(rng)[1])
    whole = estimate_surface(pictures)
    monkeypatch.setattr(estimate, "_BLOCK_ROWS", 13)
    blocks = estimate_surface(pictures)
    for name in ("slope", "albedo", "third", "slope_std"):
        np.testing.assert_allclose(
            getattr(blocks, name), getattr(whole, name), atol=1e-9
        )  # sums in other orders


def test_glints_are_counted_under_the_lamps_that_show_them(rng):
    _, slope = truth(rng)
    pictures, _ = photographed(rng, 0.2 * slope)
    values = pictures.values.copy()
    rows, columns = rng.integers(5, 200, 40), rng.integers(5, 240, 40)
    for k, (row, column) in enumerate(zip(rows, columns, strict=True)):
        values[2 + k % 2, row : row + 2, column : column + 2] *= 3.0
    sparkle = sparkle_of(estimate_surface(replace(pictures, values=values)))
    counted = sparkle.density * 4 * SIZE[0] * SIZE[1] / 1e4  # four lamps within 50 degrees
    assert 30 <= counted <= 42  # a few overlap
    assert sparkle.seen_once > 0.9
    assert 3.0 <= sparkle.size_px <= 5.0
    assert 2.0 < sparkle.brightness < 3.5
    clean = sparkle_of(estimate_surface(pictures))
    assert (clean.density, clean.flakes) == (0.0, None)


def test_a_scratch_is_no_glint(rng):
    pictures, _ = photographed(rng, 0.2 * truth(rng)[1])
    values = pictures.values.copy()
    values[3, 50:53, 60:160] *= 4.0
    assert sparkle_of(estimate_surface(replace(pictures, values=values))).density == 0.0


@pytest.mark.parametrize(
    ("count", "strength", "gain"), [(400, 20.0, 1.0), (400, 2.5, 8.0), (1500, 20.0, 1.0)]
)
def test_flakes_are_possible_whatever_glints_are_counted(rng, count, strength, gain):
    """Glints are as frequent under all lamps, rare under a lamp that is much brighter, or everywhere."""
    pictures, _ = photographed(rng, 0.2 * truth(rng)[1])
    values = pictures.values.copy()
    for j in range(1, 5):
        own = count // 10 if j == 2 and gain > 1.0 else count
        rows, columns = rng.integers(5, 195, own), rng.integers(5, 235, own)
        values[j, rows, columns] *= strength
    values[2] *= gain
    flakes = sparkle_of(estimate_surface(replace(pictures, values=values))).flakes
    assert np.all(np.isfinite(list(vars(flakes).values())))
    assert flakes.slope_std <= 0.7
    assert flakes.density * flakes.size_px / 1e4 <= 0.3 + 1e-9
    assert flakes.reflectance <= 1.0


def test_flakes_are_drawn_as_many_as_large_and_as_tilted_as_they_are(rng):
    drawn = Flakes(density=40.0, size_px=9.0, slope_std=0.3, roughness=0.1, reflectance=0.04).drawn(512, rng)
    _, count = label(drawn.mask, structure=np.ones((3, 3)))
    assert 0.8 < count / (40.0 * 512**2 / 1e4) < 1.05  # some touch
    assert 0.85 < drawn.mask.mean() / (40.0 * 9.0 / 1e4) < 1.05
    slope = drawn.normal[..., 0] / drawn.normal[..., 2]
    assert 0.27 < slope[drawn.mask].std() < 0.33
    np.testing.assert_array_equal(
        drawn.normal[~drawn.mask], np.broadcast_to([0.0, 0.0, 1.0], (np.sum(~drawn.mask), 3))
    )


@pytest.mark.skipif(not backend.choose().is_llvm, reason="needs a libLLVM that Dr.Jit can use")
def test_flakes_of_a_rendered_relief_are_found_again(rng):
    known = Flakes(density=200.0, size_px=3.0, slope_std=0.3, roughness=0.1, reflectance=0.04)
    height = 0.5 * truth(rng, (256, 256))[0]
    reflectance = np.array([0.25, 0.2, 0.15]) * np.exp(0.1 * rough(rng, height.shape))[..., None]
    pictures = rendered(
        rng, lambda texture: {"type": "principled", "base_color": texture, "roughness": 0.7}, height, reflectance,
        flakes=known.drawn(256, rng),
    )  # fmt: skip
    found = sparkle_of(estimate_surface(pictures)).flakes
    # Some 80 glints a lamp, and pixels that blur: factors, not per cent.
    assert 0.5 < found.density / known.density < 2.0
    assert 0.6 < found.slope_std / known.slope_std < 1.6
    assert 0.5 < found.roughness / known.roughness < 1.5
    assert 0.5 < found.reflectance / known.reflectance < 2.0


def test_a_texture_continues_across_its_edges_and_keeps_the_distribution(rng):
    sample = np.exp(0.3 * rough(rng))[..., None] * np.array([1.0, 2.0])
    made = blend(sample, 300, np.random.default_rng(1))
    assert made.shape == (300, 300, 2)
    steps = np.abs(np.diff(made, axis=0)).mean()
    assert np.abs(made[0] - made[-1]).mean() < 1.3 * steps
    assert np.abs(made[:, 0] - made[:, -1]).mean() < 1.3 * np.abs(np.diff(made, axis=1)).mean()
    for share in (10, 50, 90):
        np.testing.assert_allclose(
            np.percentile(made[..., 0], share), np.percentile(sample[..., 0], share), rtol=0.08
        )


def test_all_parts_of_a_sample_are_used_about_equally_often(rng):
    sample = np.stack([rough(rng), rough(rng)], axis=-1)
    uses = quilt(sample, 768, rng).uses(SIZE)
    assert np.mean(uses == 0.0) < 0.02
    inner = uses[16:-16, 16:-16] / uses.mean()  # few places of a patch reach the edges
    assert inner.std() < 0.4
    assert inner.max() < 2.5


def test_marks_are_as_frequent_in_a_texture_as_in_the_sample(rng):
    sample = 0.05 * rough(rng, (240, 320))[..., None] * np.ones(2)
    y, x = np.indices(sample.shape[:2])
    for row, column in rng.uniform([6, 6], [234, 314], (50, 2)):
        sample[np.hypot(y - row, x - column) < 3.5, 0] = 1.0
    texture = blend(sample, 768, np.random.default_rng(2))

    def density(values):
        return label(values[..., 0] > 0.5)[1] / values[..., 0].size

    # The texture shows about 380 marks of 50: parts of the sample are used 7.7 times, give or take a quarter.
    assert density(texture) == pytest.approx(density(sample), rel=0.2)


def test_a_single_speck_is_removed_as_dust_but_repeated_spots_and_large_areas_stay(rng):
    logs = 0.05 * rough(rng)[..., None] * np.ones(3)
    logs[41:46, 61:66] += np.array([1.0, -1.0, 0.0])
    for row, column in ((30, 200), (120, 40), (150, 180)):
        logs[row : row + 6, column : column + 6] -= 1.0
    logs[170:210, 20:60] += 0.8  # a part of the sample, though there is one only
    dust = dust_in(logs)
    assert dust[43, 63]
    assert np.all(dust[32:50, 52:74].sum() == dust.sum())
    _, slope = truth(rng)
    surface = replace(estimate_surface(photographed(rng, slope)[0]), albedo=np.exp(logs))
    textures = tile(surface, 256)
    (note,) = textures.notes
    assert "left out as dust" in note
    assert "at column 63, row 43" in note
    assert np.log(textures.albedo[..., 0] / textures.albedo[..., 1]).max() < 0.5  # that of the dust is 2
    assert textures.albedo.min() < 0.6  # the other spots are there


@pytest.mark.parametrize(
    ("speck", "others", "is_dust"),
    [
        ((0.2, 0.0, 0.0), (0.2, 0.0, 0.0), False),
        ((0.16, 0.0, 0.0), (0.09, 0.0, 0.0), False),  # too faint to be dust, yet of that colour
        ((1.0, 0.0, 0.0), (0.2, 0.0, 0.0), True),  # far fainter
        ((0.8, 0.0, 0.0), (0.8, 0.6, 0.0), True),  # of another colour
    ],
)
def test_a_speck_is_dust_unless_other_spots_are_about_as_strong_and_of_its_colour(
    rng, speck, others, is_dust
):
    logs = 0.05 * rng.standard_normal((200, 240, 3))
    logs[40:52, 60:72] += speck
    for row, column in ((30, 200), (120, 40), (150, 180)):
        logs[row : row + 12, column : column + 12] += others
    assert bool(dust_in(logs)[46, 66]) == is_dust


def test_textures_of_a_surface_have_normals_that_belong_to_their_heights(rng):
    _, slope = truth(rng)
    made = tile(estimate_surface(photographed(rng, slope)[0]), 256)
    rows = (np.roll(made.height, -1, axis=0) - np.roll(made.height, 1, axis=0)) / 2.0
    assert np.corrcoef(rows.ravel(), made.slope[..., 1].ravel())[0, 1] > 0.9
    np.testing.assert_allclose(np.linalg.norm(made.normal, axis=-1), 1.0)
    np.testing.assert_allclose(made.albedo.mean(axis=(0, 1)), 1.0)
    with pytest.raises(UsageError, match="expected 192 to 8192"):
        tile(estimate_surface(photographed(rng, slope)[0]), 100)


def test_a_texture_has_no_colours_that_the_sample_without_its_dust_has_not(rng):
    _, slope = truth(rng)
    surface = estimate_surface(photographed(rng, slope)[0])
    shade = 0.3 * rough(rng)
    logs = np.stack([shade, shade**2, -shade], axis=-1)  # a curve: channels that are blended apart leave it
    brightest = logs.max()
    logs[100:110, 50:60] = 2.0  # dust
    made = np.log(tile(replace(surface, albedo=np.exp(logs)), 256).albedo)
    made -= np.median(made, axis=(0, 1)) - np.median(logs, axis=(0, 1))
    # Slow variation of neighbouring patches is blended, and keeps its variance: sums may exceed both.
    assert made.max() < brightest + 0.1 < 1.7
    assert np.std(made[..., 0] + made[..., 2]) < 0.01  # red and blue are opposite


def test_shaded_edges_are_cropped_and_dust_is_found():
    albedo = np.ones((200, 240, 3))
    albedo[:6] *= 0.5
    albedo[:, -3:] *= 1.4
    assert uncropped(albedo) == (slice(6, 200), slice(0, 237))
    albedo[:60] *= 0.5
    assert uncropped(albedo)[0].start == 25  # no shadow of an aperture is wider than an eighth of a side
    logs = 0.05 * np.random.default_rng(0).standard_normal((200, 240, 3))
    logs[100:108, 50:58] += 1.0
    dust = dust_in(logs)
    assert dust[104, 54]
    assert dust.sum() < 400


def test_a_workbook_s_pictures_are_read_with_their_geometries_and_registered(rng, tmp_path):
    slope = workbook(tmp_path / "twin.xlsx", rng, shift_px=1)
    pictures, readings = read_workbook(tmp_path / "twin.xlsx")
    assert pictures.labels == CAPTIONS
    assert readings.name == "twin"
    np.testing.assert_allclose(pictures.lamps[0], [0.0, -np.sin(np.pi / 3), 0.5], atol=1e-12)
    assert np.isnan(pictures.lamps[6]).all()
    np.testing.assert_allclose(pictures.factors[:6], 1.0, atol=0.03)  # 8 bits
    assert "red shifted by +1.00 pixels along the rows to align with green" in pictures.notes
    found = estimate_surface(pictures).slope[..., 1]
    margin = (slope.shape[0] - found.shape[0]) // 2
    assert np.corrcoef(found.ravel(), slope[margin:-margin, :, 1].ravel())[0, 1] > 0.97


def test_pictures_that_do_not_belong_to_their_readings_are_refused(rng, tmp_path):
    workbook(tmp_path / "twin.xlsx", rng, factor=(1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0))
    with pytest.raises(FileFormatError, match=r"picture 15as-15 is 2.* times as bright"):
        read_workbook(tmp_path / "twin.xlsx")


def test_a_workbook_without_pictures_is_refused_by_name(tmp_path):
    wi, wo = geometry_ma_t12()
    nm = np.arange(400.0, 701.0, 10.0)
    ma_t12.write(tmp_path / "bare.xlsx", Readings("bare", "MA-T12", wi, wo, nm, np.full((12, 31), 0.1)))
    with pytest.raises(FileFormatError, match="found 0 pictures with a geometry, expected at least 3"):
        read_workbook(tmp_path / "bare.xlsx")


def test_clipped_pictures_of_a_surface_are_noted(rng, tmp_path):
    files = []
    for k in range(3):
        codes = rng.integers(60, 200, (40, 50, 3), dtype=np.uint8)
        codes[:2] = 255 if k == 1 else 100
        files.append(tmp_path / f"{k}.png")
        Image.fromarray(codes).save(files[-1])
    lamps = tmp_path / "lamps.txt"
    lamps.write_text("1 0 1\n0 1 1\n-1 0 1\n")
    noted = [note for note in read_folder(files, lamps).notes if "are clipped" in note]
    assert [note.partition(":")[0] for note in noted] == ["1.png"]


def test_a_folder_of_pictures_and_a_table_of_lamps_are_read(rng, tmp_path):
    files = []
    for k in range(3):
        files.append(tmp_path / f"{k}.png")
        Image.fromarray(rng.integers(60, 200, (40, 50, 3), dtype=np.uint8)).save(files[-1])
    lamps = tmp_path / "lamps.txt"
    lamps.write_text("1 0 1 1\n0 1 1 2\n-1 0 1 1\n")
    assert files_in([tmp_path]) == files
    pictures = read_folder(files_in([tmp_path]), lamps)
    np.testing.assert_allclose(pictures.lamps[1], [0.0, np.sqrt(0.5), np.sqrt(0.5)])
    assert pictures.values.shape == (3, 40, 50, 3)
    np.testing.assert_allclose(
        pictures.values[1], read_picture(files[1]).values / 2.0, rtol=1e-6
    )  # twice as bright
    assert any("read as sRGB" in note and note.startswith("0.png, 1.png") for note in pictures.notes)
    linear = read_folder(files, lamps, is_linear=True)
    codes = np.asarray(Image.open(files[1])) / 255.0
    np.testing.assert_allclose(linear.values[1], codes / 2.0, rtol=1e-6)
    lamps.write_text("1 0 1\n0 1 1\n")
    with pytest.raises(UsageError, match="found 2 lamps for 3 pictures"):
        read_folder(files, lamps)
    lamps.write_text("1 0 1\n0 1 1\n0 0 -1\n")
    with pytest.raises(UsageError, match=r"^2\.png .*: the lamp is behind the surface, expected z above 0"):
        read_folder(files, lamps)
    lamps.write_text("1 0 1\n0 1 0\n1 0 -1\n")
    with pytest.raises(UsageError, match=r"^1\.png .*, 2\.png .*: the lamp is behind the surface"):
        read_folder(files, lamps)


def test_without_readings_no_colour_is_cut(rng):
    """Squares of contrast 3 in one hue: the brightest are as bright as white in the brightest channel."""
    hue, lamps = (
        np.array([1.0, 0.8, 0.6]),
        np.array([[0.5, 0.0, 0.9], [-0.25, 0.45, 0.9], [-0.25, -0.45, 0.9]]),
    )
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    is_bright = np.kron(np.indices((6, 6)).sum(axis=0) % 2 == 0, np.ones((40, 40))).astype(bool)
    albedo = np.where(is_bright, 0.6, 0.2)[..., None] * hue
    values = 0.5 * lamps[:, 2, None, None, None] * albedo
    values = values * np.exp(0.005 * rng.standard_normal(values.shape))
    unknown = np.full((3, 3), np.nan)
    pictures = SurfacePictures("squares", values, lamps, np.array([0.0, 0.0, 1.0]), ("a", "b", "c"), unknown)
    surface = estimate_surface(pictures)
    colours = surface.mean * surface.albedo
    for part, expected in ((is_bright, hue), (~is_bright, hue / 3.0)):
        np.testing.assert_allclose(
            np.median(colours[part], axis=0), expected, rtol=0.02
        )  # three noises of 0.5 %
    textures = Textures(surface.albedo, surface.slope, surface.height)
    assert textures.cut_share(surface.mean) < 0.005
    assert textures.cut_share(1.1 * surface.mean) > 0.4


def test_pictures_that_are_too_large_together_are_refused_after_the_first(rng, tmp_path, monkeypatch):
    files = [tmp_path / f"{k}.png" for k in range(3)]
    Image.fromarray(rng.integers(60, 200, (40, 50, 3), dtype=np.uint8)).save(files[0])
    lamps = tmp_path / "lamps.txt"
    lamps.write_text("1 0 1\n0 1 1\n-1 0 1\n")
    monkeypatch.setattr(lamp_pictures, "_MOST_TOGETHER", 5999)
    with pytest.raises(
        FileFormatError, match=r"found 3 pictures of 50 x 40 pixels, .* million together; crop"
    ):
        read_folder(files, lamps)  # the others do not exist
    Image.fromarray(rng.integers(60, 200, (40, 51, 3), dtype=np.uint8)).save(files[1])
    monkeypatch.undo()
    with pytest.raises(
        FileFormatError, match="found pictures of 50 x 40 and 51 x 40 pixels, expected one size"
    ):
        read_folder(files, lamps)
