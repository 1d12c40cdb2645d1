"""Check the English of documents, docstrings' first paragraphs and the strings that users see.

Patterns find sentences that are hard to read: inverted order, clauses with "what" for nouns, "where" for "if".

    python tools/prose.py            names every place that has a pattern; exits with 1 if there are any
    python tools/prose.py --counts   prints the number of places by pattern
    python tools/prose.py --strings  prints all strings that users see: help, messages, notes, headings, the page

A folder as the last argument is another checkout. Mark an exception at the end of its line: `# prose: ok` in Python
and JavaScript, `<!-- prose: ok -->` in Markdown.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

_NOUNS = (
    "band|button|cell|channel|column|command|core|direction|file|fold|format|group|job|light|line|material|module|"
    "number|output|page|panel|picture|pixel|place|point|process|row|sample|sentence|step|subject|target|task|thread|value|word"
)
_ASKING = re.compile(
    r"\b(ask|decid|explain|guess|know|matter|say|see|show|tell|understand)\w*:? $", re.IGNORECASE
)
"""Verbs before an indirect question, in which "what" is right."""

WHAT, SAME_AS, NO_VERB = "what as a noun", "the same as", "docstring without a verb"
PATTERNS = {
    "begins with Of or From": (r"^(?:Of|From) (?!here\b|now\b)", "begin with the subject"),
    WHAT: (
        r"\b[Ww]hat (?:is|was|are|were|has|had|have|it|they|the|an?|this|that|can|could|may|does|did|made|makes|says|"
        r"said|lies|lay|stands|follows|remains|differs|others?|users?|you|[a-z]+s)\b(?!.*\?)",
        "name the thing: the written values, not what was written",
    ),
    "ends in too, alone, either or so": (
        r"(?:, so|\b(?:too|alone|either))(?= *[.;:)]?$)",
        "also, only, neither",
    ),
    "such as are": (r"\b(?:such as (?:are|is|have|has)|as (?:are|is) those)\b", "those that, like"),
    SAME_AS: (r"^(?:The same|As (?:of |in |for )?(?:the |`)|Likewise|Ditto)", "say what this one does"),
    "a line a file": (rf"\b(?:an?|one|two|three|\d+) (?:{_NOUNS})s? an? (?:{_NOUNS})\b", "a line per file"),
    "where for if": (
        r"^Where (?!to\b|do\b|is\b|are\b|it fails$)|"
        r"\b(?:where|when) (?:there (?:is|are|was|were) (?:none|no\b)|none\b|nothing\b)",
        "if",
    ),
    "words that English lacks": (
        r"\b(?:anew|stead|hereof|thereof|wherein|of before|as good as|so many times|some of which|and be it)\b",
        "again, in place of",
    ),
    NO_VERB: (r"(?!)", "Return, Write, Read"),  # found by its first word
}
"""What to find, and what to write instead. Patterns look at single sentences."""

_NO_VERB = re.compile(
    r"(?:The|An?|What|Whether|How|Which|Whose|Those|That|These|This|As|Of|From|Where|In|By|On|At|For|With|All|Every|"
    r"Some|No|None|Nothing|One|Two|Values?|Weights?|Directions?|`)\b",
)
_OK = "prose: ok"
_WORDS = re.compile(r"[A-Za-z]{2,}")


class Text(NamedTuple):
    """A text with its place, and its kind: a document, a docstring, or a string that users see."""

    path: Path
    line: int
    kind: str
    words: str
    is_function: bool = False


class Finding(NamedTuple):
    """A sentence that has a pattern."""

    text: Text
    pattern: str
    sentence: str


def documents(root: Path) -> Iterator[Text]:
    """Yield the paragraphs, list entries and table cells of the documents, without code."""
    files = [*root.glob("*.md"), *sorted((root / "docs").rglob("*.md"))]
    for path in files:
        if {"_build", "_work", "gallery"} & set(path.parts) or path.name in ("api.md", "commands.md"):
            continue
        kept, start, in_code = list[str](), 0, False
        for number, line in enumerate([*path.read_text(encoding="utf-8").split("\n"), ""], start=1):
            bare = line.strip()
            is_fence = bare.startswith(("```", "~~~", ":::", "$$"))
            in_code ^= is_fence and not bare.startswith(":::")
            is_new = bare.startswith(("*", "-", "#", "|", ">")) or re.match(r"\d+\. ", bare) is not None
            if (is_fence or in_code or not bare or is_new or line.startswith("    ")) and kept:
                yield Text(path, start, "document", " ".join(kept))
                kept = []
            if is_fence or in_code or not bare or line.startswith("    ") or _OK in line:
                continue
            if bare.startswith("|"):
                yield from (
                    Text(path, number, "document", _plain(cell)) for cell in bare.strip("|").split("|")
                )
                continue
            start = start if kept else number
            kept.append(_plain(re.sub(r"^(?:[*#>-]+|\d+\.)\s+", "", bare)))


def _plain(text: str) -> str:
    text = re.sub(r"<!--.*?-->|<[^>]+>", "", text)
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).strip()


def python_texts(root: Path) -> Iterator[Text]:
    """Yield the first paragraphs of docstrings in the package and `cli`, and strings of three words or more."""
    for path in sorted([*(root / "manifold").rglob("*.py"), *(root / "cli").rglob("*.py")]):
        source = path.read_text(encoding="utf-8")
        lines, tree = source.split("\n"), ast.parse(source)
        docstrings = set[int]()
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            for statement in body if isinstance(body, list) else ():
                value = statement.value if isinstance(statement, ast.Expr) else None
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    docstrings.add(id(value))
                    is_first = statement is body[0] and isinstance(node, ast.FunctionDef)
                    is_property = any(
                        "property" in ast.unparse(d) for d in getattr(node, "decorator_list", ())
                    )
                    words = " ".join(value.value.strip().partition("\n\n")[0].split())
                    yield Text(path, value.lineno, "docstring", words, is_first and not is_property)
        inner = {
            id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values
        }
        for node in ast.walk(tree):
            if id(node) in docstrings | inner or not isinstance(node, ast.Constant | ast.JoinedStr):
                continue
            words = " ".join(_joined(node).split())
            if (
                len(_WORDS.findall(words)) < 3
                or " " not in words
                or re.search(r"\\[bdswW]|\(\?|</|;$|^[{<]", words)
            ):
                continue
            if any(_OK in line for line in lines[node.lineno - 1 : node.end_lineno]):
                continue
            yield Text(path, node.lineno, "string", words)


def _joined(node: ast.AST) -> str:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return "".join(
        part.value if isinstance(part, ast.Constant) else "{}" for part in getattr(node, "values", ())
    )


def page_texts(root: Path) -> Iterator[Text]:
    """Yield the strings of the page: quoted ones of its scripts, and the text of its HTML."""
    for path in sorted((root / "manifold" / "page").glob("*")):
        if path.suffix not in (".js", ".html"):
            continue
        is_script = path.suffix == ".js"
        pattern = r"(['\"`])((?:(?!\1).){6,}?)\1" if is_script else r"(>|title=\"|aria-label=\")([^<>\"]{6,})"
        for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), start=1):
            if _OK in line or line.strip().startswith(("//", "*", "/*")):
                continue
            for _, found in re.findall(pattern, line):
                words = re.sub(r"\$\{.*?\}", "{}", found)
                if len(_WORDS.findall(words)) >= 3 and " " in words.strip():
                    yield Text(path, number, "string", words.strip())


def sentences(text: str) -> list[str]:
    """Split a text into sentences and clauses behind semicolons."""
    return [part.strip() for part in re.split(r"(?<=[.!?])\s+(?=[A-Z`*])|(?<=;)\s+", text) if part.strip()]


def find(texts: Iterator[Text]) -> Iterator[Finding]:
    """Yield the sentences that have a pattern."""
    for text in texts:
        if text.is_function and _NO_VERB.match(text.words):
            yield Finding(text, NO_VERB, text.words)
        for sentence in sentences(text.words):
            for name, (pattern, _) in PATTERNS.items():
                if name == SAME_AS and text.kind != "docstring":
                    continue
                found = re.search(pattern, sentence)
                if found and not (name == WHAT and _ASKING.search(sentence[: found.start()])):
                    yield Finding(text, name, sentence)


def main() -> int:
    """Print findings, counts or strings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument("--counts", action="store_true")
    parser.add_argument("--strings", action="store_true")
    options = parser.parse_args()
    root: Path = options.root
    seen = [text for text in (*python_texts(root), *page_texts(root)) if text.kind == "string"]
    if options.strings:
        print("\n".join(f"{text.path.relative_to(root)}:{text.line}: {text.words}" for text in seen))
        return 0
    findings = [*find(documents(root)), *find(python_texts(root)), *find(page_texts(root))]
    if options.counts:
        counts = Counter((each.pattern, each.text.kind) for each in findings)
        for name in PATTERNS:
            print(
                name,
                *(f"{kind}s {counts[name, kind]}" for kind in ("document", "docstring", "string")),
                sep="\t",
            )
        print(f"{len(seen)} strings that users see")
        return 0
    for each in findings:
        where = f"{each.text.path.relative_to(root)}:{each.text.line}"
        print(f"{where}: {each.pattern} ({PATTERNS[each.pattern][1]}): {each.sentence[:160]}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
