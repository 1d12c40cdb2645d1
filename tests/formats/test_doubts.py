"""Tables whose values or angles are probably not what they are called: what is refused, and what a note says."""

from __future__ import annotations

import re

import numpy as np
import pytest

from manifold.core.errors import FileFormatError
from manifold.estimate.coat import DoubtfulColoursWarning, read_colours
from manifold.formats import registry
from manifold.formats.readings import Assumption, Readings

PAIRS = [
    (i, o, phi)
    for i in (15, 45, 60)
    for o, phi in ((60, 0), (45, 0), (15, 0), (0, 180), (15, 180), (45, 180), (60, 180))
]
NM = range(400, 701, 20)
FORMS = {
    "commas": lambda text: text,
    "semicolons": lambda text: text.replace(",", ";").replace(".", ","),
    "tabs": lambda text: text.replace(",", "\t"),
}  # fmt: skip


@pytest.fixture(params=FORMS)
def read(request, tmp_path):
    """Write a table in one of several forms, and read it."""

    def of(text: str) -> Readings:
        (tmp_path / "table.csv").write_text(FORMS[request.param](text))
        return registry.read_readings(tmp_path / "table.csv")

    return of


def satin() -> np.ndarray:
    """Reflectance factors of a red satin at `PAIRS`, (21, 16): bright near the mirror direction."""
    near = np.array([i == o and phi == 0 for i, o, phi in PAIRS])
    return np.where(near, 4.0, 0.0)[:, None] + np.where(np.array(NM) < 580, 0.1, 0.6)


def directions(values: np.ndarray, heads: str = "", unit: str = " (deg)") -> str:
    """A table of values (21, B) at `PAIRS`, by default in bands without a unit."""
    head = f"theta_i{unit},theta_o{unit},phi_o{unit},{heads or ','.join(f'{nm}nm' for nm in NM)}"
    return "\n".join(
        [
            head,
            *(
                ",".join([*map(str, pair), *(f"{v:.6g}" for v in row)])
                for pair, row in zip(PAIRS, values, strict=True)
            ),
        ]
    )


def geometries(values: np.ndarray) -> str:
    """A table of values (6, B) at the geometries with light at 45 degrees, from 400 nm by 10 nm."""
    names = ("45as-15", "45as15", "45as25", "45as45", "45as75", "45as110")
    rows = [",".join([name, *(f"{v:g}" for v in row)]) for name, row in zip(names, values, strict=True)]
    return "\n".join([",".join(["Geometry", *(str(400 + 10 * k) for k in range(values.shape[1]))]), *rows])


def doubts(found: Readings) -> list[str]:
    """Notes that are assumptions, without that on the unit and on azimuths."""
    usual = ("no unit", "no azimuth")
    return [note for note in found.notes if isinstance(note, Assumption) and not note.startswith(usual)]


def test_a_plain_table_has_no_doubts(read):
    assert doubts(read(directions(satin() / np.pi))) == []


@pytest.mark.parametrize("white", [1000.0, 10_000.0, 65_535.0])
def test_values_too_bright_even_as_percent_are_refused(white, read):
    """Values of 0 to 10,000 were percent: an albedo of 48."""
    row = np.where(np.arange(31) < 17, 0.15, 0.5)
    for text in (geometries(np.tile(row, (6, 1)) * white), directions(satin() * white)):
        with pytest.raises(
            FileFormatError, match="even as per cent would reflect more light than they receive"
        ):
            read(text)


def test_codes_of_pictures_are_refused_or_noted(read):
    """They were percent."""
    codes = np.tile([202.0, 148.0, 90.0], (len(PAIRS), 1))
    with pytest.raises(
        FileFormatError, match=r"values of up to 202, .*; .*make codes of pictures linear first"
    ):
        read(directions(codes, "R,G,B"))
    dark = read(directions(np.round(0.3 * codes), "R,G,B"))
    assert doubts(dark) == ["whole numbers: if they are codes of a picture, make them linear first"]
    assert doubts(read(directions(0.3 * codes + 0.25, "R,G,B"))) == []


@pytest.mark.parametrize(("white", "unit"), [(1.0 / np.pi, "brdf"), (1.0, "factor")])
@pytest.mark.parametrize("saturated", [[3], [1, 3, 5]])
def test_saturated_bands_flip_no_unit(white, unit, saturated, read):
    """A mean over bands made factors percent, and two saturated bands of 16 a BRDF."""
    values = satin() * white
    values[:, saturated] = 30.0
    found = read(directions(values))
    assert found.assumed_unit == unit
    (note,) = doubts(found)
    assert note.startswith("band " + ", ".join(f"{NM[k]}nm" for k in saturated))


