"""Photographs as files hold them, and the outline of the ball in them."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from PIL import Image

from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.core.errors import FileFormatError, UsageError
from manifold.estimate.outlines import Circle, find_outlines, given_outline_notes, read_photograph
from manifold.render import images


@pytest.fixture
def picture(rng):
    return rng.integers(10, 250, (24, 32, 3), dtype=np.uint8)


def decoded(pixels):
    return decode_srgb(pixels / 255.0)


def test_png_is_decoded_as_srgb_with_a_note(tmp_path, picture):
    Image.fromarray(picture).save(tmp_path / "a.png")
    read = read_photograph(tmp_path / "a.png")
    assert np.allclose(read.values, decoded(picture), atol=1e-6)
    assert any("sRGB" in note for note in read.notes)
    linear = read_photograph(tmp_path / "a.png", is_linear=True)
    assert np.allclose(linear.values, picture / 255.0, atol=1e-6)
    assert linear.notes == ("a.png: values read as linear",)


def test_exr_and_tiff_are_linear(tmp_path, picture):
    linear = (picture / 100.0).astype(np.float32)
    images.write_image(tmp_path / "a.exr", linear)
    tifffile.imwrite(tmp_path / "a.tif", linear)
    tifffile.imwrite(tmp_path / "b.tif", (picture.astype(np.uint16) * 257))
    assert np.allclose(read_photograph(tmp_path / "a.exr").values, linear, rtol=1e-3)
    assert np.allclose(read_photograph(tmp_path / "a.tif").values, linear)
    assert np.allclose(read_photograph(tmp_path / "b.tif").values, picture / 255.0, atol=1e-6)


def test_turned_pictures_are_set_upright(tmp_path, picture):
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned clockwise by 90 degrees
    Image.fromarray(picture).save(tmp_path / "a.png", exif=exif)
    assert np.allclose(read_photograph(tmp_path / "a.png").values, decoded(np.rot90(picture, -1)), atol=1e-6)


def test_palettes_and_grey_are_read_and_transparent_pixels_unseen(tmp_path, picture):
    Image.fromarray(picture[..., 0]).save(tmp_path / "grey.png")
    grey = read_photograph(tmp_path / "grey.png")
    assert np.allclose(grey.values, decoded(picture[..., :1]), atol=1e-6)
    assert any("does not determine the colour" in note for note in grey.notes)
    few = Image.fromarray(picture).quantize(16)
    few.save(tmp_path / "palette.png")
    assert np.allclose(
        read_photograph(tmp_path / "palette.png").values, decoded(np.asarray(few.convert("RGB"))), atol=1e-6
    )
    alpha = np.full((24, 32, 1), 255, np.uint8)
    alpha[:5] = 100
    Image.fromarray(np.concatenate([picture, alpha], axis=2)).save(tmp_path / "alpha.png")
    unseen = np.isnan(read_photograph(tmp_path / "alpha.png").values).all(axis=2)
    assert unseen[:5].all()
    assert not unseen[5:].any()


def test_clipped_and_infinite_pixels_are_known(tmp_path, picture):
    picture[3:6, 3:6] = 255
    Image.fromarray(picture).save(tmp_path / "a.png")
    assert np.count_nonzero(read_photograph(tmp_path / "a.png").is_clipped.all(axis=2)) == 9
    linear = (picture / 100.0).astype(np.float32)
    linear[0, 0] = np.inf
    linear[0, 1] = np.nan
    tifffile.imwrite(tmp_path / "a.tif", linear)
    read = read_photograph(tmp_path / "a.tif")
    assert np.count_nonzero(np.isnan(read.values[..., 0])) == 2
    assert np.count_nonzero(read.is_clipped.all(axis=2)) == 9


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"\x89PNG\r\n\x1a\n" + bytes(100), "not a readable picture"),
        ("a.jpg", b"no picture", "not a readable picture"),
        ("a.exr", bytes(1000), "not a readable picture"),
        ("a.tif", b"II*\x00" + bytes(20), "not a readable picture"),
        ("a.gif", b"GIF89a", "expected EXR"),
    ],
)
def test_files_that_are_no_pictures_end_in_one_line(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_photograph(tmp_path / name)
    assert name in str(caught.value)


def test_tiny_pictures_are_refused(tmp_path):
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "a.png")
    with pytest.raises(FileFormatError, match="at least 16 pixels"):
        read_photograph(tmp_path / "a.png")


def drawn(shape, circle, rng, light=0.8):
    """A shaded ball on a textured ground."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    u, v = (x - circle.x) / circle.radius, (circle.y - y) / circle.radius
    r2 = u * u + v * v
    shade = light * np.maximum(0.2, 0.4 * np.sqrt(np.maximum(1 - r2, 0)) - 0.4 * u + 0.5 * v)
    ground = 0.3 + 0.05 * np.sin(x / 9.0) + 0.02 * rng.standard_normal(shape)
    return np.repeat(np.where(r2 < 1.0, shade, ground)[..., None], 3, axis=2)


