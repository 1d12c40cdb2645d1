"""Pictures as files hold them: what is read is right, and what is not is refused by name."""

from __future__ import annotations

import io
import struct
import sys
import zlib

import colour
import numpy as np
import OpenImageIO
import pytest
import tifffile
from PIL import Image, ImageCms

from manifold.colour.conversion import SRGB_TO_XYZ, decode_srgb, encode_srgb
from manifold.colour.picture_files import read_picture
from manifold.core.errors import FileFormatError, MissingPackageError


@pytest.fixture
def codes(rng):
    return rng.integers(10, 250, (24, 32, 3), dtype=np.uint8)


def write_exr(path, values, channels=("R", "G", "B"), **attributes):
    spec = OpenImageIO.ImageSpec(values.shape[1], values.shape[0], values.shape[2], "float")
    spec.channelnames = channels
    for name, value in attributes.items():
        spec.attribute(name, "float[8]", value)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(values)
    output.close()


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def with_chunk(codes, kind, data):
    """A PNG with one more chunk behind its header."""
    stream = io.BytesIO()
    Image.fromarray(codes).save(stream, "PNG")
    return stream.getvalue()[:33] + chunk(kind, data) + stream.getvalue()[33:]


@pytest.mark.parametrize("ending", ["png", "tif"])
def test_sixteen_bits_of_grey_are_read_in_sixteen_bits(tmp_path, rng, ending):
    grey = rng.integers(0, 65535, (24, 32), dtype=np.uint16)
    path = tmp_path / f"grey.{ending}"
    if ending == "png":
        Image.fromarray(grey).save(path)
    else:
        tifffile.imwrite(path, grey)
    read = read_picture(path)
    np.testing.assert_allclose(read.values, np.repeat(grey[..., None] / 65535.0, 3, 2), atol=1e-6)
    assert read.is_grey
    if ending == "png":  # which names no colour space, as pictures of photometric stereo
        assert "read as linear" in read.notes[0]


def test_phones_pictures_are_refused_with_the_command_that_converts_them(tmp_path):
    path = tmp_path / "IMG_1.heic"
    path.write_bytes(b"\0\0\0\x18ftypheic" + bytes(64))
    with pytest.raises(FileFormatError, match=r"magick IMG_1\.heic IMG_1\.png"):
        read_picture(path)


def write_dng(path, rgb, white=4095):
    """A camera's raw file whose filters are the primaries of sRGB."""
    codes = np.minimum(np.rint(rgb * white), white).astype(np.uint16)
    filtered = np.empty(rgb.shape[:2], np.uint16)
    for i, j, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        filtered[i::2, j::2] = codes[i::2, j::2, channel]
    matrix = np.rint(1e4 * np.linalg.inv(SRGB_TO_XYZ)).astype(int)
    ratios = [int(v) for value in matrix.ravel() for v in (value, 10_000)]
    tags = [
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([0, 1, 1, 2]), True),
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),
        (50708, "s", 0, "Test", True), (50714, "H", 1, 0, True), (50717, "I", 1, white, True),
        (50721, "2i", 9, ratios, True), (50728, "2I", 3, (1, 1) * 3, True), (50778, "H", 1, 21, True),
        (271, "s", 0, "Test", True), (272, "s", 0, "Test", True),
    ]  # fmt: skip
    tifffile.imwrite(path, filtered, photometric=32803, extratags=tags)


def test_only_clipped_channels_are_marked_unless_colours_are_converted(tmp_path, codes):
    codes[3:6, 3:6, 0] = 255
    Image.fromarray(codes).save(tmp_path / "srgb.png")
    read = read_picture(tmp_path / "srgb.png")
    assert np.count_nonzero(read.is_clipped, axis=(0, 1)).tolist() == [9, 0, 0]
    (tmp_path / "p3.png").write_bytes(with_chunk(codes, b"cICP", bytes([12, 13, 0, 1])))
    read = read_picture(tmp_path / "p3.png")  # whose green and blue in sRGB depend on the clipped red
    assert np.count_nonzero(read.is_clipped, axis=(0, 1)).tolist() == [9, 9, 9]


