"""What a page is told: tables that predict as the package does, in a file that asks for nothing."""

from __future__ import annotations

import base64
import gzip
import json
import re

import numpy as np
import pytest
from helpers.small_library import NAMES, small_library, small_model

from manifold.colour import ball_colours
from manifold.core.directions import to_rusinkiewicz
from manifold.core.errors import UsageError
from manifold.core.judged_lights import BALL
from manifold.library.store import Library
from manifold.model.manifold import Manifold, Settings
from manifold.page import explore, page_data
from manifold.page.page import make_page, page_script, widget_module
from manifold.page.page_data import error_field
from manifold.page.tabulated_pairs import (
    GRID_SHAPE,
    THETA_D_SHARE,
    THETA_H_MAX_RAD,
    THETA_H_POWER,
    grid_directions,
    largest_theta_d,
    tabulated_pairs,
)


@pytest.fixture(scope="module")
def tabulated(model):
    return page_data.tabulate(model)


def grid_coordinates(wi, wo):
    """Positions of pairs on the page's grid, in nodes along each axis: the inverse of `grid_directions`."""
    theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
    phi_d = np.abs(phi_d)
    h = np.clip(theta_h / THETA_H_MAX_RAD, 0.0, 1.0) ** (1.0 / THETA_H_POWER)
    d = np.clip(theta_d / largest_theta_d(theta_h, phi_d) / THETA_D_SHARE, 0.0, 1.0)
    return [a * (n - 1) for a, n in zip((h, d, phi_d / np.pi), GRID_SHAPE, strict=True)]


def interpolated(values, wi, wo):
    """Values (P, C) on the grid at other pairs, trilinear: what the page's texture does, slow and obvious."""
    at = grid_coordinates(wi, wo)
    table, total = values.reshape(*GRID_SHAPE, -1), 0.0
    low = [np.minimum(a.astype(int), n - 2) for a, n in zip(at, GRID_SHAPE, strict=True)]
    for corner in np.ndindex(2, 2, 2):
        share = np.prod([np.abs(1 - c - (a - k)) for a, k, c in zip(at, low, corner, strict=True)], axis=0)
        total = total + share[:, None] * table[tuple(k + c for k, c in zip(low, corner, strict=True))]
    return total


def test_no_pair_of_the_page_is_below_the_horizon():
    pairs = tabulated_pairs()
    assert np.all(pairs.wi[:, 2] > 0)
    assert np.all(pairs.wo[:, 2] > 0)
    assert np.all(np.isfinite(pairs.amplitude))


def test_the_grid_finds_its_own_nodes_again():
    found = np.stack(grid_coordinates(*grid_directions()), axis=1)
    expected = np.stack([a.ravel() for a in np.indices(GRID_SHAPE)], axis=1)
    has_azimuth = expected[:, 1] > 0
    inner = expected[:, 0] > 2  # nearer to the normal, angles of vectors in double precision lose digits
    assert np.allclose(found[inner, :2], expected[inner, :2], atol=1e-3)
    assert np.allclose(found[inner & has_azimuth, 2], expected[inner & has_azimuth, 2], atol=1e-3)


def test_an_integrating_sphere_of_the_page_measures_a_white_diffuser():
    pairs = tabulated_pairs()
    assert np.sum(pairs.sphere_measure) / np.pi == pytest.approx(1.0, abs=0.01)  # 20 x 20 nodes


def unpacked(document, shape):
    """Components (N, R, P) as a page decodes them."""
    N, R, P = shape
    first, steps = (gzip.decompress(base64.b64decode(document[key])) for key in ("first", "ratios"))
    first = np.frombuffer(first, "<f2").reshape(N, 1, P).astype(np.float32)
    steps = np.frombuffer(steps, np.int8).reshape(N, R - 1, P)
    scale = np.array(document["scales"], np.float32).reshape(N, R - 1, 1)
    return np.concatenate([first, first * steps * (scale / 127.0)], axis=1)


def test_a_ball_from_packed_tables_is_the_ball_of_the_prediction(model, tabulated, rng):
    packed = json.loads(json.dumps(page_data.packed(tabulated.components)))
    components = unpacked(packed, tabulated.components.shape)[..., : tabulated.pairs.n_grid]
    ball = ball_colours.ball()
    cosines = np.cbrt(ball.wi[:, 2] * ball.wo[:, 2])[:, None]
    errors = []
    for shares in rng.dirichlet(np.ones(len(NAMES)), 10):
        x = shares @ model.X
        roots = np.tensordot(model.weights(x), components, axes=1).T @ tabulated.basis.T
        f = (interpolated(roots, ball.wi, ball.wo) / cosines) ** 3
        expected = model.predict(x).eval(ball.wi, ball.wo)
        errors.append(ball_colours.delta_e(ball.xyz(f, model.bands), ball.xyz(expected, model.bands)))
    assert np.mean(errors) < 0.5  # measured 0.1 on real files; the target of the page is 1.0


def test_the_page_has_the_expected_errors_of_known_and_of_blended_colours(model):
    loaded = Manifold.load(model.library.path.parent / "model.h5")
    field = error_field(loaded)
    place = np.array(field["low"])  # the first node
    for name, is_known in (("values", True), ("blended", False)):
        expected = float(loaded.left_out.expected(place, is_colour_known=is_known).ball)
        assert field[name][0] == pytest.approx(expected, abs=1e-3)  # three decimals
    assert np.median(field["blended"]) > np.median(field["values"])


def test_expected_errors_of_few_materials_are_called_coarse_on_the_page(model, monkeypatch):
    loaded = Manifold.load(model.library.path.parent / "model.h5")
    assert error_field(loaded)["unit"] == f"{BALL}; coarse, known from {len(NAMES)} materials"
    monkeypatch.setattr("manifold.page.page_data.COARSE_BELOW", len(NAMES))
    assert error_field(loaded)["unit"] == BALL


def test_only_maps_of_blends_have_a_page(tmp_path):
    library = Library.open(small_library(tmp_path))
    model = Manifold.fit(library, Settings(kind="material"), calibrate=False)
    with pytest.raises(UsageError, match="kind gplvm, expected blend"):
        page_data.tabulate(model)


def test_a_page_is_one_file_that_asks_for_nothing(tmp_path):
    page = tmp_path / "map.html"
    size = explore.write_page(small_model(tmp_path), page)
    text = page.read_text(encoding="utf-8")
    assert size == page.stat().st_size < 8e6
    addresses = set(re.findall(r"https?://[^\s\"'`]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}  # a name space, not an address
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert "default-src 'none'" in policy
    assert "connect-src 'none'" in policy
    assert "unsafe" not in policy


def test_names_cannot_close_the_element_that_holds_them():
    page = make_page({"names": ["</script><script>alert(1)</script>", "<!--", "&amp;", "@STYLE@"]})
    assert page.count("<script") == 2
    assert page.count("</script>") == 2
    assert "<!--" not in page
    held = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1]
    assert json.loads(held)["names"][0] == "</script><script>alert(1)</script>"
    assert json.loads(held)["names"][3] == "@STYLE@"


def test_the_script_puts_no_text_into_the_page_as_markup():
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", page_script() + widget_module()
    )
