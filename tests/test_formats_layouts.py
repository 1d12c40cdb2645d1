"""Layouts of a spectrophotometer's table: a row per sample, per value, a sheet per geometry or sample; other names."""

from __future__ import annotations

import numpy as np
import openpyxl
import pytest
from instrument_files import smooth

from manifold.brdf.synthetic.instruments import MA_T12_BANDS, ma_t12_readings
from manifold.errors import FileFormatError, UsageError
from manifold.formats import registry
from manifold.formats.geometry_names import parse_aspecular, parse_geometry
from manifold.formats.readings import MA_T12_NAMES, aspecular_pair
from manifold.workflows.instrument_inspection import inspect_instrument_file

SPECTRO = ma_t12_readings(smooth(MA_T12_BANDS), "smooth")
FACTORS = np.pi * SPECTRO.values
NM = [f"{w:g}" for w in MA_T12_BANDS.wavelengths_nm]
SAMPLES = {"red": 1.0, "green": 0.5}
BOTH = [(g, w) for g in MA_T12_NAMES for w in NM]


def values(scale):
    return [f"{scale * v:.7f}" for v in FACTORS.ravel()]


def wide(head="{g} {w}", rows=SAMPLES, first="Sample"):
    heads = [first, *(head.format(g=g, w=w) for g, w in BOTH)]
    return [heads, *([name, *values(scale)] for name, scale in rows.items())]


def two_headers(repeats=False, geometry_first=True, geometry=str):
    geometries = ["", *(geometry(g) if repeats or w == NM[0] else "" for g, w in BOTH)]
    wavelengths = ["Sample", *(w for _, w in BOTH)]
    heads = [geometries, wavelengths] if geometry_first else [wavelengths, geometries]
    return [*heads, *([name, *values(scale)] for name, scale in SAMPLES.items())]


def long_rows(head="Geometry"):
    rows = [
        [name, g, w, value]
        for name, scale in SAMPLES.items()
        for (g, w), value in zip(BOTH, values(scale), strict=True)
    ]
    return [["Sample", head, "Wavelength (nm)", "Reflectance"], *rows]


def turned(rows):
    return [list(column) for column in zip(*rows, strict=True)]


def of_geometries(title, header=None, is_upright=False):
    """A table per geometry, below each other: what stands above, and its header if not the wavelengths'."""
    blocks = []
    for k, g in enumerate(MA_T12_NAMES):
        heads = [[header or "Sample", *NM]] if header is not False or k == 0 else []
        if header == "corner":
            heads = [[g, *NM]]
        rows = [[name, *(f"{scale * v:.7f}" for v in FACTORS[k])] for name, scale in SAMPLES.items()]
        block = [*heads, *rows]
        blocks += [*title(g), *(turned(block) if is_upright else block), []]
    return blocks


def of_samples(title, header="Geometry"):
    """A table per sample, below each other."""
    blocks = []
    for name, scale in SAMPLES.items():
        rows = [[g, *(f"{scale * v:.7f}" for v in row)] for g, row in zip(MA_T12_NAMES, FACTORS, strict=True)]
        blocks += [*title(name), [header, *NM], *rows, []]
    return blocks


def samples_above(repeats, label="R"):
    """One row of values under samples, geometries and wavelengths."""
    names = [name if repeats or k == 0 else "" for name in SAMPLES for k in range(len(BOTH))]
    geometries = [g if repeats or w == NM[0] else "" for _ in SAMPLES for g, w in BOTH]
    wavelengths = [w for _ in SAMPLES for _, w in BOTH]
    row = [v for scale in SAMPLES.values() for v in values(scale)]
    return [["", *names], ["", *geometries], ["nm", *wavelengths], [label, *row]]


