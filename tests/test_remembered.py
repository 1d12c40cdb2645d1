"""Values kept in the user's cache folder."""

from __future__ import annotations

import os

import pytest

from manifold.system.remembered import cache_folder, remembered


@pytest.fixture
def computed(tmp_path, monkeypatch):
    """The cache folder in a temporary place, and a function that counts how often it computes."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    calls = []

    def compute():
        calls.append(1)
        return {"a": [0.1, 1e-300]}

    return calls, compute


def test_values_are_computed_once_per_key_and_kept_exactly(computed):
    calls, compute = computed
    for key, times in (("1", 1), ("1", 1), ("2", 2)):
        assert remembered("x.json", key, compute) == {"a": [0.1, 1e-300]}
        assert len(calls) == times


@pytest.mark.parametrize("damage", [b"", b"\xff", b"no digest\n{}"])
def test_a_damaged_file_is_computed_again(computed, damage):
    calls, compute = computed
    remembered("x.json", "1", compute)
    (cache_folder() / "x.json").write_bytes(damage)
    assert remembered("x.json", "1", compute) == {"a": [0.1, 1e-300]}
    assert len(calls) == 2


def test_a_folder_that_cannot_be_written_costs_time_only(computed):
    calls, compute = computed
    cache_folder().write_text("in the way")
    assert remembered("x.json", "1", compute) == remembered("x.json", "1", compute)
    assert len(calls) == 2


def test_a_pipe_in_place_of_the_file_is_not_waited_for(computed):
    calls, compute = computed
    cache_folder().mkdir()
    os.mkfifo(cache_folder() / "x.json")
    assert remembered("x.json", "1", compute) == {"a": [0.1, 1e-300]}
    assert len(calls) == 1


def test_the_home_of_an_unknown_user_is_a_folder_like_any_other(computed, tmp_path, monkeypatch):
    _, compute = computed
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "~nobody_of_this_name")
    assert remembered("x.json", "1", compute) == {"a": [0.1, 1e-300]}
