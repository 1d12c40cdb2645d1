"""Formulas as HTML: KaTeX converts them when the site is built, so that pages need no script and no network."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

from docutils import nodes
from sphinx.errors import ExtensionError

HERE = Path(__file__).resolve().parent
MODULES = Path(sys.prefix) / "node_modules"  # where tools/setup.sh installs KaTeX
DIST = MODULES / "katex" / "dist"


@cache
def _katex() -> subprocess.Popen[str]:
    """Return the running converter. Raises ExtensionError if Node.js or KaTeX is missing."""
    node = shutil.which("node")
    if node is None or not DIST.is_dir():
        raise ExtensionError(
            "Node.js or KaTeX is missing: run `tools/setup.sh docs` (Debian: apt install npm)"
        )
    return subprocess.Popen(
        [node, str(HERE / "katex.cjs")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env={"NODE_PATH": str(MODULES)},
    )


def to_html(tex: str, *, display: bool) -> str:
    """Return a formula as HTML with MathML beside it for screen readers. Raises ExtensionError if KaTeX refuses it."""
    katex = _katex()
    assert katex.stdin is not None
    assert katex.stdout is not None
    print(json.dumps({"tex": tex, "display": display}), file=katex.stdin, flush=True)
    answer = json.loads(katex.stdout.readline())
    if "error" in answer:
        raise ExtensionError(f"formula {tex!r}: {answer['error']}")
    return answer["html"]


def visit(page: object, node: nodes.math | nodes.math_block) -> None:
    """Write a formula into a page of Sphinx's HTML writer."""
    tex = node.astext()
    if isinstance(node, nodes.math_block):
        page.body.append('<div class="formula">')
        page.body += [to_html(part, display=True) for part in parts_of(tex)]
        page.body.append("</div>")
    else:
        page.body.append(to_html(tex, display=False))
    raise nodes.SkipNode


def parts_of(tex: str) -> list[str]:
    r"""Return the equations of a display between `\qquad`, which a narrow page shows one below the other."""
    parts = tex.split(r"\qquad")
    are_whole = all(part.count("{") == part.count("}") and r"\begin" not in part for part in parts)
    return parts if are_whole else [tex]


def copy_styles(target: Path) -> None:
    """Copy KaTeX's style sheet and fonts into a folder."""
    (target / "fonts").mkdir(parents=True, exist_ok=True)
    shutil.copy(DIST / "katex.min.css", target)
    for font in (DIST / "fonts").glob("*.woff2"):
        shutil.copy(font, target / "fonts")
