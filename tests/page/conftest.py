"""A small map, its page, and a browser, for tests of the explorer."""

from __future__ import annotations

import pytest
from helpers.browser import chromium
from helpers.small_library import small_model


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    """A map of blends of a few RGB materials."""
    from manifold.model.manifold import Manifold

    return Manifold.load(small_model(tmp_path_factory.mktemp("map")))


@pytest.fixture(scope="session")
def document(model):
    """What a page of the map is told."""
    from manifold.page.page_data import tabulate, to_document

    return to_document(model, tabulate(model))


@pytest.fixture(scope="session")
def address(document, tmp_path_factory):
    """The page as a file."""
    from manifold.page.page import make_page

    page = tmp_path_factory.mktemp("page") / "map.html"
    page.write_text(make_page(document), encoding="utf-8")
    return page.as_uri()


@pytest.fixture(scope="module")
def browser():
    """Chromium, or skipped tests."""
    with chromium() as started:
        yield started