def test_plateaus_belong_to_their_channel(tmp_path):
    y, x = np.mgrid[:128, :128] - 64.0
    spot = np.exp(-(x**2 + y**2) / 800.0)
    values = np.stack([np.minimum(spot, 0.5), 0.3 * spot, np.minimum(spot, 0.5)], axis=2)
    tifffile.imwrite(tmp_path / "spot.tif", np.rint(16383 * values).astype(np.uint16), photometric="rgb")
    red, green, blue = np.moveaxis(read_picture(tmp_path / "spot.tif", finds_plateaus=True).is_clipped, 2, 0)
    assert red.sum() > 0.9 * np.count_nonzero(spot > 0.5)
    assert not green.any()
    np.testing.assert_array_equal(red, blue)


def test_raw_files_are_developed_without_curves(tmp_path):
    y, x = np.mgrid[:64, :96] / 96.0
    rgb = np.stack([0.2 + 0.5 * x, np.full_like(x, 0.3), 0.1 + 0.6 * y], axis=2)
    rgb[:8, :8] = 1.5
    write_dng(tmp_path / "ball.dng", rgb)
    read = read_picture(tmp_path / "ball.dng")
    np.testing.assert_allclose(read.values[12:-4, 12:-4], rgb[12:-4, 12:-4], atol=2e-3)
    assert read.is_clipped[:6, :6].all()
    assert not read.is_clipped[12:, 12:].any()
    (tmp_path / "broken.dng").write_bytes((tmp_path / "ball.dng").read_bytes()[:300])
    with pytest.raises(FileFormatError, match="not a readable picture"):
        read_picture(tmp_path / "broken.dng")


def test_raw_files_name_what_reads_them_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    (tmp_path / "ball.nef").write_bytes(b"II*\0")
    with pytest.raises(MissingPackageError, match=r"brdf-manifold\[photographs\]"):
        read_picture(tmp_path / "ball.nef")


def test_sixteen_bits_of_colour_are_read_in_sixteen_bits(tmp_path, rng):
    values = rng.integers(0, 65535, (24, 32, 3), dtype=np.uint16)
    write = OpenImageIO.ImageOutput.create("a.png")
    assert write.open(str(tmp_path / "a.png"), OpenImageIO.ImageSpec(32, 24, 3, "uint16"))
    assert write.write_image(values)
    write.close()
    np.testing.assert_allclose(
        read_picture(tmp_path / "a.png").values, decode_srgb(values / 65535.0), atol=1e-6
    )


def test_all_eight_orientations_are_set_upright(tmp_path, codes):
    """Row 0 and column 0 of the file are, in turn: top left, top right, bottom right, bottom left, left top, right
    top, right bottom, left bottom (TIFF 6.0, Orientation)."""
    stored = {
        1: codes, 2: codes[:, ::-1], 3: codes[::-1, ::-1], 4: codes[::-1], 5: codes.swapaxes(0, 1),
        6: np.rot90(codes), 7: codes[::-1, ::-1].swapaxes(0, 1), 8: np.rot90(codes, -1),
    }  # fmt: skip
    for orientation, pixels in stored.items():
        tifffile.imwrite(
            tmp_path / "a.tif", pixels, photometric="rgb", extratags=[(274, "H", 1, orientation, True)]
        )
        read = read_picture(tmp_path / "a.tif", is_linear=True)
        np.testing.assert_allclose(read.values, codes / 255.0, atol=1e-6)


def test_depth_is_neither_colour_nor_opacity(tmp_path, rng):
    values = rng.random((24, 32, 4)).astype(np.float32) + 3.0
    write_exr(tmp_path / "a.exr", values, ("R", "G", "B", "Z"))
    read = read_picture(tmp_path / "a.exr")
    np.testing.assert_array_equal(read.values, values[..., :3])
    assert read.is_opaque.all()


def test_a_profile_decides_what_a_file_is_encoded_in(tmp_path, codes):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for name in ("a.png", "a.tif"):
        Image.fromarray(codes).save(tmp_path / name, icc_profile=srgb)
        read = read_picture(tmp_path / name)
        np.testing.assert_allclose(read.values, decode_srgb(codes / 255.0), atol=1e-6)
        assert read.is_encoded
    for gamma in (1.0, 3.0):
        Image.fromarray(codes).save(tmp_path / "b.png", icc_profile=with_curve(srgb, gamma))
        read = read_picture(tmp_path / "b.png")
        np.testing.assert_allclose(read.values, (codes / 255.0) ** gamma, atol=1e-4)
        assert read.is_encoded == (gamma != 1.0)


