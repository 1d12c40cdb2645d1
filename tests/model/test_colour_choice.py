"""The colour of a predicted structure: like a material, as a spectrum, as sRGB; and what is refused."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers.small_library import small_library

from manifold.colour.conversion import encode_srgb, to_srgb
from manifold.colour.reflectances import ReflectanceSpectrum, read_reflectance, srgb_reflectance
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Bands
from manifold.io_rgl import rgl_wavelengths_nm
from manifold.library.store import Library
from manifold.model.colours import NEAREST, ColourChoice, parse_srgb
from manifold.model.manifold import Manifold
from manifold.model.settings import GplvmSettings

BANDS = Bands.from_array(rgl_wavelengths_nm())


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Manifold.fit(
        Library.open(small_library(tmp_path_factory.mktemp("colour"))),
        calibrate=False,
    )


@pytest.mark.parametrize("t", [0.2, 0.5])
def test_like_gives_the_reflectance_of_that_material(model, t):
    x = model.between("syn_felt_green", "syn_paper_white", t)
    chosen = model.choose_colour(x, ColourChoice(like="syn_felt_orange"))
    reached = model.colours.reached(x, chosen.colours)
    assert np.abs(reached - model.colours.reflectance("syn_felt_orange")).max() == pytest.approx(
        chosen.residual
    )
    assert chosen.residual < 0.02


def test_srgb_and_the_same_reflectance_give_the_same_colours(model, tmp_path):
    x = model.between("syn_felt_green", "syn_paper_white", 0.5)
    (tmp_path / "grey.csv").write_text("nm,R\n400,0.214041\n700,0.214041\n")
    by_srgb = model.choose_colour(x, ColourChoice(srgb="0.5,0.5,0.5"))
    by_file = model.choose_colour(x, ColourChoice(reflectance=tmp_path / "grey.csv"))
    np.testing.assert_allclose(by_srgb.colours, by_file.colours, atol=1e-3)


def test_a_spectrum_and_the_same_file_give_the_same_colours(model, tmp_path):
    nm, values = np.linspace(400, 700, 7), np.linspace(0.1, 0.7, 7)
    np.savetxt(tmp_path / "red.txt", np.stack([nm, values], axis=1))
    x = model.between("syn_felt_green", "syn_paper_white", 0.5)
    spectrum = ReflectanceSpectrum(nm, values, "red")
    by_spectrum = model.choose_colour(x, ColourChoice(reflectance=spectrum))
    by_file = model.choose_colour(x, ColourChoice(reflectance=tmp_path / "red.txt"))
    np.testing.assert_array_equal(by_spectrum.colours, by_file.colours)
    assert by_spectrum.words == "by red"
    assert spectrum == ReflectanceSpectrum(tuple(nm), list(values), "red")


@pytest.mark.parametrize(
    ("nm", "values", "message"),
    [
        ([400], [0.5], "at least 2"), ([400, 700], [0.5], "equal numbers"), ([700, 400], [0.1, 0.1], "increase"),
        ([400, 700], [0.1, np.nan], "expected 0 to 1"), ([400, np.inf], [0.1, 0.1], "increase"),
        ([400, 450], [0.1, 0.1], "covers 400 to 450 nm"),
    ],
)  # fmt: skip
def test_what_is_no_reflectance_spectrum_is_refused(nm, values, message):
    with pytest.raises(UsageError, match=message):
        ReflectanceSpectrum(nm, values)


def test_two_colours_are_refused():
    with pytest.raises(UsageError, match="one of them"):
        ColourChoice(like="a", srgb="#ffffff")


def test_a_gplvm_refuses_a_chosen_colour(model):
    whole = Manifold.fit(model.library, GplvmSettings(), calibrate=False)
    assert whole.choose_colour(whole.X[0], NEAREST).colours is None
    with pytest.raises(UsageError, match="cannot be given"):
        whole.choose_colour(whole.X[0], ColourChoice(like="syn_felt_green"))


@pytest.mark.parametrize(("text", "values"), [("#ff8000", [1, 128 / 255, 0]), ("1, 0.5,0", [1, 0.5, 0])])
def test_srgb_colours_are_read_both_ways(text, values):
    np.testing.assert_allclose(parse_srgb(text), values)


@pytest.mark.parametrize(
    "text", ["red", "#ff80", "1,2,3", "0.1,0.2", "nan,0,0", "", "#gg0000", "+f+f+f", " f f f"]
)
def test_what_is_no_srgb_colour_is_refused(text):
    with pytest.raises(UsageError, match="expected #rrggbb"):
        parse_srgb(text)


@pytest.mark.parametrize("display", [[0.7, 0.5, 0.2], [1, 1, 1], [0, 0, 0], [0.1, 0.2, 0.9]])
def test_the_reflectance_of_an_srgb_colour_looks_like_it(display):
    reflectance = srgb_reflectance(np.array(display, float), BANDS)
    assert reflectance.min() >= 0
    assert reflectance.max() <= 1
    np.testing.assert_allclose(encode_srgb(to_srgb(reflectance, BANDS)), display, atol=0.005)


def test_reflectance_files_are_interpolated_and_held_at_their_ends(tmp_path):
    path = tmp_path / "r.txt"
    path.write_text("# nm reflectance\n500 0.2\n600\t0.4\n400, 0.1\n")
    values = read_reflectance(path, BANDS)
    np.testing.assert_allclose(values, np.interp(BANDS.wavelengths_nm, [400, 500, 600], [0.1, 0.2, 0.4]))


def test_reflectance_files_are_read_as_spreadsheets_write_them(tmp_path):
    path = tmp_path / "r.txt"
    path.write_bytes("nm\treflectance\r\n400\t0.1\r\n700\t0.4\r\n".encode("utf-8-sig"))
    values = read_reflectance(path, BANDS)
    np.testing.assert_allclose(values, np.interp(BANDS.wavelengths_nm, [400, 700], [0.1, 0.4]))


@pytest.mark.parametrize(
    "content",
    [
        "nm;R\n400;0,1\n700;0,4\n",
        "400,0 0,1\n700,0 0,4\n",
        "400,0\t,1\r\n700,0\t0,4\r\n",
        '"400";"0,1"\n"700";"0,4"\n',
        "400, 1e-1\n700 , 4,0e-1\n",
        "nm,R,Std\n400,0.1,7\n700,0.4,7\n",
    ],
)
def test_decimal_commas_are_read_beside_other_separators(tmp_path, content):
    path = tmp_path / "r.csv"
    path.write_text(content)
    values = read_reflectance(path, BANDS)
    np.testing.assert_allclose(values, np.interp(BANDS.wavelengths_nm, [400, 700], [0.1, 0.4]))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "at least 2"),
        ("500 0.2\n", "at least 2"),
        ("500 20\n600 30\n", "divide percent"),
        ("500 0.2\n500 0.3\n", "wavelength 500 nm twice"),
        ("400 0.2\n600 0.4\n410 0.1\n610 0.2\n", "wavelengths go back from 600 to 410 nm"),
        ("0.5 0.2\n0.6 0.3\n", "covers 500 to 600 nm"),  # micrometres
        ("500 -0.2\n600 0.3\n", "expected 0 to 1"),
        ("380,0,9\n500,0,1\n780,0,1\n", "3 columns without headings"),  # columns, or a decimal comma?
        ("380,0.9\n500,0,1\n780,0.1\n", "line 2 is '500,0,1', expected a wavelength in nm and a reflectance"),
        ("380 0,5\n500 0,1\n780 0,1\n600 0,1,2\n", "line 4 is '600 0,1,2'"),
        ("380 1.234,5\n500 0,1\n780 0,1\n", "line 1 is '380 1.234,5'"),
        ("380 0.9\n500 10%\n780 0.1\n", "line 2 is '500 10%'"),
        ("380 0.9\n600 oops\n780 0.1\n", "line 2 is '600 oops'"),
        ("2000 0.9\n3000 0.1\n", "covers 2000 to 3000 nm, expected most of 400 to 700 nm"),
        ("500 0.9\n510 0.1\n", "covers 500 to 510 nm"),
    ],
)
def test_bad_reflectance_files_are_refused(tmp_path, content, message):
    path = tmp_path / "r.txt"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=message):
        read_reflectance(path, BANDS)


@pytest.mark.parametrize(
    "text", ["\ufeff380 0.9\n500 0.1\n780 0.1\n", "nm,R\n# dry\n380,0.9\n\n500,0.1\n780,0.1\n"]
)
def test_byte_order_marks_headers_and_comments_lose_no_row(tmp_path, text):
    path = tmp_path / "spectrum.csv"
    path.write_text(text, encoding="utf-8")
    assert read_reflectance(path, BANDS)[0] == 0.9


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nm,R (%)\n" + "".join(f"{nm},{0.4 if nm < 580 else 0.6}\n" for nm in range(400, 701, 10)),
         "reflectances of at most 0.6 %: if they are fractions, remove the percent sign"),
        ("".join(f"{nm} 0.3\n" for nm in range(400, 701, 10) if not 450 < nm < 600),
         "no reflectances between 450 and 600 nm, where they are interpolated"),
        ("".join(f"{nm} 0.3\n" for nm in range(400, 701, 50)), ""),
        ("400 0.1\n700 0.5\n", ""),
    ],
)  # fmt: skip
def test_doubtful_spectra_are_noted(tmp_path, text, said):
    path = tmp_path / "spectrum.txt"
    path.write_text(text)
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        read_reflectance(path, BANDS)
    assert [str(one.message) for one in shown] == [f"{path}: {said}"] * bool(said)


def test_noise_beyond_the_range_of_reflectances_is_not_called_per_cent(tmp_path):
    path = tmp_path / "white.txt"
    path.write_text("400 0.98\n700 1.01\n")
    with pytest.raises(
        FileFormatError, match=r"from 0\.98 to 1\.01, expected 0 to 1; set noise beyond them to 0 or 1"
    ):
        read_reflectance(path, BANDS)
