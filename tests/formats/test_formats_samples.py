"""Several samples of one file have one unit, keep their geometries, and can each be named."""

from __future__ import annotations

import re

import numpy as np
import openpyxl
import pytest
from helpers.instrument_files import smooth, write_cxf

from manifold.analytic.virtual_instruments import MA_T12_BANDS, ma_t12_readings
from manifold.core.errors import FileFormatError
from manifold.formats import registry
from manifold.formats.readings import MA_T12_NAMES

SPECTRO = ma_t12_readings(smooth(MA_T12_BANDS), "smooth")
PERCENT = 100.0 * np.pi * SPECTRO.values
SCALES = {"white": 1.0, "black": 0.01}  # percentages of the black one could be factors
HEAD = ["Name", "Geometry", *(f"{nm:g}" for nm in MA_T12_BANDS.wavelengths_nm)]


def sample_rows(name: str) -> list[list[str | float]]:
    """The table of one sample."""
    return [[name, g, *row] for g, row in zip(MA_T12_NAMES, (SCALES[name] * PERCENT).tolist(), strict=True)]


def assert_both(path) -> None:
    found = {one.name: one for one in registry.read_all(path)}
    assert found.keys() == SCALES.keys()
    for name, scale in SCALES.items():
        np.testing.assert_allclose(found[name].values, scale * SPECTRO.values, rtol=1e-6)
        assert sum("taken as percent" in note for note in found[name].notes) == 1


def test_black_is_in_percent_where_white_of_the_same_table_is(tmp_path):
    path = tmp_path / "both.csv"
    rows = [HEAD, *sample_rows("white"), *sample_rows("black")]
    path.write_text("\n".join(",".join(map(str, row)) for row in rows))
    assert_both(path)


def test_black_is_in_percent_where_white_of_another_sheet_is(tmp_path):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name in SCALES:
        sheet = book.create_sheet(name)
        for row in [HEAD, *sample_rows(name)]:
            sheet.append(row)
    book.save(tmp_path / "both.xlsx")
    assert_both(tmp_path / "both.xlsx")


def test_samples_under_an_unknown_head_are_refused_not_averaged(tmp_path):
    rows = [["\u6837\u54c1", *HEAD[1:]], *sample_rows("white"), *sample_rows("black")]
    path = tmp_path / "both.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")
    with pytest.raises(FileFormatError, match="expected a column Name that distinguishes the samples"):
        registry.read_all(path)


@pytest.fixture(scope="module")
def cxf(tmp_path_factory) -> str:
    """A CxF3 document of one object; values are factors."""
    path = tmp_path_factory.mktemp("cxf") / "smooth.cxf"
    write_cxf(path, SPECTRO)
    return path.read_text()


def objects_of(text: str) -> tuple[str, str, str]:
    """What stands before, in and behind the object of a document."""
    found = re.search(r"(.*)(<ns0:Object .*</ns0:Object>)(.*)", text, re.DOTALL)
    assert found is not None
    return found.groups()


def scaled(text: str, scale: float) -> str:
    return re.sub(r"\d\.\d{6,}(e-\d+)?", lambda m: f"{scale * float(m[0]):.12f}", text)


def test_a_cxf_file_in_percent_is_refused_though_its_black_could_be_a_factor(cxf, tmp_path):
    before, one, behind = objects_of(cxf)
    named = [scaled(one, 100.0 * SCALES[name]).replace('Name="smooth"', f'Name="{name}"') for name in SCALES]
    (tmp_path / "both.cxf").write_text(before + "".join(named) + behind)
    with pytest.raises(FileFormatError, match=r"object 'white': .*divide per cent by 100"):
        registry.read_all(tmp_path / "both.cxf")


def test_a_spectrum_named_by_a_geometry_has_it_whatever_its_turn(cxf, tmp_path):
    """One specification of all angles; the spectra stand in another order."""
    angles = "".join(re.findall(r"<ns0:BRDFAngle.*?</ns0:BRDFAngle>", cxf, re.DOTALL))
    text = re.sub(r"(<ns0:MultiAngle>).*?(</ns0:MultiAngle>)", rf"\1{angles}\2", cxf, flags=re.DOTALL)
    text = re.sub(r'ColorSpecification="M0_(\S+)"', r'Name="r\1" ColorSpecification="M0_45as15"', text)
    spectra = re.findall(r"<ns0:ReflectanceSpectrum.*?</ns0:ReflectanceSpectrum>", text, re.DOTALL)
    text = re.sub(
        r"<ns0:ReflectanceSpectrum.*</ns0:ReflectanceSpectrum>",
        "".join(reversed(spectra)),
        text,
        flags=re.DOTALL,
    )
    (tmp_path / "turned.cxf").write_text(text)
    found = registry.read_readings(tmp_path / "turned.cxf")
    np.testing.assert_allclose(found.values, SPECTRO.values[::-1])
    np.testing.assert_allclose(found.wo, SPECTRO.wo[::-1], atol=1e-12)


def test_cxf_objects_of_one_name_are_one_sample_unless_they_repeat_its_geometries(cxf, tmp_path):
    before, one, behind = objects_of(cxf)
    spectra = re.findall(r"<ns0:ReflectanceSpectrum.*?</ns0:ReflectanceSpectrum>", one, re.DOTALL)
    single = [
        re.sub(r"<ns0:ReflectanceSpectrum.*</ns0:ReflectanceSpectrum>", s, one, flags=re.DOTALL)
        for s in spectra
    ]
    (tmp_path / "apart.cxf").write_text(before + "".join(single) + behind)
    np.testing.assert_allclose(registry.read_readings(tmp_path / "apart.cxf").values, SPECTRO.values)
    (tmp_path / "again.cxf").write_text(before + one + scaled(one, 0.5) + behind)
    assert [r.name for r in registry.read_all(tmp_path / "again.cxf")] == ["smooth", "smooth (2)"]
    second = registry.read_readings(tmp_path / "again.cxf", "smooth (2)")
    np.testing.assert_allclose(second.values, 0.5 * SPECTRO.values, rtol=1e-6)


def test_cxf_spectra_that_repeat_a_geometry_are_averaged(cxf, tmp_path):
    """As M0, M1 and M2 of a 45/0 instrument do."""
    doubled = re.sub(
        r"(<ns0:ReflectanceSpectrum.*?</ns0:ReflectanceSpectrum>)",
        lambda m: m[1] + scaled(m[1], 0.5),
        cxf,
        flags=re.DOTALL,
    )
    (tmp_path / "twice.cxf").write_text(doubled)
    found = registry.read_readings(tmp_path / "twice.cxf")
    np.testing.assert_allclose(found.values, 0.75 * SPECTRO.values, rtol=1e-6)
    assert any("12 readings repeat a geometry: means are taken" in note for note in found.notes)