@pytest.mark.parametrize("saturated", [[12], [5, 12, 20, 25, 26, 30]])
def test_saturated_bands_flip_no_table_of_geometries(saturated, read):
    values = np.full((6, 31), 0.3)
    values[:, saturated] = 9.99
    found = read(geometries(values))
    assert found.assumed_unit == "factor"
    (note,) = doubts(found)
    assert note.startswith(f"band {400 + 10 * saturated[0]}")


def test_a_stated_unit_that_is_impossible_is_noted(read):
    heads = ",".join(f"BRDF {nm}nm" for nm in NM)
    (note,) = doubts(read(directions(100.0 * satin(), heads)))
    assert note.endswith(
        "times as bright as a perfect diffuser, away from the mirror direction: check the unit"
    )


def test_densities_are_noted(read):
    """They are darkest in the mirror direction, where every material of the library is brightest."""
    density = -np.log10(satin())
    (rows, note) = doubts(read(directions(density)))
    assert "negative values, which count as 0" in rows
    assert note.startswith("the mirror direction is negative, where materials are brightest")
    (note,) = doubts(read(directions(density + 1.0)))
    assert note.startswith("the mirror direction is 0.")


@pytest.mark.parametrize(("count", "is_said"), [(9, True), (3, True), (0, False)])
def test_many_negative_values_are_noted(count, is_said, read):
    values = satin() / np.pi
    values[:count] *= -1.0
    said = [note for note in doubts(read(directions(values))) if "more than noise explains" in note]
    assert bool(said) is is_said
    if count == 9:
        assert said[0].startswith("43 % of the values are negative")


def test_noise_of_a_dark_band_is_not_noted_as_densities(rng, read):
    values = satin() / np.pi
    values[:, 2] = 1e-4 * rng.standard_normal(len(values))
    assert not any("densities" in note for note in doubts(read(directions(values))))


@pytest.mark.parametrize("unit", [" (deg)", " [\u00b0]", " deg"])
def test_angles_in_radians_below_heads_of_degrees_are_noted(unit, read):
    pairs = [(0.17, 0.0, 3.14), (0.17, 0.7, 3.14), (0.7, 1.05, 0.0), (1.05, 1.05, 1.57)]
    head = f"theta_i{unit},theta_o{unit},phi_o{unit},BRDF 500nm\n"
    found = read(head + "".join(f"{i},{o},{phi},0.1\n" for i, o, phi in pairs))
    assert doubts(found) == ["all directions are within 1.05 degrees of the normal: are the angles radians?"]
    along = read(head + "0,0,0,0.1\n")
    assert doubts(along) == []


@pytest.mark.parametrize(("turn", "said"), [(1.0, "3.14"), (2.0, "6.28"), (0.04, "")])
def test_azimuths_in_radians_beside_thetas_in_degrees_are_noted(turn, said, read):
    pairs = [(45, 20, 0), (45, 20, 1.57 * turn), (45, 60, 3.14 * turn), (30, 10, 0)]
    head = "theta_i (deg),theta_o (deg),phi_o (deg),BRDF 500nm\n"
    found = read(head + "".join(f"{i},{o},{phi},0.1\n" for i, o, phi in pairs))
    expected = f"all azimuths are within {said} degrees of the plane of incidence: are they radians?"
    assert doubts(found) == [expected] * bool(said)


def test_lightness_from_0_to_1_is_noted_in_tables_and_lists(read, tmp_path):
    """It was a black paint."""
    rows = "".join(f"45as{a},{L},0.3,0.2\n" for a, L in ((15, 0.58), (25, 0.53), (110, 0.48)))
    said = "L* is at most 0.58, so black: multiply by 100 if it is a fraction"
    assert doubts(read("Geometry,L*,a*,b*\n" + rows)) == [said]
    assert doubts(read("Geometry,L*,a*,b*\n" + rows.replace("0.58", "2.1"))) == []
    path = tmp_path / "colours.txt"
    path.write_text("red,0.58,0.3,0.2\nblue,0.4,-0.1,-0.3\n")
    with pytest.warns(DoubtfulColoursWarning, match=re.escape(f"colours.txt: {said}")):
        assert len(read_colours(path, {})) == 2
    path.write_text("red,50,30,20\nblack,0.4,0,0\n")
    assert len(read_colours(path, {})) == 2
