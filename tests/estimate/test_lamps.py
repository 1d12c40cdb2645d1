"""Lamps of photographed balls: given, in files, and found in the pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli.photograph_commands import PhotoOptions
from manifold.analytic.diffuse import RoughDiffuse
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.colour.lights import environment
from manifold.core.directions import from_spherical
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.metrics import Errors
from manifold.core.records import Bands
from manifold.estimate import Completion, lamp_plan, light_probe
from manifold.estimate.completions import Photographed, odd_pictures
from manifold.estimate.expected import calibrate
from manifold.estimate.lamp_plan import plan_lamps
from manifold.estimate.lamps import (
    Lamp,
    clipped_spots,
    lamp_pairs,
    lamp_picture,
    parse_lamp,
    read_lamps,
    unwrapped,
)
from manifold.estimate.light_probe import (
    doubt_encoding,
    edges_on_limb,
    given_encoding_notes,
    given_lamp_notes,
)
from manifold.estimate.outlines import Circle, Cylinder, Photograph, given_outline_notes, outlines_in
from manifold.estimate.pixels import Camera, Environment, block_sums, blocks_of
from manifold.estimate.sightings import PhotoRequest, SeenBall, Sighting, have_own_exposures, see
from manifold.estimate.solving import CONTRADICTION, strength_of_spots
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import read_bsdf
from manifold.render.images import write_image
from manifold.surface.lamp_pictures import read_folder

PAINT = Plastic(GGX.isotropic(0.2), np.array(1.5), np.array([0.3, 0.4, 0.5]), Bands(None))
SIZE, MARGIN = 96, 0.25
CIRCLE = Circle(SIZE / 2, SIZE / 2, SIZE / 2 / (1.0 + MARGIN))
DIRECTIONS = np.array([[0.5, 0.4, 0.8], [-0.6, 0.2, 0.7], [0.1, 0.7, 0.6]])


_FOUND = {}


def find_light(photographs, circle=None, distance=np.inf, *, search=light_probe.find_light, **options):
    """Search for lamps, which takes a second, once in the same pictures."""
    pixels = tuple((one.values.tobytes(), one.is_clipped.tobytes()) for one in photographs)
    key = pixels, circle, distance, *options.items()
    if key not in _FOUND:
        _FOUND[key] = search(photographs, circle, distance, **options)
    return _FOUND[key]


@pytest.fixture(scope="module", autouse=True)
def search_once():
    """Let doubts about encodings share the searches of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(light_probe, "find_light", find_light)
        yield


def photograph(direction, gain=1.0):
    lamp = Lamp.towards(direction)
    made = gain * lamp_picture(PAINT, Camera(), [lamp], SIZE, MARGIN)
    clipped = made > 1.0
    return Photograph(Path("made"), np.minimum(made, 1.0).astype(np.float32), clipped)


def test_a_white_diffuser_that_faces_the_lamp_is_one():
    picture = photograph([0.0, 0.0, 1.0])
    blocks = blocks_of(picture, CIRCLE)
    wi, wo, light = lamp_pairs(blocks, Camera(), [Lamp(np.array([0.0, 0.0, 1.0]))])
    sums = block_sums(lambda a, b: np.full((1, len(a)), 1.0 / np.pi), wi, wo, light)[0, 0]
    means = np.add.reduceat(np.sqrt(1.0 - blocks.x**2 - blocks.y**2), blocks.starts) / blocks.counts
    np.testing.assert_allclose(sums, means, atol=0.03)  # 24 points of a block
    assert np.mean(sums - means) == pytest.approx(0.0, abs=0.002)


def test_a_near_lamp_lights_the_near_side_more():
    blocks = blocks_of(photograph([0.0, 0.0, 1.0]), CIRCLE)
    near, far = (
        lamp_pairs(blocks, Camera(), [Lamp.towards(np.array([0.0, 0.0, 1.0]), distance)])[2].sum(axis=(1, 2))
        for distance in (3.0, np.inf)
    )
    middle = np.hypot(blocks.x[blocks.starts], blocks.y[blocks.starts]).argmin()
    assert near[middle] / far[middle] == pytest.approx((3.0 / 2.0) ** 2, rel=0.02)


def test_lamps_outline_and_gains_are_found_in_the_pictures():
    gains = [1.0, 0.6, 1.5]
    found = find_light([photograph(d, g) for d, g in zip(DIRECTIONS, gains, strict=True)])
    assert np.hypot(found.circle.x - CIRCLE.x, found.circle.y - CIRCLE.y) < 0.02 * CIRCLE.radius
    assert found.circle.radius == pytest.approx(CIRCLE.radius, rel=0.03)
    for lamp, direction in zip(found.lamps, DIRECTIONS, strict=True):
        assert np.rad2deg(np.arccos(lamp.direction @ direction / np.linalg.norm(direction))) < 4.0
    np.testing.assert_allclose(found.gains, gains, rtol=0.1)


@pytest.mark.parametrize("radius", [40.0, 80.0])
@pytest.mark.parametrize("off", [-0.01, 0.0, 0.01])
def test_edges_of_a_disc_are_where_its_pixels_are_half_covered(radius, off):
    size, fine, lamp = int(3 * radius), 8, np.array([[0.5, 0.5, 0.7]])
    true = Circle(size / 2 + 9.0, size / 2 - 6.0, radius)
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine
    covered = np.hypot(x - true.x, y - true.y) < radius
    picture = 0.5 * covered.reshape(size, fine, size, fine).mean(axis=(1, 3))
    disc = Photograph(Path("disc"), np.repeat(picture[..., None], 3, 2), np.zeros((size, size, 3), bool))
    start = Circle(true.x, true.y, (1.0 + off) * radius)
    circle, _ = edges_on_limb([disc], start, lamp / np.linalg.norm(lamp), start, 0.1)
    np.testing.assert_allclose([circle.x, circle.y, circle.radius], [true.x, true.y, radius], atol=0.15)


