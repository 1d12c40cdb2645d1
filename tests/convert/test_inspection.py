"""What `manifold info` finds in files, libraries and models."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.sample_files import WAVELENGTHS_NM, write_samples
from helpers.small_library import NAMES, measured, small_model

from manifold.convert.contents import inspect, inspect_source
from manifold.core import progress
from manifold.core.errors import FileFormatError, LibraryError, ModelError, UsageError
from manifold.estimate.sources import LibrarySource
from manifold.fit import fits
from manifold.fit.principled import fit_bsdf
from manifold.io_rgl import write_bsdf
from manifold.library.compacting import compact_library
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.settings import KINDS
from manifold.render import fit_json
from manifold.render.bsdf_parameters import principled

FAMILY = principled(["base_color", "roughness"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`files/`, `library.zarr` and `model.h5`."""
    path = tmp_path_factory.mktemp("inspection")
    small_model(path)
    return path


@pytest.fixture
def copy(folder, tmp_path):
    """The same, to be damaged."""
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_a_file_is_described_by_what_it_holds(folder):
    found = inspect(folder / "files" / f"{NAMES[0]}_rgb.bsdf")
    file = measured(NAMES[0])
    assert found.title == f"{NAMES[0]}_rgb.bsdf: RGL material"
    assert found.rows["bands"] == "RGB"
    assert found.rows["outgoing grid"] == "32 x 32 cells"
    assert found.document["shape"] == list(file.spectra.shape)
    np.testing.assert_array_equal(found.document["theta_i_rad"], file.theta_i_rad)
    assert found.document["zero_share"] == pytest.approx(np.mean(file.spectra == 0))
    assert found.document["measured_share"] == pytest.approx(file.measured_mask.mean())


def test_a_damaged_file_is_named_with_its_cells_and_what_stands_at_each_incidence(tmp_path):
    file = measured("syn_paper_white")
    spectra = file.spectra.copy()
    spectra[0, 2, 1, 10, 12] *= 1000.0
    write_bsdf(tmp_path / "damaged_rgb.bsdf", replace(file, spectra=spectra))
    found = inspect(tmp_path / "damaged_rgb.bsdf")
    (finding,) = found.rows["findings"]
    assert "1 stored value disagrees" in finding
    (heads, incidences), (_, cells) = found.tables
    degrees = [f"{np.rad2deg(theta):.1f}" for theta in file.theta_i_rad]
    assert [row[0] for row in incidences] == degrees
    assert heads[1:4] == ["albedo R", "albedo G", "albedo B"]
    assert float(incidences[0][heads.index("albedo G")]) == pytest.approx(0.83, abs=0.02)
    ((where, band, row, column, *_),) = cells
    assert (where, band, row, column) == (f"0.0, {degrees[2]}", "G", 10, 12)
    assert found.document["consistency"]["findings"] == [finding]


def test_a_spectral_file_has_the_largest_albedo_of_its_bands(tmp_path):
    (path,) = write_samples(tmp_path, 1)
    (heads, incidences), _ = inspect(path).tables
    largest = np.array(inspect(path).document["consistency"]["albedo"])[0, 0]
    row = dict(zip(heads, incidences[0], strict=True))
    assert float(row["largest albedo"]) == pytest.approx(largest.max(), rel=5e-3)  # three digits
    assert row["at"] == f"{WAVELENGTHS_NM[largest.argmax()]:.1f} nm"


def test_the_approximation_of_a_compact_library_is_no_finding(copy):
    compact_library(copy / "library.zarr")
    for name in NAMES:
        source = LibrarySource(copy / "library.zarr", name)
        assert inspect_source(source, library=None, verify=False).rows["findings"] == "none"


def test_a_library_lists_its_materials(folder):
    found = inspect(folder / "library.zarr")
    ((_, rows),) = found.tables
    assert [row[0] for row in rows] == sorted(NAMES)
    assert found.rows["materials"] == f"{len(NAMES)}, {len(NAMES)} of them synthetic"
    assert found.document["content_hash"] == Library.open(folder / "library.zarr").content_hash
    assert found.problems == []


def test_a_model_lists_its_latents(folder):
    found = inspect(folder / "model.h5")
    model = Manifold.load(folder / "model.h5")
    ((columns, rows),) = found.tables
    assert columns[:3] == ["material", "x1", "x2"]  # then what was left out
    for row, name, x in zip(rows, model.names, model.X, strict=True):
        assert row[:3] == (name, *model.space.printed(x))
        assert found.document["latents"][name] == x.tolist()


