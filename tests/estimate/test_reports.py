"""Reports to hand on say what was read, what was made of it and how far they differ, in one file each."""

from __future__ import annotations

import json
import re
from html import unescape

import numpy as np
import pytest
from helpers.instrument_files import smooth
from helpers.readings import readings

from manifold.analytic.virtual_instruments import MA_T12_BANDS, ma_t12_readings
from manifold.estimate import Completion, reports
from manifold.formats import csv_table
from manifold.formats.readings import aspecular_pair, geometry_ma_t12
from manifold.pictures import html_page


def rows(page: str) -> list[list[str]]:
    """The cells of all rows of tables of numbers."""
    return [
        [unescape(cell) for cell in re.findall(r"<td>(.*?)</td>", row)]
        for row in re.findall(r"<tr>(<td>.*?)</tr>", page)
    ]


def write_table(path, name):
    """Readings of a smooth material in six bands."""
    csv_table.write(path, ma_t12_readings(smooth(MA_T12_BANDS), name).select_bands(list(range(0, 31, 6))))


def test_a_section_without_content_has_no_heading(tmp_path):
    sections = [html_page.Section("Sample", {"bands": 3}), html_page.Section("Notes")]
    html_page.write(tmp_path / "page.html", "paint", "A paint.", sections)
    page = (tmp_path / "page.html").read_text()
    assert (page.count("<section"), "Notes" in page) == (1, False)