GLOSSY = Plastic(GGX.isotropic(0.1), np.array(1.5), np.array([0.3, 0.4, 0.5]), Bands(None))
MATTE = RoughDiffuse(np.array([0.3, 0.5, 0.7]), 1.0, Bands(None))
METAL = RoughConductor(GGX.isotropic(0.35), np.array([0.2, 0.9, 1.1]), np.array([3.9, 2.5, 2.4]), Bands(None))


@pytest.mark.parametrize(
    ("brdf", "number", "limit_deg"),
    # Highlights show a lamp better than the shading of matte materials, whose form the search does not know.
    [(GLOSSY, 1, 0.5), (METAL, 1, 1.0), (MATTE, 3, 2.0)],
)
def test_lamps_are_found_whatever_the_material(brdf, number, limit_deg):
    directions = DIRECTIONS[1:2] if number == 1 else DIRECTIONS
    pictures = []
    for direction in directions:
        values = lamp_picture(brdf, Camera(), [Lamp.towards(direction)], SIZE, MARGIN)
        values /= np.quantile(values, 0.995)
        pictures.append(Photograph(Path("ball"), np.minimum(values, 1.0).astype(np.float32), values > 1.0))
    found = find_light(pictures)
    for lamp, direction, deviation in zip(found.lamps, directions, found.lamp_deg, strict=True):
        cosine = lamp.direction @ direction / np.linalg.norm(direction)
        off = np.rad2deg(np.arccos(min(cosine, 1.0)))
        assert off < limit_deg
        assert off < 2.0 * deviation


@pytest.mark.parametrize(
    ("direction", "roughness"),
    [
        ([0.1, 0.2, 1.0], 0.2),
        ([0.5, 0.4, 0.8], 0.08),
        ([-0.6, 0.2, 0.3], 0.08),
        ([0.9, -0.1, 0.15], 0.08),
        ([0.9, -0.1, 0.15], 0.2),
    ],
)
def test_the_outline_of_a_black_ball_is_not_that_of_its_highlight(direction, roughness):
    black = Plastic(GGX.isotropic(roughness), np.array(1.5), np.full(3, 0.01), Bands(None))
    values = lamp_picture(black, Camera(), [Lamp.towards(direction)], 200, 0.5)
    values /= np.quantile(values, 0.995)
    picture = Photograph(Path("black"), np.minimum(values, 1.0).astype(np.float32), values > 1.0)
    found = find_light([picture])
    assert found.circle.radius == pytest.approx(200 / 3, rel=0.06)
    assert np.hypot(found.circle.x - 100.0, found.circle.y - 100.0) < 4.0
    off = found.lamps[0].degrees_from(Lamp.towards(direction))
    assert off < min(2.0 * found.lamp_deg[0], 8.0)


@pytest.mark.parametrize(("brdf", "count"), [(MATTE, 1), (GLOSSY, 1), (GLOSSY, 3)])
def test_the_uncertainty_of_lamps_covers_an_encoding_that_pictures_do_not_settle(brdf, count):
    directions = np.array([[0.7, 0.3, 0.5], [-0.3, 0.6, 0.7], [0.2, -0.5, 0.8]])
    for first in range(0, 3, count):
        some = directions[first : first + count]
        pictures = [
            stored(brdf, direction, lambda values: values) for direction in some
        ]  # linear, read as sRGB
        probe, _ = doubt_encoding(pictures, find_light(pictures))
        for lamp, direction, deviation in zip(probe.lamps, some, probe.lamp_deg, strict=True):
            assert lamp.degrees_from(Lamp.towards(direction)) < 2.0 * deviation


def stored(brdf, direction, codes_of):
    """A picture whose 8-bit codes are a function of the values, read as sRGB."""
    values = lamp_picture(brdf, Camera(), [Lamp.towards(direction)], SIZE, MARGIN)
    values = np.minimum(values / np.quantile(values, 0.995), 1.0)
    read = decode_srgb(np.round(255.0 * codes_of(values)) / 255.0).astype(np.float32)
    return Photograph(Path("ball.png"), read, values >= 1.0, is_encoded=True)


@pytest.mark.parametrize("brdf", [GLOSSY, MATTE])
def test_linear_pictures_that_are_read_as_srgb_are_noted(brdf):
    for codes_of, is_noted in ((lambda values: values, True), (encode_srgb, False)):
        pictures = [stored(brdf, direction, codes_of) for direction in DIRECTIONS]
        probe = find_light(pictures)
        wider, notes = doubt_encoding(pictures, probe)
        assert any("add --linear" in note for note in notes) == is_noted
        assert np.all(np.array(wider.lamp_deg) >= probe.lamp_deg)
        if is_noted:
            off = np.rad2deg(
                np.arccos(
                    [
                        lamp.direction @ direction / np.linalg.norm(direction)
                        for lamp, direction in zip(wider.lamps, DIRECTIONS, strict=True)
                    ]
                )
            )
            assert np.sqrt(np.mean((off / wider.lamp_deg) ** 2)) < 2.0
        assert doubt_encoding([replace(one, is_certain=True) for one in pictures], probe) == (probe, ())