@pytest.mark.parametrize("kind", ["blend", "gplvm"])
def test_a_model_without_its_library_tells_what_it_knows(copy, kind):
    Manifold.fit(copy / "library.zarr", KINDS[kind](), calibrate=False).save(copy / "m.h5")
    whole = inspect(copy / "m.h5")
    (copy / "library.zarr").rename(copy / "elsewhere.zarr")
    found = inspect(copy / "m.h5")
    assert "its library is not at" in found.rows["library"]
    same = found.rows.keys() - {"library", "bands"}
    assert {key: found.rows[key] for key in same} == {key: whole.rows[key] for key in same}
    assert found.tables == whole.tables
    known = whole.document | {"library_problem": found.document["library_problem"]}
    assert found.document == known
    assert known["library_problem"] is not None
    assert inspect(copy / "m.h5", library=copy / "elsewhere.zarr").rows["bands"] == whole.rows["bands"]
    with pytest.raises(LibraryError):
        inspect(copy / "m.h5", library=copy / "files")


@pytest.mark.parametrize("name", [f"files/{NAMES[0]}_rgb.bsdf", "library.zarr", "model.h5"])
def test_every_document_is_plain_json(folder, name):
    document = inspect(folder / name).document
    assert json.loads(json.dumps(document, allow_nan=False))["path"] == str(folder / name)


def test_kinds_are_told_by_content_not_by_name(copy):
    (copy / "model.h5").rename(copy / "model.bsdf")
    (copy / "files" / f"{NAMES[0]}_rgb.bsdf").rename(copy / "material.dat")
    (copy / "library.zarr").rename(copy / "library.h5")
    assert "RGL material" in inspect(copy / "material.dat").title
    assert "library" in inspect(copy / "library.h5").title
    assert "model" in inspect(copy / "model.bsdf", library=copy / "library.h5").title


def test_verification_names_what_is_damaged(copy):
    path = copy / "library.zarr"
    steps = []
    with progress.listen(lambda *step: steps.append(step)):
        assert inspect(path, verify=True).problems == []
    assert [step[:2] for step in steps] == [(k + 1, len(NAMES)) for k in range(len(NAMES))]
    chunk = path / "materials" / NAMES[2] / "spectra" / "c.0.0.0.0.0"
    content = bytearray(chunk.read_bytes())
    content[1000] ^= 1
    chunk.write_bytes(content)
    found = inspect(path, verify=True)
    (problem,) = found.problems
    assert problem.startswith(NAMES[2])
    assert found.document["problems"] == [problem]
    assert found.rows["verified"] == "1 damaged"


def test_a_fit_shows_its_material_and_parameters(tmp_path):
    content = fits.document(
        fit_bsdf(measured(NAMES[0]), FAMILY), fit_json.FitSource("felt", file="felt_rgb.bsdf")
    )
    fit_json.write_document(tmp_path / "felt.fit.json", content)
    found = inspect(tmp_path / "felt.fit.json")
    assert found.rows["material"] == "felt"
    assert found.rows["fitted to"] == "felt_rgb.bsdf"
    ((_, values),) = found.tables
    assert [name for name, _ in values] == list(content["values"])
    roughness = dict(values)["roughness"]
    assert float(roughness) == pytest.approx(content["values"]["roughness"], rel=1e-3)
    json.dumps(found.document, allow_nan=False)

    source = content["source"] | {"file": None, "latent": [0.5, -1.0], "model": "model.h5"}
    spectral = content["values"] | {"base_color": [0.1, 0.2, 0.5, 0.4, 0.3]}
    changed = content | {"source": source, "values": spectral}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_json, "read", lambda _: changed)
        found = inspect(tmp_path / "felt.fit.json")
    assert found.rows["fitted to"] == "the prediction of model.h5 at latent 0.5, -1"
    assert dict(found.tables[0][1])["base_color"] == "0.1 to 0.5 in 5 bands"


def _truncated(path: Path, folder: Path) -> None:
    path.write_bytes((folder / "model.h5").read_bytes()[:3000])


@pytest.mark.parametrize(
    ("name", "make", "error"),
    [
        ("folder", lambda path, _: path.mkdir(), LibraryError),
        ("text.h5", lambda path, _: path.write_text("text"), ModelError),
        ("empty.h5", lambda path, _: path.touch(), ModelError),
        ("cut.h5", _truncated, ModelError),
        ("cut.bin", _truncated, ModelError),
        ("text.bsdf", lambda path, _: path.write_text("text"), FileFormatError),
        ("x.json", lambda path, _: path.write_text('{"format": "another"}'), FileFormatError),
        ("sample.xlsx", lambda path, _: path.write_text("hello"), FileFormatError),
        ("absent", lambda path, _: None, UsageError),
        ("empty.bsdf", lambda path, _: path.touch(), FileFormatError),
    ],
)
def test_foreign_and_damaged_things_are_one_line_that_names_them(folder, tmp_path, name, make, error):
    make(tmp_path / name, folder)
    with pytest.raises(error) as caught:
        inspect(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
