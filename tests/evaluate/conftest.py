"""A short search for few atoms, for reports and charts that do not look at how good they are."""

from __future__ import annotations

import pytest

from manifold.model import reconstruction


@pytest.fixture(scope="module")
def short_search():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reconstruction, "_CANDIDATES", 6)
        patch.setattr(reconstruction, "_SWEEPS", 1)
        yield