def with_curve(profile, gamma):
    """A profile of sRGB with another tone curve, a parametric one, which its three channels share."""
    start = profile.index(b"para")
    curve = b"para" + bytes(4) + struct.pack(">HHi", 0, 0, round(gamma * 65536))
    return profile[:start] + curve + profile[start + len(curve) :]


def with_primaries(profile, space):
    """A profile with the primaries of a space of colour-science, adapted to D50."""
    source, white = colour.RGB_COLOURSPACES[space], np.array([0.9642, 1.0, 0.8249])
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        source.matrix_RGB_to_XYZ.sum(axis=1), white, "Bradford"
    )
    for name, xyz in zip((b"rXYZ", b"gXYZ", b"bXYZ"), (adapt @ source.matrix_RGB_to_XYZ).T, strict=True):
        entry = profile.index(name)
        (start,) = struct.unpack(">I", profile[entry + 4 : entry + 8])
        numbers = struct.pack(">3i", *(round(v * 65536) for v in xyz))
        profile = profile[: start + 8] + numbers + profile[start + 20 :]
    return profile


P3, ADOBE = "Display P3", "Adobe RGB (1998)"


def converted(linear, space):
    """Linear values of a space in linear sRGB, by colour-science."""
    return np.maximum(linear @ colour.matrix_RGB_to_RGB(space, "sRGB", "Bradford").T, 0.0)


@pytest.mark.parametrize("space", [P3, ADOBE])
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WebP"])
def test_profiles_of_other_primaries_are_converted(tmp_path, codes, space, kind):
    profile = with_primaries(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(), space)
    flat = np.repeat(np.repeat(codes[:3, :4], 16, axis=0), 16, axis=1)  # which JPEG keeps
    options = {"JPEG": {"quality": 100, "subsampling": 0}, "WebP": {"lossless": True}}.get(kind, {})
    Image.fromarray(flat).save(tmp_path / "a", kind, icc_profile=profile, **options)
    read = read_picture(tmp_path / "a")
    # Profiles round primaries to 2e-5; codes of JPEG are off by one.
    tolerance = 0.02 if kind == "JPEG" else 5e-4
    np.testing.assert_allclose(read.values, converted(decode_srgb(flat / 255.0), space), atol=tolerance)
    seen = ImageCms.profileToProfile(
        Image.fromarray(flat),
        ImageCms.ImageCmsProfile(io.BytesIO(profile)),
        ImageCms.createProfile("sRGB"),
        1,
    )
    inside = ((read.values > 0.0) & (read.values < 1.0)).all(axis=2)
    assert inside.sum() > 500
    np.testing.assert_allclose(  # LittleCMS rounds to 8 bits
        encode_srgb(read.values)[inside], np.asarray(seen)[inside] / 255.0, atol=0.02
    )


def test_colours_outside_srgb_are_noted(tmp_path):
    for green, share in ((255, "100 %"), (120, None)):
        codes = np.full((24, 32, 3), (100, green, 100), np.uint8)
        (tmp_path / "a.png").write_bytes(with_chunk(codes, b"cICP", bytes([12, 13, 0, 1])))
        read = read_picture(tmp_path / "a.png")
        assert read.values.min() >= 0.0
        assert any("outside sRGB" in note for note in read.notes) == (share is not None)
        assert share is None or share in read.notes[1]


def test_sixteen_bits_with_a_profile_keep_their_precision(tmp_path, rng):
    profile = with_primaries(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(), P3)
    codes = rng.integers(0, 65535, (24, 32, 3), dtype=np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric="rgb", iccprofile=profile)
    expected = converted(decode_srgb(codes / 65535.0), P3)
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif").values, expected, atol=3e-4)


