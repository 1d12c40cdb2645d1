"""Sphinx configuration: the pages are Markdown; tutorials and gallery scripts run in the build."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import typer

from manifold import __version__
from manifold.cli.main import app

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parent / "benchmarks" / "results"
WORK = HERE / "_work"  # libraries and models of the tutorials, kept between builds

project = "manifold"
author = "The manifold developers"
copyright = "The manifold developers, MIT licence"
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
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
    "gallery/*.ipynb",
    "examples/*",
]
suppress_warnings = ["config.cache"]  # sphinx_gallery_conf holds a function
nitpicky = False

html_theme = "pydata_sphinx_theme"
html_title = "manifold"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
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
    "filename_pattern": r"\.py$",
    "image_scrapers": ("matplotlib",),
    "remove_config_comments": True,
    "show_memory": False,
    "download_all_examples": False,
    "within_subsection_order": "FileNameSortKey",
    "min_reported_time": 1e9,
}


def _figures() -> dict[str, str]:
    """Every number in benchmarks/results/*.json, as `file_key_key`, for `{{ file_key_key }}` in pages."""

    def flat(prefix: str, value: object) -> dict[str, str]:
        if isinstance(value, dict):
            return {k: v for key, inner in value.items() for k, v in flat(f"{prefix}_{key}", inner).items()}
        if isinstance(value, bool | int | float | str):
            return {re.sub(r"\W+", "_", prefix): str(value)}
        return {}

    files = sorted(RESULTS.glob("*.json"))
    return {k: v for file in files for k, v in flat(file.stem, json.loads(file.read_text())).items()}


myst_substitutions = _figures()


def _write_commands(*_: object) -> None:
    """The reference of the command line, from the commands themselves: reference/commands.md."""
    lines = ["# Commands", "", "Every command has `--help`, which shows what stands here.", ""]
    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        context = type(command).context_class(command, info_name=f"manifold {name}")
        help_text = command.get_help(context)
        lines += [f"## {name}", "", "```text", help_text.rstrip(), "```", ""]
    target = HERE / "reference" / "commands.md"
    text = "\n".join(lines)
    if not target.exists() or target.read_text(encoding="utf-8") != text:
        target.write_text(text, encoding="utf-8")


def _make_materials(*_: object) -> None:
    """The corpus in RGB as a library with its model, once: tutorials and the gallery begin with them."""
    WORK.mkdir(exist_ok=True)
    if (WORK / "model.h5").exists():
        return
    manifold = [sys.executable, "-m", "manifold"]
    for command in (["corpus", "corpus", "--rgb"], ["import", "corpus"], ["embed"]):
        subprocess.run(manifold + command, cwd=WORK, check=True)


os.environ["MANIFOLD_DOCS_WORK"] = str(WORK)


def setup(sphinx: object) -> None:
    """Write what pages are made from."""
    sphinx.connect("config-inited", _write_commands)
    sphinx.connect("config-inited", _make_materials)