LAYOUTS = {
    "samples above geometries and wavelengths": samples_above(True),
    "samples above, cells merged": samples_above(False),
    "samples above, turned": turned(samples_above(True)),
    "a table per geometry": of_geometries(lambda g: [[g]]),
    "a table per geometry, empty cells behind": of_geometries(lambda g: [[g, "", "", ""]]),
    "a table per geometry, the word before": of_geometries(lambda g: [["Geometry", g]]),
    "a table per geometry, the word in the cell": of_geometries(lambda g: [[f"Geometry: {g}"]]),
    "a table per geometry, in the corner": of_geometries(lambda g: [], "corner"),
    "a table per geometry, one header": of_geometries(lambda g: [[g]], False),
    "a table per geometry, wavelengths below each other": of_geometries(lambda g: [[g]], is_upright=True),
    "a table per sample": of_samples(lambda name: [[name]]),
    "a table per sample, the word before": of_samples(lambda name: [["Sample", name], []]),
    "a unit between two header rows": [
        two_headers(repeats=True)[0],
        ["", *["R"] * len(BOTH)],
        *two_headers(repeats=True)[1:],
    ],
    "45as-15 400": wide(),
    "45as-15_400nm": wide("{g}_{w}nm"),
    "R(45as-15, 400 nm)": wide("R({g} {w} nm)"),
    "400 nm 45as-15": wide("{w} nm 45as-15".replace("45as-15", "{g}")),
    "400nm (45as-15)": wide("{w}nm ({g})"),
    "names without a head": wide(first=""),
    "turned": turned(wide()),
    "two header rows": two_headers(),
    "geometries repeated": two_headers(repeats=True),
    "wavelengths above": two_headers(repeats=True, geometry_first=False),
    "two header columns": turned(two_headers()),
    "title above": [["Reflectance"] + [""] * len(BOTH), *two_headers()],
    "a row per value": long_rows(),
    "angle, a row per value": long_rows("Angle"),
}


def write_csv(path, rows, separator=","):
    path.write_text("\n".join(separator.join(row) for row in rows))


@pytest.mark.parametrize("name", LAYOUTS)
def test_samples_in_every_layout_are_those_of_a_row_per_geometry(name, tmp_path):
    path = tmp_path / "paints.csv"
    write_csv(path, LAYOUTS[name], ";")
    found = registry.read_all(path)
    assert [one.name for one in found] == list(SAMPLES)
    for one, scale in zip(found, SAMPLES.values(), strict=True):
        np.testing.assert_allclose(one.values, scale * SPECTRO.values, rtol=1e-4, atol=1e-7)
        np.testing.assert_allclose(one.wo, SPECTRO.wo, atol=1e-12)
        assert one.bands == MA_T12_BANDS
    with pytest.raises(UsageError, match=r"2 samples .red, green.; name one with --sample"):
        registry.read_readings(path)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            of_samples(lambda name: []),
            "row 1: 2 tables below each other, expected the name of a sample above each",
        ),
        (
            [
                ["red"],
                ["Geometry", *NM],
                ["45as15", *values(1.0)[: len(NM)]],
                ["green"],
                ["Geometry", *NM[1:]],
            ],
            "row 5: a second table with other columns than in row 2, expected the same; put each into a file",
        ),
    ],
)
def test_tables_below_each_other_that_cannot_be_told_apart_are_refused(rows, words, tmp_path):
    write_csv(tmp_path / "a.csv", rows)
    with pytest.raises(FileFormatError, match=words):
        registry.read_all(tmp_path / "a.csv")


def test_what_is_wrong_in_the_second_of_several_tables_is_named_where_it_stands(tmp_path):
    rows = of_samples(lambda name: [[name]])
    rows[17][3] = "oops"
    write_csv(tmp_path / "a.csv", rows)
    with pytest.raises(FileFormatError, match="row 18, column 4: found 'oops'"):
        registry.read_all(tmp_path / "a.csv")


def test_a_list_of_geometries_above_a_table_is_a_title(tmp_path):
    rows = [
        ["45as15"],
        ["45as25"],
        ["Geometry", "400", "500", "600"],
        ["45as15", "1", "1", "1"],
        ["45as25", "2", "2", "2"],
    ]
    write_csv(tmp_path / "a.csv", rows)
    found = registry.read_readings(tmp_path / "a.csv")
    np.testing.assert_allclose(np.pi * found.values[:, 0], [1, 2])