def read_as_linear(photograph):
    return replace(photograph, values=encode_srgb(photograph.values), is_encoded=False)


def test_encoded_pictures_that_are_read_as_linear_are_noted():
    pictures = [read_as_linear(stored(MATTE, direction, encode_srgb)) for direction in DIRECTIONS]
    _, notes = doubt_encoding(pictures, find_light(pictures))
    assert any("add --encoded" in note for note in notes)
    pictures = [read_as_linear(stored(MATTE, direction, lambda values: values)) for direction in DIRECTIONS]
    probe = find_light(pictures)
    found, notes = doubt_encoding(pictures, probe)
    assert notes == ()
    # The other encoding is improbable, but not impossible.
    np.testing.assert_allclose(found.lamp_deg, probe.lamp_deg, rtol=0.01)


@pytest.mark.parametrize(
    ("codes_of", "read", "option"),
    [
        (lambda values: values, lambda one: one, "--linear"),
        (encode_srgb, lambda one: one, None),
        (encode_srgb, read_as_linear, "--encoded"),
        (lambda values: values, read_as_linear, None),
    ],
    ids=["linear as sRGB", "sRGB", "sRGB as linear", "linear"],
)
def test_given_lamps_say_how_pictures_are_encoded(codes_of, read, option):
    """Correct lamps disagree with the shading where values are read wrongly; wrong lamps do so in either reading."""
    direction = np.array([0.5, 0.3, 1.0])
    picture = read(stored(MATTE, direction, codes_of))
    notes = given_encoding_notes([picture], [CIRCLE], [Lamp.towards(direction)], are_given=True)
    assert [f"add {option}," in note for note in notes] == [True] * (option is not None)
    beside = Lamp.towards(direction * [0.83, 0.83, 1.0])  # 4.4 degrees off, towards the camera
    notes = given_encoding_notes([picture], [CIRCLE], [beside], are_given=True)
    assert [f"add {option}," in note for note in notes] == [True] * (option == "--linear")
    certain = replace(picture, is_certain=True)
    assert given_encoding_notes([certain], [CIRCLE], [Lamp.towards(direction)], are_given=True) == ()
    elsewhere = Lamp.towards(direction * [-1.0, 1.0, 1.0])
    assert given_encoding_notes([picture], [CIRCLE], [elsewhere], are_given=True) == ()


def test_of_many_pictures_some_say_all_but_the_lamps_of_the_others(monkeypatch):
    monkeypatch.setattr("manifold.estimate.light_probe._TOGETHER", 3)
    directions = np.vstack([DIRECTIONS, [[-0.3, -0.5, 0.8], [0.7, 0.0, 0.5]]])
    gains = [1.0, 0.6, 1.5, 0.8, 1.2]
    found = find_light([photograph(d, g) for d, g in zip(directions, gains, strict=True)])
    cosines = [
        lamp.direction @ d / np.linalg.norm(d) for lamp, d in zip(found.lamps, directions, strict=True)
    ]
    assert np.rad2deg(np.arccos(np.clip(cosines, -1.0, 1.0))).max() < 4.0
    np.testing.assert_allclose(found.gains, gains, rtol=0.1)
    assert len(found.lamp_deg) == 5
    assert all(0.0 < one < 10.0 for one in found.lamp_deg)


def test_near_lamps_are_found_at_their_distance():
    made = [
        lamp_picture(PAINT, Camera(), [Lamp.towards(d, 4.0)], SIZE, MARGIN).astype(np.float32)
        for d in DIRECTIONS
    ]
    pictures = [Photograph(Path("near"), np.minimum(one, 1.0), one > 1.0) for one in made]
    near, far = (find_light(pictures, CIRCLE, distance) for distance in (4.0, np.inf))

    def off(found):
        cosines = [
            lamp.direction @ d / np.linalg.norm(d) for lamp, d in zip(found.lamps, DIRECTIONS, strict=True)
        ]
        return np.rad2deg(np.arccos(np.clip(cosines, -1.0, 1.0))).max()

    assert off(near) < 4.0 < off(far)
    assert near.lamps[0].distance == 4.0