@pytest.mark.parametrize(
    ("curve", "linear"),
    [
        (b"curv" + bytes(4) + struct.pack(">I", 0), lambda v: v),
        (b"curv" + bytes(4) + struct.pack(">IH", 1, 563), lambda v: v ** (563 / 256)),
        (
            b"curv" + bytes(4) + struct.pack(">I3H", 3, 0, 16384, 65535),
            lambda v: np.interp(v, [0, 0.5, 1], [0, 0.25, 1]),
        ),
        (b"para" + bytes(4) + struct.pack(">HH3i", 1, 0, 131072, 65536, -6554), lambda v: np.maximum(v - 0.1, 0) ** 2),
        (b"para" + bytes(4) + struct.pack(">HH4i", 2, 0, 131072, 58982, 0, 6554), lambda v: (0.9 * v) ** 2 + 0.1),
    ],
)  # fmt: skip
def test_every_form_of_tone_curve_is_read(tmp_path, codes, curve, linear):
    header = b"\0" * 12 + b"scnrGRAYXYZ " + b"\0" * 12 + b"acsp" + b"\0" * 88
    profile = header + struct.pack(">I4sII", 1, b"kTRC", 144, len(curve)) + curve
    Image.fromarray(codes[..., 0]).save(tmp_path / "a.tif", icc_profile=profile)
    grey = linear(codes[..., :1] / 255.0)
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif").values, np.repeat(grey, 3, 2), atol=1e-4)


@pytest.mark.parametrize(
    "chunks",
    [
        [(b"cICP", bytes([12, 13, 0, 1]))],
        [(b"cHRM", struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000))],
        [
            (b"cHRM", struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000)),
            (b"gAMA", struct.pack(">I", 45455)),
        ],
        [(b"sRGB", b"\0"), (b"cICP", bytes([12, 13, 0, 1]))],  # the latter prevails
    ],
)
def test_chunks_of_display_p3_are_converted(tmp_path, codes, chunks):
    content = with_chunk(codes, *chunks[-1])
    for kind, data in chunks[:-1]:
        content = content[:33] + chunk(kind, data) + content[33:]
    (tmp_path / "a.png").write_bytes(content)
    read = read_picture(tmp_path / "a.png")
    np.testing.assert_allclose(read.values, converted(decode_srgb(codes / 255.0), P3), atol=5e-4)
    assert "read as Display P3" in read.notes[0]
    linear = read_picture(tmp_path / "a.png", is_linear=True)
    np.testing.assert_allclose(linear.values, converted(codes / 255.0, P3), atol=5e-4)


@pytest.mark.parametrize(
    ("cicp", "space", "decode"),
    [
        ((9, 1, 0, 1), "ITU-R BT.2020", lambda v: colour.models.oetf_inverse_BT709(v)),
        ((1, 8, 0, 1), "sRGB", lambda v: v),
        ((1, 4, 0, 1), "sRGB", lambda v: v**2.2),
        ((2, 2, 0, 1), "sRGB", decode_srgb),  # unspecified
    ],
)
def test_other_codes_of_cicp_are_read(tmp_path, codes, cicp, space, decode):
    (tmp_path / "a.png").write_bytes(with_chunk(codes, b"cICP", bytes(cicp)))
    expected = converted(decode(codes / 255.0), space)
    np.testing.assert_allclose(read_picture(tmp_path / "a.png").values, expected, atol=1e-3)


@pytest.mark.parametrize(
    ("space", "index", "is_adobe"), [(1, "R98", False), (2, None, True), (65535, "R03", True), (65535, None, False)]
)  # fmt: skip
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WebP"])
def test_exif_says_adobe_rgb(tmp_path, codes, kind, space, index, is_adobe):
    exif = Image.Exif()
    exif[0x0112] = 1
    exif.get_ifd(0x8769)[0xA001] = space
    if index is not None:
        exif.get_ifd(0x8769)[0xA005] = {1: index}
    flat = np.repeat(np.repeat(codes[:3, :4], 16, axis=0), 16, axis=1)
    options = {"JPEG": {"quality": 100, "subsampling": 0}, "WebP": {"lossless": True}}.get(kind, {})
    Image.fromarray(flat).save(tmp_path / "a", kind, exif=exif, **options)
    read = read_picture(tmp_path / "a")
    v = flat / 255.0
    expected = converted(v ** (563 / 256), ADOBE) if is_adobe else decode_srgb(v)
    np.testing.assert_allclose(read.values, expected, atol=0.02 if kind == "JPEG" else 5e-4)
    assert read.is_guessed == (space == 65535 and not is_adobe)


