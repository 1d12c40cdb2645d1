"""Progress of a whole is told in shares that never fall, and ends at all of it."""

from __future__ import annotations

import time

import pytest
from helpers.small_library import small_model

from manifold.cli import terminal
from manifold.core import progress
from manifold.core.progress import Stages
from manifold.estimate.sources import PlaceSource
from manifold.fit import exporting
from manifold.pictures import renders
from manifold.render.render import RenderSettings


def test_shares_of_stages_add_up():
    heard = []
    with progress.listen(lambda *step: heard.append(step)):
        stages = Stages({"read": 3, "fit": 1})
        stages.begin("read")
        for _ in progress.each("ab"):
            progress.report(1, 7, "what the loop knows better")
        stages.begin("fit")
        progress.report(1, 1, "valley")
    assert heard == [
        (0, 100, "read"), (38, 100, "read"), (75, 100, "read"), (75, 100, "fit"), (100, 100, "fit: valley"),
    ]  # fmt: skip


def test_nobody_is_told_where_nobody_listens():
    Stages({"read": 1}).begin("read")
    progress.report(1, 2, "nothing")
    assert list(progress.each([1, 2])) == [1, 2]


def test_a_loop_that_ends_early_or_fails_leaves_the_listener_as_it_was():
    heard = []
    with progress.listen(lambda *step: heard.append(step)):
        for _ in progress.each("ab", "letters"):
            break
        progress.report(1, 2, "after a break")
        with pytest.raises(ValueError, match="a"):
            [int(letter) for letter in progress.each("ab", "letters")]
        progress.report(2, 2, "after an error")
    assert [what for _, _, what in heard] == ["after a break", "after an error"]


@pytest.mark.parametrize(
    ("name", "stages"),
    [
        ("render", ["rendering"]),
        ("export", ["reading materials", "fitting: refinement", "evaluating the target's model"]),
    ],
    ids=lambda value: str(value)[:6],
)
def test_commands_tell_what_they_are_at(tmp_path, name, stages):
    pytest.importorskip("mitsuba")
    model, heard = small_model(tmp_path), []
    place = PlaceSource(model, [0.1, 0.2])
    with progress.listen(lambda *step: heard.append(step)):
        if name == "render":
            renders.render(place, tmp_path / "a.png", RenderSettings(size=32))
        else:
            exporting.export(place, None, tmp_path / "a.glb")
    shares = [done / total for done, total, _ in heard]
    assert shares == sorted(shares)
    assert len(set(shares)) >= 4
    for stage in stages:
        assert any(what.startswith(stage) for _, _, what in heard), stage


def test_where_stderr_is_no_terminal_each_stage_has_one_line(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "_last_text", "")
    monkeypatch.setattr(terminal, "_QUICK_SECONDS", 0.0)
    monkeypatch.setattr(terminal, "_SILENT_SECONDS", 0.05)
    with terminal.display("Working", in_bytes=False) as step:
        time.sleep(0.3)  # without a step
        step(1, 2, "first half")
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["Working", "Working: 1 of 2, first half"]
    monkeypatch.setattr(terminal, "_SILENT_SECONDS", 1e3)
    with terminal.display("Working", in_bytes=False) as step:
        time.sleep(0.1)
    assert not capsys.readouterr().err
