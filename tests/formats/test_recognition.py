"""Which format a file is taken for, and what messages say of files and pictures of other kinds."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from helpers.instrument_files import dense, lighttools_axes, write_every_format

from manifold.convert.contents import inspect
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Bands
from manifold.formats import bird, registry
from manifold.formats.recognition import Kind, is_readings, kind_of
from manifold.formats.tensor_file import write_tensors
from manifold.io_rgl import read_bsdf
from manifold.render.ball import make_settings

TABLES = {
    "angles and Lab": "Name,Angle,L*,a*,b*\nred,15,60,40,20\nred,45,40,45,25\nred,110,30,35,20\n",
    "angles and Lab, decimal commas": "Name;Angle;L*;a*;b*\nred;15;60,5;40;20\nred;45;40;45;25\nred;110;30;35;20\n",
    "planetary": "i,e,g,I/F\n30,0,30,0.1\n30,30,60,0.1\n",
    "spectra below geometries": "nm;45as15;45as45\n400;0,1;0,2\n500;0,1;0,2\n",
    "a comment as header": "# theta_i theta_o BRDF_633nm\n30 20 0.1\n30 40 0.1\n",
}


@pytest.mark.parametrize("name", TABLES)
def test_what_the_parser_reads_is_recognised(name, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(TABLES[name])
    assert registry.identify(path).name == "CSV table"
    assert len(registry.read_all(path)) == 1


def test_every_format_is_recognised_by_what_it_writes(tmp_path):
    for path in write_every_format(tmp_path).values():
        assert registry.identify(path) is not None
        registry.read_all(path)


@pytest.mark.parametrize("name", ["a.h5", "a.hdf5", "a.fit.json", "a.json", "a.bsdf", "a.png", "a"])
def test_content_comes_before_the_name(name, tmp_path):
    """Tables called .h5 and .fit.json were refused by name."""
    path = tmp_path / name
    path.write_text(TABLES["planetary"])
    assert kind_of(path) is Kind.READINGS
    assert inspect(path).rows["format"] == "CSV table"


def test_names_decide_where_the_content_says_nothing(tmp_path):
    kinds = {"a.h5": Kind.MODEL, "a.fit.json": Kind.FIT, "a.bsdf": Kind.RGL, "a.json": Kind.OTHER}
    for name in kinds:
        (tmp_path / name).write_text("damaged")
    assert {name: kind_of(tmp_path / name) for name in kinds} == kinds


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "AOI,AOR,BRDF\n30,30,0.5\n",
            "a header AOI, AOR, BRDF: the heading AOR is not understood, expected both elev",
        ),
        ("BRDF;AOR;AOI\n0,5;30;30\n", "a header BRDF, AOR, AOI: the heading AOR is not understood"),
        (
            "incidence\tspecular angle\tReflectance\n30\t30\t0.5\n",
            "the heading specular angle is not understood",
        ),
        (
            "theta_o,BRDF 633nm\n30,0.5\n",
            "a header theta_o, BRDF 633nm: one elevation, expected both elevations",
        ),
    ],
)
def test_a_head_that_is_not_understood_is_named(text, words, tmp_path):
    """`AOI,AOR,BRDF` was called a Mini-Diff."""
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(FileFormatError, match=rf"table\.csv: .*{words}"):
        registry.read_all(tmp_path / "table.csv")


def test_polarised_files_are_named(tmp_path):
    """They were called damaged RGL files."""
    fields = {name: np.zeros(2, np.float32) for name in ("phi_d", "theta_d", "theta_h")}
    write_tensors(
        tmp_path / "a.pbsdf",
        {"M": np.zeros((2, 2, 2, 1, 4, 4), np.float32), **fields, "wvls": np.zeros(1, np.uint16)},
    )
    for read in (read_bsdf, registry.read_all):
        with pytest.raises(
            FileFormatError, match=r"found Mueller matrices of a polarised BRDF \(KAIST \.pbsdf\)"
        ):
            read(tmp_path / "a.pbsdf")


@pytest.mark.parametrize(
    "text",
    ['[{"theta_i": 0, "theta_o": 10, "BRDF": 0.1}]', '{"phi": [1, 2], "theta_i": 3}', "[[1, 2], [3, 4]]"],
)
def test_json_is_no_table(text, tmp_path):
    path = tmp_path / "list.json"
    json.loads(text)
    path.write_text(text)
    assert registry.identify(path) is None
    with pytest.raises(FileFormatError, match=r"list\.json: found a JSON document, expected an RGL file"):
        registry.read_all(path)


def test_bird_files_that_are_called_json_are_readings(tmp_path):
    bird.write(
        tmp_path / "a.json",
        dense(Bands((550.0,)), "incident-outgoing", lighttools_axes()).readings(),
        "measurement",
    )
    (tmp_path / "notes.json").write_text('{"theta_i": "of the light"}')
    assert is_readings(tmp_path / "a.json")
    assert not is_readings(tmp_path / "notes.json")


@pytest.mark.parametrize(
    ("name", "parts", "words"),
    [
        ("fabric.u3m", {"fabric.u3m": "{}", "textures/base.png": ""}, "found a U3M material"),
        ("text.docx", {"word/document.xml": "<a/>"}, "found a Word document"),
        ("sheet.ods", {"content.xml": "<a/>"}, "found an OpenDocument file"),
        ("any.zip", {"a.txt": ""}, "found a ZIP archive"),
    ],
)
def test_archives_that_are_no_workbook_are_named(name, parts, words, tmp_path):
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        for part, content in parts.items():
            archive.writestr(part, content)
    with pytest.raises(
        FileFormatError,
        match=f"{words}, expected an .xlsx workbook of a spectrophotometer; name another file",
    ):
        registry.read_all(tmp_path / name)


@pytest.mark.parametrize(
    ("head", "words"), [(b"\x89HDF\r\n\x1a\n", "an HDF5 file .NetCDF"), (b"CDF\x01", "a NetCDF file")]
)
def test_netcdf_is_no_model(head, words, tmp_path):
    (tmp_path / "sky.nc").write_bytes(head + bytes(600))
    with pytest.raises(FileFormatError, match=f"sky.nc: found {words}"):
        inspect(tmp_path / "sky.nc")


def test_darkness_in_the_mirror_direction_is_no_ratio(tmp_path):
    """`8.09e+299 times as bright` was the ratio over the smallest number."""
    path = tmp_path / "scan.csv"
    rows = [(i, o, 0.5 if abs(i + o) < 12 else 0.0) for i in (30, 40, 50) for o in range(-80, 81, 5)]
    path.write_text(
        "theta_i (deg),theta_o (deg),BRDF 550nm\n" + "".join(f"{i},{o},{f}\n" for i, o, f in rows)
    )
    (note,) = [n for n in registry.read_readings(path).notes if "towards the light" in n]
    assert note.startswith("bright towards the light and dark in the mirror direction: a retroreflector")


def test_an_environment_that_is_no_panorama_is_refused(tmp_path):
    from manifold.render.images import write_image

    write_image(tmp_path / "square.exr", np.ones((16, 16, 3)))
    with pytest.raises(
        UsageError, match=r"square\.exr: an environment of 16 x 16 pixels, expected twice as wide as high"
    ):
        make_settings(size=16, samples=1, seed=0, illuminant="D65", environment=tmp_path / "square.exr")