def test_exif_of_tiff_says_adobe_rgb(tmp_path, codes):
    spec = OpenImageIO.ImageSpec(32, 24, 3, "uint8")
    spec.attribute("Exif:ColorSpace", 2)
    output = OpenImageIO.ImageOutput.create(str(tmp_path / "a.tif"))
    assert output.open(str(tmp_path / "a.tif"), spec)
    assert output.write_image(codes)
    output.close()
    expected = converted((codes / 255.0) ** (563 / 256), ADOBE)
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif").values, expected, atol=5e-4)


def test_primaries_of_tiff_and_exr_are_converted(tmp_path, codes):
    ratios = [n for v in (0.68, 0.32, 0.265, 0.69, 0.15, 0.06) for n in (round(1e4 * v), 10_000)]
    tags = [(318, "2I", 2, (3127, 10_000, 3290, 10_000), True), (319, "2I", 6, tuple(ratios), True)]
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric="rgb", extratags=tags)
    expected = converted(codes / 255.0, P3)
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif", True).values, expected, atol=5e-4)
    values = (codes / 255.0).astype(np.float32)
    write_exr(tmp_path / "a.exr", values, chromaticities=(0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329))
    read = read_picture(tmp_path / "a.exr")
    np.testing.assert_allclose(read.values, expected, atol=5e-4)
    assert not any("read as" in note for note in read.notes)


@pytest.mark.parametrize(("bits", "is_encoded"), [(8, True), (16, False)])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_bits_decide_where_a_file_does_not_say_and_options_in_both_directions(
    tmp_path, codes, suffix, bits, is_encoded
):
    path, stored = tmp_path / f"a.{suffix}", codes[..., 0].astype(f"uint{bits}") * (257 if bits == 16 else 1)
    if suffix == "png":
        Image.fromarray(stored).save(path)
    else:
        tifffile.imwrite(path, stored)
    v = np.repeat(codes[..., :1] / 255.0, 3, 2)
    read = read_picture(path)
    np.testing.assert_allclose(read.values, decode_srgb(v) if is_encoded else v, atol=1e-6)
    assert (read.is_guessed, read.is_encoded) == (True, is_encoded)
    (note,) = read.notes
    assert ("states no encoding, add --linear" in note) == is_encoded
    assert ("read as linear; the file states no encoding, add --encoded" in note) != is_encoded
    for is_linear, expected in ((True, v), (False, decode_srgb(v))):
        given = read_picture(path, is_linear)
        np.testing.assert_allclose(given.values, expected, atol=1e-6)
        assert given.is_certain
        assert not any("states no encoding" in note for note in given.notes)


def test_formats_that_are_linear_are_not_decoded(tmp_path, codes):
    values = (codes / 255.0).astype(np.float32)
    write_exr(tmp_path / "a.exr", values)
    read = read_picture(tmp_path / "a.exr", is_linear=False)
    np.testing.assert_array_equal(read.values, values)
    assert "linear by its format" in read.notes[0]


def test_a_png_of_gamma_1_is_linear(tmp_path, codes):
    (tmp_path / "a.png").write_bytes(with_chunk(codes, b"gAMA", struct.pack(">I", 100000)))
    np.testing.assert_allclose(read_picture(tmp_path / "a.png").values, codes / 255.0, atol=1e-6)


def test_exposures_of_radiance_files_are_divided_out(tmp_path):
    pixels = bytes([128, 64, 32, 129]) * 64
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.0\n\n-Y 8 +X 8\n"
    (tmp_path / "a.hdr").write_bytes(header + pixels)
    np.testing.assert_allclose(read_picture(tmp_path / "a.hdr").values[0, 0], [0.5, 0.25, 0.125])


def pages(path, codes, **options):
    """A thumbnail, and the picture."""
    with tifffile.TiffWriter(path) as stream:
        stream.write(codes[::4, ::4], photometric="rgb", **options)
        stream.write(codes, photometric="rgb")


