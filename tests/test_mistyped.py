"""Values of options that are no number, out of range or no choice, of every command that has such options."""

from __future__ import annotations

import inspect
from typing import Literal, get_origin

import pytest
import typer
from small_library import small_library, small_model

from manifold.cli.main import app
from manifold.cli.mistyped import kind_of
from manifold.system.names import names_like


def _typed_options():
    """Command, option and kind of every option that takes numbers or one of a few words."""
    for name, command in typer.main.get_command(app).commands.items():
        signature = inspect.signature(command.callback, eval_str=True)
        for parameter in command.params:
            kind = kind_of(signature.parameters[parameter.name].annotation)
            if kind in (int, float) or get_origin(kind) is Literal:
                yield pytest.param(name, parameter.opts[0], kind, id=f"{name} {parameter.opts[0]}")


@pytest.mark.parametrize(("command", "option", "kind"), list(_typed_options()))
def test_a_value_of_another_kind_is_told_what_was_expected(run, tmp_path, command, option, kind):
    status, out, err = run(command, f"{option}=fo o", cwd=tmp_path)
    expected = {int: "a whole number", float: "a number"}.get(kind, "one of ")
    assert (status, out) == (2, "")
    assert err.startswith(f"manifold: {option} 'fo o': expected {expected}")
    assert err.endswith(f"; see `manifold {command} --help`\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "--size", "1"], "--size '1': expected a whole number from 16 to 8192"),
        (["corpus", "x", "--seed", "-1"], "--seed '-1': expected a whole number from 0;"),
        (["fit", "--metric", "cube"], "expected one of cube-root, linear, log;"),
    ],
)
def test_ranges_and_choices_are_in_the_message(run, tmp_path, arguments, words):
    assert words in run(*arguments, cwd=tmp_path)[2]


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["import", ""], "SOURCE"),
        (["import", "x", "", "-L", "l.zarr"], "SOURCE"),
        (["import", "x", "-L", ""], "--library"),
        (["corpus", ""], "FOLDER"),
        (["info", "--json="], "--json"),
        (["predict", "--latent", "0,0", "-o", ""], "--output"),
    ],
)
def test_empty_paths_are_refused_and_not_the_current_folder(run, tmp_path, arguments, name):
    command = f"see `manifold {arguments[0]} --help`"
    assert run(*arguments, cwd=tmp_path) == (2, "", f"manifold: {name} '': expected a path; {command}\n")
    assert list(tmp_path.iterdir()) == []


def test_arguments_that_are_missing_are_named(run, tmp_path):
    status, _, err = run("corpus", cwd=tmp_path)
    assert status == 2
    assert "Missing argument 'FOLDER'" in err


@pytest.mark.parametrize("command", [["report"], ["chart", "-L", "library.zarr"]])
def test_a_mistyped_anchor_is_refused_before_the_work(run, tmp_path, monkeypatch, command):
    from manifold.experiments.chart.held_out import HeldOut
    from manifold.experiments.evaluation import report

    small_model(tmp_path) if command == ["report"] else small_library(tmp_path)

    def work(*_, **__):
        raise AssertionError("began to work")

    monkeypatch.setattr(HeldOut, "__init__", work)
    monkeypatch.setattr(report, "_tabulate", work)
    status, _, err = run(*command, "--anchor", "absent.zip", cwd=tmp_path)
    assert status == 2
    assert err.startswith("manifold: absent.zip: no such file or folder")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("satin", "did you mean satin_blue, Satin_red?"),
        ("FELT", "did you mean felt?"),
        ("Satin_bleu", "did you mean satin_blue, Satin_red?"),
        ("qqq", "it holds felt, satin_blue, Satin_red, paper, copper and 1 more"),
        ("", "it holds felt, satin_blue, Satin_red, paper, copper and 1 more"),
    ],
)
def test_names_that_contain_a_word_or_are_close_to_it_are_offered(name, expected):
    assert (
        names_like(["felt", "satin_blue", "Satin_red", "paper", "copper", "gold", "felt"], name) == expected
    )