def test_the_report_of_a_completion_has_every_reading_with_its_difference(run, library, tmp_path):
    write_table(tmp_path / "sample.csv", "a <b>paint</b> & more")
    status, _, err = run(
        "complete", "sample.csv", "-L", library, "-o", "made.bsdf", "--json", "made.json", "--report", "made.html",
        "--suggest", "2", cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    page = (tmp_path / "made.html").read_text()
    known = json.loads((tmp_path / "made.json").read_text())
    assert "sample.csv" in page
    assert "a &lt;b&gt;paint&lt;/b&gt; &amp; more" in page
    assert "<b>paint" not in page
    of_readings = [row for row in rows(page) if len(row) == 12]
    assert [row[-2] for row in of_readings] == [f"{off:.2f}" for off in known["misfits_ciede2000"]]
    assert [row[-1] for row in of_readings] == [
        f"{off:.2f}" for off in known["left_out_readings"]["ciede2000"]
    ]
    assert [float(row[4]) for row in of_readings] == pytest.approx(
        [lab[0] for lab in known["lab"][0]], abs=0.051
    )
    assert [(float(row[0]), float(row[3])) for row in of_readings][:2] == [(45.0, -15.0), (45.0, 15.0)]
    assert page.count("data:image/png;base64") == 2
    assert page.count("<svg") == 2
    assert not re.search(r'(src|href)="(?!data:|#)', page)  # nothing lies beside it
    for note in known["diagnostics"]:
        assert note in unescape(page)
    gloss = page.partition("Gloss (ISO 2813)")[2]
    shown = {row[0]: row[1] for row in rows(gloss) if len(row) == 2 and row[0] in known["gloss"]}
    assert shown == {angle: f"{units['completed']:.3g}" for angle, units in known["gloss"].items()}
    assert list(shown) == ["20", "60", "85"]
    suggested = page.partition("Directions to measure next")[2]
    assert [[float(cell) for cell in row] for row in rows(suggested)[:2]] == np.round(
        known["suggested_deg"]
    ).tolist()


def test_a_batch_gives_a_report_each_and_a_page_that_leads_to_them(run, library, tmp_path):
    for name in ("red", "blue"):
        write_table(tmp_path / f"{name}.csv", name)
    status, _, err = run(
        "complete", "red.csv", "blue.csv", "-L", library, "-o", "made", "--report", "made/all.html",
        "--json", "made/all.json", cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    page = (tmp_path / "made" / "all.html").read_text()
    linked = re.findall(r'(?:src|href)="(.*?)"', page)
    assert len(linked) == 4
    assert all((tmp_path / "made" / link).is_file() for link in linked)
    assert (tmp_path / "made" / "all.json").is_file()


@pytest.mark.parametrize(
    "arguments",
    [
        ("complete", "sample.csv", "-o", "c.bsdf"),
        ("complete", "sample.csv", "-o", "c.bsdf", "--merge"),
        ("complete", "--lab", "40,30,20", "--gloss", "60=50", "-o", "c.bsdf"),
        ("complete", "sample.csv", "sample.csv", "-o", "c"),
        ("convert", "sample.csv", "-o", "c.astm"),
        ("calibrate", "sample.csv", "sample.csv", "-o", "c.json"),
        ("photograph", "c.png", "--lamp", "found", "-o", "c.bsdf"),
    ],
    ids=lambda arguments: f"{arguments[0]} {arguments[1]} {arguments[-1]}",
)
def test_a_report_that_cannot_be_written_is_refused_before_the_work(run, library, tmp_path, arguments):
    write_table(tmp_path / "sample.csv", "a")
    for report in (".", "missing/report.html"):
        status, _, err = run(*arguments, "--report", report, cwd=tmp_path)
        assert status == 1
        assert "cannot write this file" in err
        assert [path.name for path in tmp_path.iterdir()] == ["sample.csv"]


def test_conversions_and_colours_have_reports(run, library, tmp_path):
    csv_table.write(tmp_path / "felt.csv", ma_t12_readings(smooth(MA_T12_BANDS), "felt"))
    status, _, err = run("convert", "felt.csv", "-o", "felt.astm", "--report", "felt.html", cwd=tmp_path)
    assert status == 0, err
    assert "felt.csv" in (tmp_path / "felt.html").read_text()
    status, _, err = run(
        "complete", "--lab", "40,30,20", "--gloss", "60=50", "-L", library, "-o", "c.bsdf", "--report", "c.html",
        cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    assert "50 requested" in (tmp_path / "c.html").read_text()


def test_angles_are_those_of_the_instrument_and_the_flop_index_is_alman_s():
    wi, wo = geometry_ma_t12()
    angles = reports.angles_of(wi, wo)
    np.testing.assert_allclose(angles[:, 0], [45.0] * 6 + [15.0] * 6)
    np.testing.assert_allclose(angles[:, 3], [-15, 15, 25, 45, 75, 110, -45, -30, -15, 15, 45, 80], atol=1e-9)
    lab = np.zeros((12, 3))
    lab[[1, 3, 5], 0] = 90.0, 60.0, 30.0
    assert reports.flop_index(angles, lab) == pytest.approx(2.69 * 60.0**1.11 / 60.0**0.86)
    assert reports.flop_index(angles[:1], lab[:1]) is None
    out_of_plane = reports.angles_of(*(w[None] for w in aspecular_pair(45.0, 60.0, 125.3)))
    assert np.isnan(out_of_plane[0, 3])


def test_curves_over_angles_show_the_completion_between_the_readings(atoms):
    made = Completion.of(atoms, readings(np.full((12, 3), 0.4 / np.pi)))
    assert made.colours is not None
    read, _ = made.colours
    figure = reports._colour_figure(made, reports.angles_of(made.readings.wi, made.readings.wo), read)
    assert figure is not None
    of_15, dots, of_45, _ = figure.axes[0].lines
    for line, incidence in ((of_15, 15.0), (of_45, 45.0)):
        aspecular, lightness = line.get_data()
        np.testing.assert_allclose(np.sort(aspecular), incidence + np.arange(-80.0, 81.0))
        assert np.median(lightness) == pytest.approx(float(np.mean(read[:, 0])), abs=1.0)
    assert len(dots.get_xdata()) == 6
    assert len(figure.axes[0].collections) == 2  # bands
