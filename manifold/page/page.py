"""The self-contained page of a map: script, style and data in a single file."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable
from importlib.resources import files
from typing import Any

_MODULES = (
    "colour", "numerics", "elements", "webgl", "blend", "shapes", "ground", "difference", "ball", "layout", "map",
    "plots", "state", "facts", "tabs", "photo", "controls", "documents", "guests", "kept_looks", "attributes", "served",
    "explorer",
)  # fmt: skip  # a module after what it imports
_BODY = re.compile(r'<body class="explorer">(.*)</body>', re.DOTALL)
_IMPORT = re.compile(r"^import .*?;\n", re.MULTILINE | re.DOTALL)
_EXPORT = re.compile(r"^export (?=(async )?(function|class|const|let) )", re.MULTILINE)


def make_page(document: dict[str, Any]) -> str:
    """Return the page as HTML from the JSON of `page_data.to_document`.

    The document's `served` is set if a server answers the page's requests.
    """
    connect = "'self'" if document.get("served") else "'none'"
    return fill_page(_source("page.html"), page_script(), _source("style.css"), document, connect=connect)


def fill_page(
    template: str, script: str, style: str, document: dict[str, Any], *, connect: str = "'none'"
) -> str:
    """Return a page in one file, which may run only its own script and style, and by default connect to nothing."""
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
    parts = {"POLICY": policy, "STYLE": style, "DATA": _json_in_html(document), "SCRIPT": script}
    return re.sub(r"@(POLICY|STYLE|DATA|SCRIPT)@", lambda found: parts[found[1]], template)


def page_script() -> str:
    """Return the script of the page."""
    return _joined("start")


def widget_module() -> str:
    """Return the page's script as an ES module with which anywidget shows the page in a notebook."""
    body = re.sub(r"<script.*?</script>", "", _body(), flags=re.DOTALL)
    constants = f"const STYLE = {json.dumps(_source('style.css'))}, BODY = {json.dumps(body)};\n"
    return constants + _joined("widget")


def _body() -> str:
    found = _BODY.search(_source("page.html"))
    assert found is not None
    return found[1]


def _joined(last: str) -> str:
    """Join the modules, in the order in which they need each other."""
    return joined_modules((*_MODULES, last))


def joined_modules(names: Iterable[str], last: str = "") -> str:
    """Join modules of this folder, then a script, into one script; each module must follow those that it imports."""
    texts = [*(_source(f"{name}.js") for name in names), last]
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", text)) for text in texts)


def _source(name: str) -> str:
    return files("manifold.page").joinpath(name).read_text(encoding="utf-8")


def _json_in_html(document: dict[str, Any]) -> str:
    """Return JSON that cannot close the HTML element around it, whatever names it holds."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
