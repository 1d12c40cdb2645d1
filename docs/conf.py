"""Sphinx configuration: the pages are Markdown; tutorials and gallery scripts run in the build."""

from __future__ import annotations

import csv
import importlib
import inspect
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import typer
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

from manifold import __version__
from manifold.cli.main import app

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE / "examples")]
from figures import RESULTS  # noqa: E402  # beside this file

WORK = HERE / "_work"  # library and model of the gallery, kept between builds

project = "manifold"
author = "The manifold developers"
copyright = "The manifold developers, MIT licence"
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = [
    "_build",
    "_work",
    "**/GALLERY_HEADER.rst",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
    "gallery/*.ipynb",
    "paper/*",
    "examples/*",
]
suppress_warnings = ["config.cache"]  # sphinx_gallery_conf holds a function
nitpicky = False

html_math_renderer = "mathml"  # by the browser, without a script from the network
html_theme = "pydata_sphinx_theme"
html_title = "manifold"
html_extra_path = ["_work/extra"]  # the explorer of the corpus, embedded in the gallery
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_in_temp = True  # tutorials run in an empty folder, as their readers'
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"  # progress of commands
nb_execution_cache_path = str(WORK / "notebooks")

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = ["Source"]

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "ignore_pattern": "balls",
    "image_scrapers": ("matplotlib",),
    "remove_config_comments": True,
    "show_memory": False,
    "download_all_examples": False,
    "within_subsection_order": "FileNameSortKey",
    "min_reported_time": 1e9,
}


def _write_commands(*_: object) -> None:
    """The reference of the command line, from the commands themselves: reference/commands.md."""
    lines = ["# Commands", "", "Every command has `--help`, which shows what stands here.", ""]
    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        context = type(command).context_class(command, info_name=f"manifold {name}")
        help_text = command.get_help(context)
        lines += [f"## {name}", "", "```text", help_text.rstrip(), "```", ""]
    _write_if_changed(HERE / "reference" / "commands.md", "\n".join(lines))


def _examples() -> dict[str, str]:
    """Return the examples of names, from reference/examples.py, by full name."""
    text = (HERE / "reference" / "examples.py").read_text(encoding="utf-8")
    parts = re.split(r"^# (manifold(?:\.\w+)+)$", text, flags=re.MULTILINE)
    return {name: code.strip() for name, code in zip(parts[1::2], parts[2::2], strict=True)}


def _write_api(*_: object) -> None:
    """Write the reference of the Python interface, from its docstrings and examples: reference/api.md."""
    lines = [
        "# Python reference",
        "",
        "Signatures, parameters and examples of the names that stay the same between versions. The examples run in "
        "this order; `manifold corpus corpus --rgb` writes the files of `corpus`.",
        "",
    ]
    examples = _examples()
    for stub in sorted((HERE.parent / "manifold").rglob("__init__.pyi")):
        package = ".".join(stub.parent.relative_to(HERE.parent).parts)
        module = importlib.import_module(package)
        lines += [f"## {package}", ""]
        for name in sorted(module.__all__, key=str.lower):
            value, full = getattr(module, name), f"{package}.{name}"
            lines += [f"### {name}", ""]
            if inspect.ismodule(value):
                lines += [inspect.getdoc(value) or "", ""]
                own = {} if hasattr(value, "__path__") else vars(value)
                members = {k: v for k, v in own.items() if getattr(v, "__module__", "") == value.__name__}
            else:
                members = {name: value} if callable(value) else {}
                lines += [] if members else [f"Every {value.what}, by name.", ""]
            for member, found in members.items():
                if callable(found) and not member.startswith("_") and inspect.getdoc(found):
                    kind = "autoclass" if inspect.isclass(found) else "autofunction"
                    place = f"{value.__name__}.{member}" if inspect.ismodule(value) else full
                    requests = ", ".join(
                        name for name in dir(found) if re.fullmatch(r"set_\w+_request", name)
                    )
                    options = (
                        ["   :members:", f"   :exclude-members: {requests}"] if kind == "autoclass" else []
                    )
                    lines += ["```{eval-rst}", f".. {kind}:: {place}", *options, "```", ""]
            lines += ["```python", examples[full], "```", ""]
    _write_if_changed(HERE / "reference" / "api.md", "\n".join(lines))


def _write_if_changed(target: Path, text: str) -> None:
    if not target.exists() or target.read_text(encoding="utf-8") != text:
        target.write_text(text, encoding="utf-8")


def _write_failure_modes(*_: object) -> None:
    """The table of failure modes, from the results of `manifold stability`: explanation/failure-modes.csv."""
    kept = json.loads((RESULTS / "stability.json").read_text(encoding="utf-8"))
    rows = []
    for mode in kept["modes"]:
        outcomes: dict[str, list[str]] = {}
        for row in kept["rows"]:
            if row["mode"] == mode["key"]:
                found = [(one["outcome"], one["severity"]) for one in row["results"]]
                changes = [f"{b} from {s:g}" for (a, _), (b, s) in itertools.pairwise(found) if a != b]
                outcomes.setdefault(", ".join([found[0][0], *changes]), []).append(row["method"])
        said = [f"{', '.join(methods)}: {outcome}" for outcome, methods in outcomes.items()]
        severity = f"{mode['severity']} ({', '.join(f'{s:g}' for s in mode['severities'])})"
        rows.append((f"{mode['key']}: {mode['concerns']}", severity, "; ".join(said), mode["advice"]))
    with (HERE / "explanation" / "failure-modes.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("mode", "severity", "what happened", "what to do"), *rows])


def _make_materials(*_: object) -> None:
    """What the gallery begins with, once: the corpus in RGB, its model and page."""
    (WORK / "extra").mkdir(parents=True, exist_ok=True)
    if (WORK / "extra" / "explorer.html").exists():
        return
    for command in (
        "corpus corpus --rgb",
        "import corpus",
        "embed",
        "explore -o extra/explorer.html",
    ):
        subprocess.run([sys.executable, "-m", "manifold", *command.split()], cwd=WORK, check=True)


os.environ["MANIFOLD_DOCS_WORK"] = str(WORK)
os.environ["IPYTHONDIR"] = str(WORK / "ipython")  # whose profile begins with shell_cells
STARTUP = WORK / "ipython" / "profile_default" / "startup"
STARTUP.mkdir(parents=True, exist_ok=True)
shutil.copy(HERE / "shell_cells.py", STARTUP)
os.environ["PATH"] = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))  # `manifold`


def _formula(page: object, node: nodes.math | nodes.math_block) -> None:
    """A formula as MathML."""
    formula = tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block))
    page.body.append(f"<p>{formula}</p>" if isinstance(node, nodes.math_block) else formula)
    raise nodes.SkipNode


def setup(sphinx: object) -> None:
    """Write what pages are made from; formulas."""
    sphinx.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    sphinx.connect("config-inited", _write_commands)
    sphinx.connect("config-inited", _write_api)
    sphinx.connect("config-inited", _write_failure_modes)
    sphinx.connect("config-inited", _make_materials)
