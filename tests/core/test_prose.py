"""The check of English: it finds the patterns that the house style names, and no plain sentence."""

from __future__ import annotations

from pathlib import Path

import prose
import pytest


def patterns(words: str, *, kind: str = "string", is_function: bool = False) -> list[str]:
    text = prose.Text(Path("file"), 1, kind, words, is_function)
    return [finding.pattern for finding in prose.find(iter([text]))]


@pytest.mark.parametrize(
    ("words", "pattern"),
    [
        ("Of several materials, the folder.", "begins with Of or From"),
        ("Copy a link to what is shown", "what as a noun"),
        ("--instrument restricts the directions; give --suggest K, too", "ends in too, alone, either or so"),
        ("A file has a line a picture.", "a line a file"),
        ("Where its picture is clipped, lamps stand there.", "where for if"),
        ("None where there is none.", "where for if"),
        ("Models of before are embedded again.", "words that English lacks"),
    ],
)
def test_hard_sentences_are_found(words, pattern):
    assert pattern in patterns(words)


@pytest.mark.parametrize(
    "words", ["The same with a refusal as an error.", "As `write_output`, but raise on refusal."]
)
def test_docstrings_that_lean_on_another_are_found(words):
    assert "the same as" in patterns(words, kind="docstring")
    assert "docstring without a verb" in patterns(words, kind="docstring", is_function=True)


@pytest.mark.parametrize(
    "words",
    [
        "For several materials, the folder.",
        "The command says what it found, and what to do.",
        "What does a diagnostic mean?",
        "One file per line; an error names the file, and the line if there is one.",
        "Return the posterior mean at new latent points.",
    ],
)
def test_plain_sentences_pass(words):
    assert patterns(words, kind="docstring", is_function=words.startswith("Return")) == []


def test_strings_that_users_see_are_extracted(tmp_path):
    (tmp_path / "cli").mkdir()
    (tmp_path / "manifold" / "page").mkdir(parents=True)
    (tmp_path / "cli" / "a.py").write_text(
        '"""Docstring of the module."""\n\nname = "x"\n\n\n'
        'def f(n):\n    raise ValueError(f"found {n} files, " "expected one")\n'
        'HELP = "Of no use here, too"  # prose: ok\n'
    )
    (tmp_path / "manifold" / "page" / "page.html").write_text("<p>Drag the point over the map</p>\n")
    texts = [*prose.python_texts(tmp_path), *prose.page_texts(tmp_path)]
    strings = [text.words for text in texts if text.kind == "string"]
    assert strings == ["found {} files, expected one", "Drag the point over the map"]


def test_code_of_documents_is_no_prose(tmp_path):
    (tmp_path / "README.md").write_text(
        "# Title\n\nSome words here.\n\n```sh\nOf code\n```\n\n* An entry\n  of two lines\n"
    )
    assert [text.words for text in prose.documents(tmp_path)] == [
        "Title",
        "Some words here.",
        "An entry of two lines",
    ]