def test_a_picture_that_no_lamp_explains_is_named():
    stripes = np.broadcast_to((np.arange(SIZE) // 16 % 2)[:, None, None], (SIZE, SIZE, 3)).astype(np.float32)
    bad = Photograph(Path("bad.png"), stripes, np.zeros((SIZE, SIZE, 3), bool))
    with pytest.raises(UsageError, match=r"bad\.png: no single lamp explains the ball"):
        find_light([photograph(DIRECTIONS[0]), bad], CIRCLE)
    with pytest.raises(UsageError, match="; add --linear if its values are linear"):
        find_light([replace(bad, is_encoded=True)], CIRCLE)


def test_lamps_are_read_from_text_and_files(tmp_path):
    (tmp_path / "lights.txt").write_text("2\n0.4 0.5 0.8\n-1 0 1\n")
    lamps = parse_lamp(str(tmp_path / "lights.txt"))
    np.testing.assert_allclose(lamps[1].direction, np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0))
    assert parse_lamp("0,1,1,8")[0].distance == 8.0
    np.testing.assert_array_equal(parse_lamp("flash")[0].direction, [0.0, 0.0, 1.0])
    for wrong in ("0,0,0", "1,2", "0,0,1,0.5", "0,x,1"):
        with pytest.raises(UsageError, match="expected"):
            parse_lamp(wrong)
    for missing in ("torch", "lamps.txt", "nowhere/lights.txt", "a,b.txt"):
        with pytest.raises(
            ManifoldError, match=f"^{missing}: no such file; name a text of lines X Y Z, or give"
        ):
            parse_lamp(missing)
    (tmp_path / "bad.txt").write_text("0 0\n")
    with pytest.raises(ManifoldError, match="line 1"):
        parse_lamp(str(tmp_path / "bad.txt"))


PICTURES = ["dome 1.png", "dome 2.png", "dome 3.png"]
LAMPS = {
    "RTI": "3\ndome 1.png 0.5 0.0 0.8\ndome 2.png -0.2 0.4 0.8\ndome 3.png -0.2 -0.4 0.8\n",
    "RTI, another order": "3\ndome 3.png -0.2 -0.4 0.8\ndome 1.png 0.5 0.0 0.8\ndome 2.png -0.2 0.4 0.8\n",
    "RTI, folders of another system": "3\r\nC:\\x\\Dome 3.JPG -0.2 -0.4 0.8\r\nC:\\x\\Dome 1.JPG 0.5 0 0.8\r\n"
    "C:\\x\\Dome 2.JPG -0.2 0.4 0.8\r\n",
    "decimal commas": "0,5 0,0 0,8\n-0,2 0,4 0,8\n-0,2 -0,4 0,8\n",
    "semicolons": "# lamps\n0,5;0;0,8\n-0,2;0,4;0,8\n-0,2;-0,4;0,8\n",
    "numbered": "3\n1 0.5 0 0.8\n2 -0.2 0.4 0.8\n3 -0.2 -0.4 0.8\n",
    "commas": "0.5,0,0.8\n-0.2,0.4,0.8\n-0.2,-0.4,0.8\n",
    "header": "picture;z;y;x\ndome 2.png;0,8;0,4;-0,2\ndome 1.png;0,8;0;0,5\ndome 3.png;0,8;-0,4;-0,2\n",
}


@pytest.mark.parametrize("name", LAMPS)
def test_lamps_are_read_however_their_file_is_laid_out(name, tmp_path):
    path = tmp_path / "lamps.lp"
    path.write_text(LAMPS[name], newline="")
    expected = [(0.5, 0.0, 0.8), (-0.2, 0.4, 0.8), (-0.2, -0.4, 0.8)]
    expected = np.array(expected) / np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose([lamp.direction for lamp in read_lamps(path, PICTURES)], expected)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("12\n0 0 1\n", "found 1 lamps, expected 12, as the first line says"),
        ("a.png 0 0 1\nb.png 0 1 1\n", "no lamp of the picture dome 1.png, found those of a.png, b.png"),
        (
            "dome 1.png 0 0 1\n0 1 1\ndome 3.png 1 0 1\n",
            "no lamp of the picture dome 2.png, found those of dome 1",
        ),
        ("a.png 0 0 1\na.png 0 1 1\n", "line 2: the picture a.png occurs twice"),
        ("file,azimuth,elevation\na.png,10,40\n", "found the header file, azimuth, elevation"),
        ("0 0 1 2 3\n", "line 1: found '0 0 1 2 3'"),
        ("0 0 1 -1\n", "line 1: an intensity that is not above 0"),
        ("0 0 0\n", "line 1: a lamp at 0,0,0, expected a direction"),
        ("# none\n", "no lamps"),
    ],
)
def test_files_of_lamps_that_cannot_be_read_say_why(text, words, tmp_path):
    path = tmp_path / "lamps.lp"
    path.write_text(text)
    with pytest.raises(ManifoldError, match=words):
        read_lamps(path, PICTURES)


def test_numbers_that_name_pictures_are_no_coordinates(tmp_path):
    """`20 0.5 0 0.8` was a lamp at 20, 0.5, 0 of intensity 0.8."""
    path = tmp_path / "lamps.txt"
    path.write_text("20 0.5 0 0.8\n10 0 0.5 0.8\n30 0 0 1\n")
    found = read_lamps(path, ["10.png", "20.png"])
    np.testing.assert_allclose([lamp.direction[:2] * 0.89**0.5 for lamp in found], [(0.0, 0.5), (0.5, 0.0)])
    assert not any(lamp.known for lamp in found)


INTENSITIES = "1.2 1.0 0.8\n0.6 0.5 0.4\n2.4 2.0 1.6\n"


def written_set(folder, intensities=INTENSITIES):
    """Write the pictures and lamps of a photometric-stereo data set, laid out as DiLiGenT; return the pictures."""
    colours = [np.array(line.split(), float) for line in INTENSITIES.splitlines()]
    files = [folder / f"{k:03}.exr" for k in range(3)]
    for path, direction, colour in zip(files, DIRECTIONS, colours, strict=True):
        write_image(path, photograph(direction).values * colour)
    np.savetxt(folder / "light_directions.txt", DIRECTIONS)
    (folder / "light_intensities.txt").write_text(intensities)
    return files