def test_percent_in_heads_of_both_is_believed(tmp_path):
    write_csv(
        tmp_path / "a.csv",
        [["45as15 400 nm [%]", "45as15 500 nm [%]", "45as25 400 nm [%]"], ["1", "2", "1.5"]],
    )
    found = registry.read_readings(tmp_path / "a.csv")
    np.testing.assert_allclose(100 * np.pi * found.values, [[1, 2], [1.5, np.nan]])
    assert (found.name, found.wavelengths_nm.tolist()) == ("a", [400, 500])


def test_rows_without_names_are_numbered_samples(tmp_path):
    write_csv(tmp_path / "a.csv", [wide()[0][1:], values(1.0), values(0.5)])
    assert [one.name for one in registry.read_all(tmp_path / "a.csv")] == ["1", "2"]


def test_samples_of_columns_without_heads_are_not_averaged(tmp_path):
    """Sample, geometry and values below each other: `turned` tables of several samples have no head for the names."""
    rows = [["", "red", "", "green", ""], ["nm", "45as15", "45as45", "45as15", "45as45"]]
    write_csv(tmp_path / "a.csv", [*rows, *([w, "0.1", "0.2", "0.3", "0.4"] for w in NM)])
    red, green = registry.read_all(tmp_path / "a.csv")
    np.testing.assert_allclose(np.pi * red.values[:, 0], [0.1, 0.2])
    np.testing.assert_allclose(np.pi * green.values[:, 0], [0.3, 0.4])