@pytest.mark.parametrize(
    ("words", "write"),
    [
        ("white is 0", lambda p, c: tifffile.imwrite(p, c[..., 0], photometric="miniswhite")),
        (r"CMYK \(5\)", lambda p, c: tifffile.imwrite(p, np.dstack([c, c[..., :1]]), photometric="separated")),
        (r"found CMYK,", lambda p, c: Image.fromarray(c).convert("CMYK").save(p, "JPEG")),
        ("YCbCr", lambda p, c: tifffile.imwrite(p, c, photometric="ycbcr")),
        ("CIELAB", lambda p, c: tifffile.imwrite(p, c, photometric="cielab")),
        ("palette", lambda p, c: Image.fromarray(c).quantize(8).save(p, "TIFF")),
        ("a thumbnail of 8 x 6", lambda p, c: pages(p, c, subfiletype=1, subifds=1)),
        ("several pictures", lambda p, c: pages(p, c)),
        ("channels X, Y, Z", lambda p, c: write_exr(p.with_suffix(".exr"), c / np.float32(255), ("X", "Y", "Z"))),
        (
            "primaries",
            lambda p, c: write_exr(
                p.with_suffix(".exr"), c / np.float32(255),
                chromaticities=(0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3127, 0.329),
            ),
        ),
        (r"cICP \(9, 16, 0, 1\)", lambda p, c: p.write_bytes(with_chunk(c, b"cICP", bytes([9, 16, 0, 1])))),
        ("begins with b'%!PS", lambda p, c: p.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n")),
        ("not a readable picture", lambda p, c: p.write_bytes(b"PF\n65536 65536\n-1.0\n" + bytes(99))),
        ("not a readable picture", lambda p, c: p.write_bytes(b"PF\n-5 5\n-1.0\n" + bytes(99))),
    ],
)  # fmt: skip
def test_kinds_that_are_not_read_are_refused_by_name(tmp_path, codes, words, write):
    write(tmp_path / "a.tif", codes)
    (path,) = tmp_path.iterdir()
    with pytest.raises(FileFormatError, match=words):
        read_picture(path)


def tagged(values, data):
    """A little-endian TIFF of one directory; tags are (type, values) by number, the data lies behind it."""
    size, body, tail = 8 + 2 + 12 * len(values) + 4, b"", b""
    for number, (kind, numbers) in sorted(values.items()):
        packed = struct.pack("<" + {3: "H", 4: "I"}[kind] * len(numbers), *numbers)
        if len(packed) > 4:
            packed, tail = struct.pack("<I", size + len(tail)), tail + packed
        body += struct.pack("<HHI", number, kind, len(numbers)) + packed.ljust(4, b"\0")
    place = size + len(tail)
    body = body.replace(struct.pack("<I", 0xDA7A), struct.pack("<I", place))
    return b"II*\0" + struct.pack("<IH", 8, len(values)) + body + bytes(4) + tail + data


@pytest.mark.parametrize(("width", "tile", "bits"), [(64, 16384, 8), (30000, 64, 8), (9000, 64, 64)])
def test_sizes_are_checked_before_anything_is_decoded(tmp_path, width, tile, bits):
    data = bytes(4_000_000)  # smaller files that claim so much are no pictures to OpenImageIO
    sample_format = 3 if bits == 64 else 1
    tags = {
        256: (4, [width]), 257: (4, [width]), 258: (3, [bits] * 3), 259: (3, [8]), 262: (3, [2]), 277: (3, [3]),
        322: (4, [tile]), 323: (4, [tile]), 324: (4, [0xDA7A]), 325: (4, [len(data)]), 339: (3, [sample_format] * 3),
    }  # fmt: skip
    (tmp_path / "a.tif").write_bytes(tagged(tags, data))
    with pytest.raises(FileFormatError, match=f"found {width} x {width} pixels"):
        read_picture(tmp_path / "a.tif")


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "BMP"])
def test_a_file_that_ends_early_is_refused(tmp_path, codes, kind):
    Image.fromarray(codes).save(tmp_path / "a", kind)
    content = (tmp_path / "a").read_bytes()
    (tmp_path / "a").write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(FileFormatError, match="not a readable picture"):
        read_picture(tmp_path / "a")


def test_a_damaged_name_in_a_header_is_refused(tmp_path, codes):
    write_exr(tmp_path / "a.exr", codes / np.float32(255))
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(content.replace(b"chlist", b"ch\xffist", 1))
    with pytest.raises(FileFormatError, match="a damaged header"):
        read_picture(tmp_path / "a.exr")