@pytest.mark.parametrize("is_one_file", [True, False])
def test_photographs_take_the_intensities_of_their_lamps(is_one_file, photo_atoms, tmp_path):
    files = written_set(tmp_path)
    lamps = tmp_path / "light_directions.txt"
    if is_one_file:
        lamps = tmp_path / "lamps.txt"
        rows = zip(DIRECTIONS, INTENSITIES.splitlines(), strict=True)
        lamps.write_text("".join(f"{d[0]} {d[1]} {d[2]} {colour}\n" for d, colour in rows))
    request = PhotoOptions(lamp=[str(lamps)], circle=[str(CIRCLE)]).request_of(files)
    balls = see(request)
    np.testing.assert_allclose([ball.lamps[0].colour for ball in balls], np.loadtxt(INTENSITIES.splitlines()))
    assert not have_own_exposures(request, balls)
    notes = " ".join(balls[0].notes)
    assert "assumed to be white" not in notes
    assert ("intensities of the lamps from light_intensities.txt" in notes) != is_one_file
    found = Completion.of(photo_atoms, [ball.sighting for ball in balls], exposure=1.0)
    assert found.residual < 0.02  # 0.3 without the intensities
    pictures = read_folder(files, lamps)  # the same parser
    np.testing.assert_allclose(
        pictures.values, [np.maximum(photograph(d).values, 0.5 / 255) for d in DIRECTIONS], rtol=2e-2
    )


def test_one_intensity_per_lamp_is_a_strength_and_not_a_colour(tmp_path):
    files = written_set(tmp_path, "1\n0.5\n2\n")
    request = PhotoOptions(lamp=[str(tmp_path / "light_directions.txt")], circle=[str(CIRCLE)]).request_of(
        files
    )
    balls = see(request)
    np.testing.assert_allclose(
        [ball.lamps[0].colour for ball in balls], np.repeat([[1.0], [0.5], [2.0]], 3, 1)
    )
    assert not have_own_exposures(request, balls)
    assert any("assumed to be white" in note for note in balls[0].notes)
    (tmp_path / "light_intensities.txt").unlink()
    assert have_own_exposures(request, see(request))


