"""Words of messages."""

from __future__ import annotations

import pytest

from manifold.core.names import names_like


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("satin", "did you mean satin_blue, Satin_red?"),
        ("FELT", "did you mean felt?"),
        ("Satin_bleu", "did you mean satin_blue, Satin_red?"),
        ("l", "it holds felt, satin_blue, Satin_red, paper, copper and 1 more"),  # in too many names
        ("qqq", "it holds felt, satin_blue, Satin_red, paper, copper and 1 more"),
        ("", "it holds felt, satin_blue, Satin_red, paper, copper and 1 more"),
    ],
)
def test_names_that_contain_a_word_or_are_close_to_it_are_offered(name, expected):
    assert (
        names_like(["felt", "satin_blue", "Satin_red", "paper", "copper", "gold", "felt"], name) == expected
    )