def workbook(path, sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append([float(cell) if cell.replace(".", "").isdigit() else cell or None for cell in row])
    book.save(path)


def of_geometry(k, as_columns=False):
    rows = [
        ["Name", *NM],
        *([name, *(f"{scale * v:.7f}" for v in FACTORS[k])] for name, scale in SAMPLES.items()),
    ]
    return turned(rows) if as_columns else rows


@pytest.mark.parametrize("as_columns", [False, True])
def test_sheets_called_like_geometries_hold_one_each(as_columns, tmp_path):
    path = tmp_path / "paints.xlsx"
    sheets = {g: of_geometry(k, as_columns) for k, g in enumerate(MA_T12_NAMES)}
    workbook(path, {"Info": [["made by", "hand"]], **sheets})
    for one, scale in zip(registry.read_all(path), SAMPLES.values(), strict=True):
        np.testing.assert_allclose(one.values, scale * SPECTRO.values, rtol=1e-4, atol=1e-7)
        np.testing.assert_allclose(one.wo, SPECTRO.wo, atol=1e-12)
    sheets["45as15"][1][2] = "dark"
    workbook(path, sheets)
    with pytest.raises(FileFormatError, match=r"sheet '45as15', row .*found 'dark'"):
        registry.read_all(path)


def test_a_sheet_of_two_columns_per_aspecular_angle_is_one_sample(tmp_path):
    angles = ("-15", "15", "25", "45", "75", "110")
    sheets = {
        angle: [["nm", "R"], *([w, f"{v:.7f}"] for w, v in zip(NM, FACTORS[k], strict=True))]
        for k, angle in enumerate(angles)
    }
    workbook(tmp_path / "blue.xlsx", sheets)
    found = registry.read_readings(tmp_path / "blue.xlsx")
    assert found.name == "blue"
    np.testing.assert_allclose(found.values, SPECTRO.values[:6], rtol=1e-4, atol=1e-7)
    assert any("45 degrees" in note for note in found.notes)


def test_all_sheets_are_read_and_name_their_samples(tmp_path):
    """The second sheet of a workbook was ignored."""
    table = [
        ["Geometry", *NM],
        *([g, *(f"{v:.7f}" for v in row)] for g, row in zip(MA_T12_NAMES, FACTORS, strict=True)),
    ]
    named = [["Name", *table[0]], *(["paint", *row] for row in table[1:])]
    workbook(tmp_path / "a.xlsx", {"red": table, "green": table, "notes": [["none"]]})
    assert [one.name for one in registry.read_all(tmp_path / "a.xlsx")] == ["red", "green"]
    workbook(tmp_path / "b.xlsx", {"Monday": named, "Friday": named})
    assert [one.name for one in registry.read_all(tmp_path / "b.xlsx")] == ["Monday: paint", "Friday: paint"]
    broken = [*named[:3], ["paint", "45as25", "dark", *named[3][3:]]]
    workbook(tmp_path / "c.xlsx", {"Monday": named, "Friday": broken})
    with pytest.raises(FileFormatError, match=r"c\.xlsx, sheet 'Friday', row 4, column 3: found 'dark'"):
        registry.read_all(tmp_path / "c.xlsx")


@pytest.mark.parametrize(
    ("text", "angle"),
    [("-15DP", -15), ("15 DP", 15), ("as15", 15), ("asMinus15", -15), ("15d", 15), ("-15\u00b0 (SP)", -15),
     ("DP 110", 110), ("DP-15", -15), ("aspecular 75", 75), ("M15", None), ("15x", None), ("400", None)],
)  # fmt: skip
def test_aspecular_angles_are_read_in_every_spelling(text, angle):
    assert parse_aspecular(text) == angle


@pytest.mark.parametrize(
    ("text", "angles"),
    [("45as-15 DP", (45, -15, 0)), ("45as75 (double path)", (45, 75, 0)), ("25/0", (25, 25, 0)),
     ("0/75", (75, 75, 0)), ("12:30", None), ("10_0", None), ("1/0", None), ("45/75", None)],
)  # fmt: skip
def test_paths_behind_geometries_and_looks_along_the_normal_are_read(text, angles):
    assert parse_geometry(text) == angles


def angle_table(names, title=""):
    return "\n".join([f"{title},,,", "Angle,400,500,600", *(f"{name},0.1,0.2,0.3" for name in names)])


def test_a_double_path_is_read_as_one_and_said(tmp_path):
    (tmp_path / "m6.csv").write_text(angle_table(["-15DP", "15DP", "25DP", "45DP", "75DP", "110DP"], "CM-M6"))
    found = registry.read_readings(tmp_path / "m6.csv")
    np.testing.assert_array_equal(found.wo, SPECTRO.wo[:6])
    assert [note for note in found.notes if "two paths" in note]
    (tmp_path / "m6.csv").write_text(angle_table(["15DP", "15SP"]))
    assert any("repeat a geometry" in note for note in registry.read_readings(tmp_path / "m6.csv").notes)


def test_three_angles_are_incidences_where_the_file_names_such_an_instrument(tmp_path):
    (tmp_path / "km.csv").write_text(angle_table(["25", "45", "75"], "Konica Minolta CM-512m3A"))
    found = registry.read_readings(tmp_path / "km.csv")
    np.testing.assert_allclose(np.rad2deg(np.arccos(found.wi[:, 2])), [25, 45, 75])
    np.testing.assert_allclose(found.wo, [[0, 0, 1]] * 3, atol=1e-12)


def test_second_angles_are_aspecular_where_one_cannot_be_from_the_normal(tmp_path):
    (tmp_path / "a.csv").write_text(angle_table(["45/-15", "45/25", "45/110"]))
    found = registry.read_readings(tmp_path / "a.csv")
    np.testing.assert_allclose(found.wo, [aspecular_pair(45, a)[1] for a in (-15, 25, 110)])


def test_the_values_of_several_samples_are_shown_together(tmp_path):
    """Those of the first sample were shown as those of the file."""
    write_csv(tmp_path / "a.csv", wide())
    shown = inspect_instrument_file(tmp_path / "a.csv", "CSV table")
    assert shown.rows["values in 1/sr"] == f"{0.5 * SPECTRO.values.min():.4g} to {SPECTRO.values.max():.4g}"