@pytest.mark.parametrize(
    ("shape", "circle"),
    [((120, 160), Circle(70.0, 58.0, 40.0)), ((600, 500), Circle(260.5, 330.0, 180.0)), ((64, 64), Circle(32, 32, 27))],
)  # fmt: skip
def test_the_ball_is_found(rng, shape, circle):
    found = find_outlines(drawn(shape, circle, rng), "ball.png")[0].circle
    apart = np.hypot(found.x - circle.x, found.y - circle.y)
    assert apart < 0.02 * circle.radius
    assert found.radius == pytest.approx(circle.radius, rel=0.02)


def test_a_picture_without_a_ball_is_refused(rng):
    with pytest.raises(UsageError, match="no ball found"):
        find_outlines(0.5 + 0.05 * rng.standard_normal((100, 100, 3)), "noise.png")
    with pytest.raises(UsageError, match="no ball found"):
        find_outlines(np.full((100, 100, 3), 0.5), "flat.png")


def test_ball_with_a_small_highlight_is_found_beside_a_card(rng):
    """A circle around the ball shrank to a few pixels on its rim when it was refined."""
    ball = Circle(330.0, 170.0, 70.0)
    y, x = np.mgrid[:320, :480] + 0.5
    normal = np.stack([(x - ball.x) / 70.0, (ball.y - y) / 70.0, np.zeros(x.shape)])
    inside = np.hypot(*normal[:2]) < 1.0
    normal[2] = np.sqrt(np.maximum(1.0 - normal[0] ** 2 - normal[1] ** 2, 0.0))
    lamp = np.array([0.5, 0.3, 1.0]) / np.linalg.norm([0.5, 0.3, 1.0])
    half = (lamp + np.eye(3)[2]) / np.linalg.norm(lamp + np.eye(3)[2])
    lit, highlight = (np.maximum(np.tensordot(w, normal, 1), 0.0) for w in (lamp, half))
    picture = np.where(inside, 0.6 * lit + highlight**200, 0.02)
    picture[110:170, 40:100] = 0.5 * lamp[2]
    picture *= 1.0 + 0.01 * rng.standard_normal(picture.shape)
    shown = encode_srgb(np.clip(picture / np.quantile(picture, 0.99), 0.0, 1.0))
    found = find_outlines(np.repeat(shown[..., None], 3, axis=2), "ball.png")[0].circle
    np.testing.assert_allclose([found.x, found.y, found.radius], [ball.x, ball.y, ball.radius], atol=1.0)


def test_small_circle_may_be_given_in_a_large_picture(tmp_path):
    """The circle has less than a pixel where edges are compared."""
    y, x = np.mgrid[:600, :4000] + 0.5
    grey = np.where(np.hypot(x - 300.0, y - 300.0) < 8.0, 200, 10).astype(np.uint8)
    Image.fromarray(np.repeat(grey[..., None], 3, axis=2)).save(tmp_path / "a.png")
    assert given_outline_notes([read_photograph(tmp_path / "a.png")], Circle(300.0, 300.0, 8.0)) == ()


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "1,2,nan", "1,2,-3"])
def test_circles_that_are_none_are_refused(text):
    with pytest.raises(UsageError, match="expected X,Y,R"):
        Circle.parse(text)
