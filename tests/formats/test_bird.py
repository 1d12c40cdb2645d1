"""BiRD files: values with uncertainties, read and written."""

import contextlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError
from manifold.formats import bird, registry
from manifold.formats.readings import Readings

REAL = Path(__file__).parents[3] / "shared" / "files" / "bird"
needs_real_files = pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
NM = np.array([450.0, 550.0, 650.0])


def readings(scatter=0.0):
    wi = np.broadcast_to(from_spherical(np.pi / 4, np.pi), (4, 3))
    wo = from_spherical(np.deg2rad([0.0, 20.0, 45.0, 70.0]), np.deg2rad([0.0, 90.0, 0.0, 200.0]))
    values = np.outer([0.1, 0.12, 2.0, 0.08], [0.5, 1.0, 0.7])
    return Readings("paint", "gonio", wi, wo, NM, values, scatter=np.full(4, scatter))


def content(**changes):
    rows = {"theta_i": [45.0, 45.0], "phi_i": [180.0, 180.0], "theta_r": [0.0, 45.0], "phi_r": [0.0, 0.0]}
    data = {key: {"unit": "deg", "values": values} for key, values in rows.items()}
    data |= {
        "wavelength_i": {"unit": "nm", "values": [550.0, 550.0]},
        "BRDF": {"unit": "sr^-1", "values": [0.2, 0.4]},
    }
    return {"metadata": {"schema": "brdf_json_schema_v1.0.json"}, "data": {**data, **changes}}


def written(tmp_path, value):
    path = tmp_path / "x.json"
    path.write_text(json.dumps(value))
    return path


def test_what_is_written_is_read_back(tmp_path):
    before = readings(0.01)
    bird.write(tmp_path / "x.json", before, "measurement")
    after = registry.read_readings(tmp_path / "x.json")
    assert after.name == "paint"
    np.testing.assert_allclose(after.values, before.values, rtol=1e-6)
    np.testing.assert_allclose(np.hstack([after.wi, after.wo]), np.hstack([before.wi, before.wo]), atol=1e-6)
    np.testing.assert_allclose(after.scatter, 0.01, rtol=1e-3)
    assert after.repeatability == pytest.approx(0.03, rel=1e-3)


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("measurement", "standard uncertainty, coverage factor 1"),
        ("simulation", "not a standard uncertainty"),
    ],
)
def test_only_uncertainties_of_measurements_are_called_standard(tmp_path, method, words):
    bird.write(tmp_path / "x.json", readings(0.01), method)
    comments = json.loads((tmp_path / "x.json").read_text())["data"]["uBRDF"]["comments"]
    assert words in comments
    assert ("expected error" in comments) == (method == "simulation")


def test_values_that_were_not_measured_have_no_row(tmp_path):
    before = readings()
    values = np.array(before.values)
    values[1, 2] = np.nan
    bird.write(tmp_path / "x.json", replace(before, values=values), "measurement")
    after = registry.read_readings(tmp_path / "x.json")
    np.testing.assert_array_equal(after.measured, np.isfinite(values))
    assert "uBRDF" not in json.loads((tmp_path / "x.json").read_text())["data"]


def test_uncertain_values_weigh_less(tmp_path):
    path = written(tmp_path, content(uBRDF={"unit": "%", "values": [1.0, 30.0]}))
    (found,) = registry.read_all(path)
    np.testing.assert_allclose(found.scatter, [0.01 / 3.0, 0.1])
    assert found.weights[1] < 0.05 < 0.9 < found.weights[0]
    in_units = written(tmp_path, content(uBRDF={"unit": "1/sr", "values": [0.002, 0.12]}))
    np.testing.assert_allclose(registry.read_all(in_units)[0].scatter, found.scatter)
    of_all = {"unit": "sr^-1", "values": [0.2, 0.4], "uncertainty": {"value": 2.0, "unit": "%"}}
    (same,) = registry.read_all(written(tmp_path, content(BRDF=of_all)))
    np.testing.assert_allclose(same.scatter, 0.02 / 3.0)


def test_states_of_polarisation_become_their_mean(tmp_path):
    rows = {
        key: {"unit": "deg", "values": [v, v]}
        for key, v in (("theta_i", 10), ("phi_i", 0), ("theta_r", 20), ("phi_r", 5))
    }
    both = {"notation": "sp", "values": ["s", "p"]}
    (found,) = registry.read_all(written(tmp_path, content(**rows, polarization_i=both)))
    assert found.values.tolist() == [[pytest.approx(0.3)]]
    assert "polarisation" in found.notes[0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"BRDF": {"unit": "%", "values": [0.2, 0.4]}}, "of unit '%'"),
        ({"BRDF": {"unit": "sr^-1", "values": [0.2]}}, "has 2 values, expected 1"),
        ({"theta_i": {"unit": "gon", "values": [1, 2]}}, "of unit 'gon'"),
        ({"theta_r": {"unit": "deg", "values": ["a", 2]}}, "not numbers of at least 0"),
        ({"wavelength_i": {"unit": "nm", "values": []}}, "has no values"),
        ({"uBRDF": {"unit": "m", "values": [1, 2]}}, "of unit 'm'"),
    ],
)
def test_a_wrong_variable_is_named(tmp_path, changes, said):
    with pytest.raises(FileFormatError, match=said):
        registry.read_all(written(tmp_path, content(**changes)))


@settings(max_examples=60, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["unit", "values", "value"]), inner)
        ),
    ),
    st.sampled_from(["BRDF", "uBRDF", "theta_i", "wavelength_i", "polarization_i"]),
)
def test_any_content_is_read_or_refused(tmp_path_factory, value, key):
    path = written(tmp_path_factory.mktemp("any"), content(**{key: value}))
    with contextlib.suppress(FileFormatError):
        assert np.isfinite(registry.read_all(path)[0].weights).all()


@needs_real_files
def test_the_example_of_the_project_is_read_and_written_back_valid(tmp_path):
    import jsonschema
    from referencing import Registry, Resource

    schemas = {}
    for path in (REAL / "BRDF_JSON_schema").glob("*.json"):
        try:
            schemas[path.name] = json.loads(path.read_text())
        except ValueError:  # one of them has a comma too many
            continue
    known = Registry().with_resources([(one["$id"], Resource.from_contents(one)) for one in schemas.values()])
    validator = jsonschema.Draft202012Validator(
        schemas["brdf_json_schema_v1.0.json"], registry=known, format_checker=jsonschema.FormatChecker()
    )
    (found,) = registry.read_all(REAL / "example.brdf")
    assert (found.name, found.wavelengths_nm.tolist()) == ("SRT1", [550.0, 650.0, 750.0, 850.0])
    np.testing.assert_allclose(found.values, [[0.2585, 0.27, 0.288, 0.2985]])
    for k, one in enumerate((found, readings(0.02))):
        bird.write(tmp_path / f"{k}.json", one, "measurement")
        assert list(validator.iter_errors(json.loads((tmp_path / f"{k}.json").read_text()))) == []