def test_names_beside_directions_order_the_lamps(tmp_path):
    files = written_set(tmp_path)
    (tmp_path / "filenames.txt").write_text("002.exr\n000.exr\n001.exr\n")
    lamps = read_lamps(tmp_path / "light_directions.txt", [path.name for path in files[:2]])
    expected = DIRECTIONS[1:] / np.linalg.norm(DIRECTIONS[1:], axis=1, keepdims=True)
    np.testing.assert_allclose([lamp.direction for lamp in lamps], expected)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("light_intensities.txt", "1 1 1\n2 2 2\n", "found 2 lines, expected 3, one for each direction"),
        ("light_intensities.txt", "1\n0\n2\n", "line 2: found '0', expected one intensity above 0"),
        (
            "light_intensities.txt",
            "1\n1 2\n2\n",
            "line 2: found '1 2', expected one intensity above 0, or three",
        ),
        ("filenames.txt", "000.exr\n001.exr\n", "found 2 names, expected 3"),
    ],
)
def test_files_beside_directions_that_do_not_fit_say_why(name, text, words, tmp_path):
    written_set(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(ManifoldError, match=words):
        read_lamps(tmp_path / "light_directions.txt", PICTURES)


def test_given_lamps_behind_the_ball_are_refused_by_the_names_of_their_pictures(tmp_path):
    files = written_set(tmp_path)
    for lamps, named in (
        (["0.5,0.4,0.8", "0.1,0.2,-1", "0,0,1"], "001.exr"),
        (["0.5,0.4,-0.01"], "000.exr"),
        (["0,1,-1,5"], "000.exr"),
    ):
        with pytest.raises(
            UsageError, match=rf"^{named} \(.*: the lamp is behind the ball, expected z above 0"
        ):
            see(PhotoRequest(files, lamps=lamps, circles=[str(CIRCLE)]))
    see(PhotoRequest(files, lamps=["1,0,0"], circles=[str(CIRCLE)]))  # from the side


def test_a_grey_card_gives_exposure_and_colour_of_the_lamp(tmp_path):
    picture = np.zeros((SIZE, SIZE, 3), np.float32)
    picture[:] = photograph(DIRECTIONS[0]).values
    cosine = DIRECTIONS[0, 2] / np.linalg.norm(DIRECTIONS[0])
    picture[:10, :10] = 0.18 * cosine
    colour = np.array([2.0, 1.0, 0.5], np.float32)
    write_image(tmp_path / "ball.exr", picture * colour)
    circle, lamp = [str(CIRCLE)], ["0.5,0.4,0.8"]
    (ball,) = see(PhotoRequest([tmp_path / "ball.exr"], circles=circle, lamps=lamp, grey="1,1,8,8,0.18"))
    np.testing.assert_allclose(ball.photograph.values, picture, rtol=1e-3, atol=1e-5)
    (tmp_path / "lamp.txt").write_text("0.5 0.4 0.8 2 1 0.5\n")  # the card has measured that
    (same,) = see(
        PhotoRequest(
            [tmp_path / "ball.exr"], circles=circle, lamps=[str(tmp_path / "lamp.txt")], grey="1,1,8,8,0.18"
        )
    )
    np.testing.assert_allclose(same.sighting.pairs[2], ball.sighting.pairs[2])
    with pytest.raises(UsageError, match="times as bright as a white surface"):
        see(PhotoRequest([tmp_path / "ball.exr"], circles=circle, lamps=lamp, grey="1,1,8,8,0.99"))
    with pytest.raises(UsageError, match="corner and size in pixels"):
        see(PhotoRequest([tmp_path / "ball.exr"], circles=circle, lamps=lamp, grey="1,1,800,8,0.18"))


@pytest.mark.parametrize(
    ("x", "radius", "words"), [(0.0, 1.0, None), (0.0, 1.06, "edges near it"), (0.08, 1.0, "edges")]
)
def test_a_circle_beside_the_outline_is_doubted(x, radius, words):
    given = Circle(CIRCLE.x + x * CIRCLE.radius, CIRCLE.y, radius * CIRCLE.radius)
    notes = given_outline_notes([photograph([0.2, 0.2, 1.0])], given)
    assert notes == () if words is None else words in notes[0]


@pytest.mark.parametrize("degrees", [0.0, 4.0, 15.0, 30.0])
def test_a_lamp_given_elsewhere_is_doubted(degrees):
    direction = DIRECTIONS[0] / np.linalg.norm(DIRECTIONS[0])
    turn = np.deg2rad(degrees)
    beside = np.cross(direction, [0.0, 1.0, 0.0])
    given = Lamp.towards(np.cos(turn) * direction + np.sin(turn) * beside / np.linalg.norm(beside))
    notes = given_lamp_notes(photograph(direction), CIRCLE, given)
    assert len(notes) == (degrees > 10.0)


def test_a_ball_lit_from_one_side_keeps_its_outline_or_it_is_doubted():
    for direction in ([0.8, 0.2, 0.5], [-0.5, 0.6, 0.6], [0.0, -0.9, 0.4]):
        best, *_ = outlines_in([photograph(direction)])
        off = np.hypot(best.circle.x - CIRCLE.x, best.circle.y - CIRCLE.y) / CIRCLE.radius
        assert off < 1.0 / CIRCLE.radius or best.notes  # a pixel


def sightings_of(directions, gains):
    return [
        Sighting(blocks_of(photograph(d, g), CIRCLE), Camera(), (Lamp.towards(d),))
        for d, g in zip(directions, gains, strict=True)
    ]


def test_strengths_of_lamps_are_estimated_with_the_material(photo_atoms):
    gains = [1.0, 0.25, 0.5]
    seen = sightings_of(DIRECTIONS, gains)
    found = Completion.of(photo_atoms, seen, exposure=None, each=True)
    np.testing.assert_allclose(found.exposures / found.exposures[0], gains, rtol=0.1)
    assert found.residual < 0.02  # 0.1 if they share an exposure


def test_pictures_of_differing_exposures_that_are_taken_as_equal_are_noted(photo_atoms):
    for gains, is_noted in (([1.0, 0.25, 0.5], True), ([1.0, 1.0, 1.0], False)):
        seen = sightings_of(DIRECTIONS, gains)
        notes = Completion.of(photo_atoms, seen, exposure=None).notes
        assert any("give --exposure each" in note for note in notes) == is_noted


def test_a_picture_of_another_material_contradicts_the_others(photo_atoms):
    other = Plastic(GGX.isotropic(0.4), np.array(1.5), np.array([0.5, 0.05, 0.02]), Bands(None))
    names = ["a.png", "b.png", "c.png"]
    for last, odd in ((PAINT, []), (other, ["c.png"])):
        seen = sightings_of(DIRECTIONS[:2], [1.0, 0.5])
        made = lamp_picture(last, Camera(), [Lamp.towards(DIRECTIONS[2])], SIZE, MARGIN).astype(np.float32)
        picture = Photograph(Path("c.png"), np.minimum(made, 1.0), made > 1.0)
        seen.append(Sighting(blocks_of(picture, CIRCLE), Camera(), (Lamp.towards(DIRECTIONS[2]),)))
        found = Completion.of(photo_atoms, seen, exposure=None, each=True)
        assert len(found.picture_errors) == 3
        assert [note.partition(":")[0] for note in odd_pictures(names, found.picture_errors)] == odd
        balls = [SeenBall(picture, CIRCLE, None, sighting) for sighting in seen]
        made = Photographed(path=None, completion=found, balls=tuple(balls), expected=Errors())
        assert [row["predicted"] for row in made.photographs] == list(found.picture_errors)
        assert made.rows["photographs"][0].endswith("% predicted from the others")
    one = Completion.of(photo_atoms, sightings_of(DIRECTIONS[:1], [1.0]))
    assert one.picture_errors == ()
    assert odd_pictures(names[:2], (0.3, 0.3)) == []


def readings_of(brdf):
    wi, wo = geometry_ma_t12()
    return Readings("paint", "MA-T12", wi, wo, None, brdf.eval(wi, wo))


def test_readings_fix_an_unknown_exposure(photo_atoms):
    seen = [*sightings_of(DIRECTIONS[:1], [0.4]), readings_of(PAINT)]
    found = Completion.of(photo_atoms, seen, exposure=None, each=True)
    # The library has coats of this kind: what is left is the noise of 24 points of a block.
    assert found.exposure == pytest.approx(0.4, rel=0.1)


def test_a_repeated_picture_contributes_less_than_readings_that_fix_the_exposure(photo_atoms):
    seen = [*sightings_of(DIRECTIONS[[0, 0]], [0.4, 0.4]), readings_of(PAINT)]
    found = Completion.of(photo_atoms, seen, exposure=None)
    assert list(found.contributions) == ["picture 1", "picture 2", "readings"]
    assert found.contributions["picture 1"] < 0.5
    assert found.contributions["readings"] > 4.0 * found.contributions["picture 1"]
    (single,) = sightings_of(DIRECTIONS[:1], [1.0])
    both = Completion.of(photo_atoms, [single, readings_of(PAINT)])
    assert list(both.contributions) == ["picture 1", "readings"]


def test_a_picture_that_contradicts_readings_counts_less(photo_atoms):
    other = Plastic(GGX.isotropic(0.2), np.array(1.5), np.array([0.05, 0.04, 0.5]), Bands(None))
    readings = readings_of(other)
    right, wrong = (
        Completion.of(photo_atoms, [*sightings_of(DIRECTIONS[:1], [1.0]), readings_of(brdf)])
        for brdf in (PAINT, other)
    )
    assert right.solution.contradiction < CONTRADICTION < wrong.solution.contradiction
    # Values of cube roots between the two materials: nearer to the readings than to the picture.
    made, picture, read = (
        np.cbrt(brdf.eval(readings.wi, readings.wo)[:, 0]).mean() for brdf in (wrong.brdf, PAINT, other)
    )
    assert abs(made - read) < 0.2 * abs(made - picture)


def test_the_residual_of_pixels_that_contradict_readings_is_that_of_the_picture_as_given(photo_atoms):
    other = Plastic(GGX.isotropic(0.2), np.array(1.5), np.array([0.05, 0.04, 0.5]), Bands(None))
    balls = [
        SeenBall(photograph(d), CIRCLE, None, s)
        for d, s in zip(DIRECTIONS, sightings_of(DIRECTIONS, [1.0] * 3), strict=True)
    ]
    for count in (1, 3):
        seen = [ball.sighting for ball in balls[:count]]
        found = Completion.of(photo_atoms, [*seen, readings_of(other)])
        made = Photographed(path=None, completion=found, balls=tuple(balls[:count]), expected=Errors())
        of_pictures = [row["residual"] for row in made.photographs]
        assert min(of_pictures) > 0.3  # the materials differ
        assert made.residual == pytest.approx(np.sqrt(np.mean(np.square(of_pictures))))
        assert made.rows["residual"][0].startswith(f"{100 * made.residual:.1f} % of the pixels")
        assert "contradict" in made.advice
        alike = Completion.of(photo_atoms, [*seen, readings_of(PAINT)])
        calibration = calibrate(photo_atoms, found.exposed)
        assert calibration.expected(found).ball > 2.0 * calibration.expected(alike).ball


def test_lamps_have_unknown_strengths_unless_a_card_or_an_exposure_says_more():
    def exposures(**given):
        request = PhotoOptions(lamp=["found"], **given).request_of([Path("a.png"), Path("b.png")])
        return request.exposure, request.each

    assert exposures() == (None, None)  # each, unless a file states intensities
    assert exposures(exposure="free") == (None, False)
    assert exposures(exposure="2") == (2.0, False)
    assert exposures(grey="1,1,8,8,0.18") == (1.0, False)


# -- mirror balls -----------------------------------------------------------------------------------------------------


def mirror_ball(environment, camera, size=300, most=np.inf):
    """A photograph of a perfect mirror in an environment, clipped where it is brighter than `most`."""
    circle = Circle(size / 2, size / 2, 0.45 * size)
    y, x = np.mgrid[:size, :size] + 0.5
    u, v = (x - circle.x) / circle.radius, (circle.y - y) / circle.radius
    r2 = u * u + v * v
    normal = np.stack([u, v, np.sqrt(np.maximum(1.0 - r2, 0.0))], axis=-1)
    seen, _ = environment.at(
        (2.0 * normal[..., 2:] * normal - np.array([0.0, 0.0, 1.0])) @ np.array(camera.axes)
    )
    seen = np.where(r2[..., None] < 1.0, seen, 0.02)
    return Photograph(Path("mirror.png"), np.minimum(seen, most).astype(np.float32), seen >= most), circle


@pytest.mark.parametrize("elevation", [0.0, 25.0])
def test_a_mirror_ball_is_unwrapped_to_its_environment(elevation):
    image = environment("studio", 256).astype(float)
    camera = Camera(elevation_deg=elevation)
    photograph, circle = mirror_ball(Environment.of(image), camera)
    found = unwrapped(photograph, circle, camera)
    assert np.median(np.abs(found - image)) < 1e-3
    assert np.mean(np.abs(found - image)) < 0.02 * image.mean()


def test_clipped_spots_are_lamps_where_the_light_is():
    image = np.full((256, 512, 3), 0.1)
    image[60:70, 200:215] = 500.0
    camera = Camera()
    photograph, circle = mirror_ball(Environment.of(image), camera, most=1.0)
    (spot,) = clipped_spots(photograph, circle)
    theta, azimuth = np.pi * 65.0 / 256, 2.0 * np.pi * 207.5 / 512
    world = np.array([np.sin(theta) * np.sin(azimuth), np.sin(theta) * np.cos(azimuth), np.cos(theta)])
    assert np.rad2deg(np.arccos(spot.direction @ np.array(camera.axes) @ world)) < 2.0
    solid_angle = 15 * 10 * (np.pi / 256) ** 2 * np.sin(theta)
    np.testing.assert_allclose(spot.colour, solid_angle / np.pi, rtol=0.1)


@pytest.mark.parametrize("strength", [0.0, 40.0])
def test_how_bright_clipped_spots_are_is_found_from_the_pixels(photo_atoms, strength):
    lamp = Lamp.towards(np.array([0.5, 0.5, 0.7])).of_intensity(np.full(3, 0.05))
    blocks = blocks_of(photograph([0.3, 0.2, 1.0]), CIRCLE)
    sighting = Sighting(blocks, Camera(), Environment.of(environment("overcast", 64).astype(float)), [lamp])
    lit, spots = sighting.sums(photo_atoms)
    both = lit + strength * spots
    own = np.array([0, 1, 2]) + 3 * 2  # the third material of an RGB library
    seen = np.array([both[k, c] for c, k in enumerate(own)]).T
    made = replace(sighting, blocks=replace(blocks, values=seen, is_clipped=np.zeros(seen.shape, bool)))
    found = strength_of_spots(photo_atoms, [made], [(lit, spots)], 1.0)
    assert found == pytest.approx(strength, rel=0.35)


# -- where to hold the lamp -------------------------------------------------------------------------------------------


@pytest.fixture
def three_angles(monkeypatch):
    """The angles of a lamp that are tried, cut down."""
    angles = (15.0, 45.0, 130.0)
    monkeypatch.setattr(lamp_plan, "ANGLES_DEG", angles)
    return angles


def test_a_plan_says_what_one_lamp_determines_and_which_to_add(photo_atoms, three_angles):
    plan = plan_lamps(photo_atoms, 2)
    assert [one.angles_deg for one in plan.alone] == [(angle,) for angle in three_angles]
    first, second = plan.next
    assert first == min(plan.alone, key=lambda one: one.ball)
    assert second.angles_deg[:1] == first.angles_deg
    assert second.ball < first.ball
    # Light from behind says little of the colour at 45/0, light from 45 degrees most.
    by_angle = {one.angles_deg[0]: one for one in plan.alone}
    assert by_angle[45.0].colour < 0.5 * by_angle[130.0].colour


@pytest.mark.usefixtures("three_angles")
def test_lamps_are_suggested_before_and_after_the_picture(run, library, tmp_path):
    status, out, err = run("photograph", "--suggest", "1", "-L", library, cwd=tmp_path)
    assert status == 0, err
    assert "Next lamp directions" in out
    status, _, err = run("photograph", "--lamp", "flash", "-L", library, cwd=tmp_path)
    assert (status, "no picture is given" in err) == (2, True)


# -- cylinders --------------------------------------------------------------------------------------------------------

TIN = Cylinder(64.0, 50.0, 40.0, 60.0)


def photographed_tin(brdf, direction, cylinder=TIN, size=(100, 128)):
    """An upright cylinder under a far lamp, relative to a white diffuser that faces it."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    u = (x - cylinder.x) / cylinder.radius
    inside = cylinder.contains(u, (cylinder.y - y) / cylinder.radius, 1.0)
    normal = np.stack([u, 0.0 * u, np.sqrt(np.maximum(1.0 - u * u, 0.0))], axis=-1)[inside]
    across = np.stack([normal[:, 2], 0.0 * normal[:, 0], -normal[:, 0]], axis=1)
    frame = np.stack([across, np.broadcast_to([0.0, 1.0, 0.0], across.shape), normal], axis=1)
    direction = np.asarray(direction) / np.linalg.norm(direction)
    wi, wo = frame @ np.array([0.0, 0.0, 1.0]), frame @ direction
    lit = wo[:, 2] > 0.0
    values = np.zeros((len(wi), 3))
    values[lit] = np.pi * brdf.eval(wi[lit], wo[lit]) * wo[lit, 2:]
    picture = np.zeros((*size, 3), np.float32)
    picture[inside] = values
    return Photograph(Path("tin"), picture, np.zeros((*size, 3), bool))


def test_pixels_of_a_tin_are_those_of_a_cylinder():
    direction = np.array([0.4, 0.6, 0.7])
    blocks = blocks_of(photographed_tin(PAINT, direction), TIN)
    sums = block_sums(
        lambda a, b: PAINT.eval(a, b).T, *lamp_pairs(blocks, Camera(), [Lamp.towards(direction)])
    )
    made = np.array([sums[c, c] for c in range(3)]).T
    bright = blocks.values.max(axis=1) > 0.05
    np.testing.assert_allclose(made[bright], blocks.values[bright], rtol=0.12)
    assert np.mean(made - blocks.values) == pytest.approx(0.0, abs=0.003)


def test_a_nearly_flat_piece_of_a_cylinder_is_refused():
    flat = Cylinder(64.0, 50.0, 400.0, 60.0)
    with pytest.raises(UsageError, match="span 18 degrees, expected 40"):
        blocks_of(photographed_tin(PAINT, [0.2, 0.2, 1.0], flat), flat)


def test_a_tin_is_completed_and_its_options_are_checked(run, library, tmp_path):
    import OpenImageIO

    picture = photographed_tin(PAINT, [0.5, 0.5, 0.7]).values
    out = OpenImageIO.ImageOutput.create(str(tmp_path / "tin.exr"))
    out.open(str(tmp_path / "tin.exr"), OpenImageIO.ImageSpec(128, 100, 3, "float"))
    out.write_image(picture)
    out.close()
    given = ["photograph", "tin.exr", "-L", library, "-o", "tin_rgb.bsdf"]
    where = ["--cylinder", "64,50,40,60"]
    status, _, err = run(*given, *where, "--lamp", "0.5,0.5,0.7", "--exposure", "1", cwd=tmp_path)
    assert status == 0, err
    brdf = MeasuredBRDF(read_bsdf(tmp_path / "tin_rgb.bsdf"))
    wi, wo = (
        from_spherical(np.deg2rad(angle), azimuth)[None] for angle, azimuth in ((45.0, np.pi), (0.0, 0.0))
    )
    np.testing.assert_allclose(brdf.eval(wi, wo), PAINT.eval(wi, wo), rtol=0.15)
    for wrong, words in (
        (["--lamp", "found"], "known light"),
        (["--lamp", "flash", "--picture"], "found a cylinder"),
    ):
        status, _, err = run(*given, *where, *wrong, cwd=tmp_path)
        assert (status, words in " ".join(err.split())) == (2, True), err
