"""Sphinx configuration: the pages are Markdown; tutorials and gallery scripts run in the build."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from docutils import nodes
from sphinx.transforms.post_transforms import SphinxPostTransform

from manifold import __version__

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import formulas  # noqa: E402  # beside this file
import reference_pages  # noqa: E402

WORK = HERE / "_work"  # kept between builds
GALLERY, EXTRA, STATIC = WORK / "gallery", WORK / "extra", WORK / "static"

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

html_math_renderer = "katex"
html_theme = "pydata_sphinx_theme"
html_title = f"manifold {version}"
html_static_path = ["_static", "_work/static"]
html_favicon = "_static/favicon.svg"
html_extra_path = ["_work/extra"]  # the explorer of the corpus, embedded in the gallery
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_nav_level": 1,
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],
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
autodoc_type_aliases = {
    name: name for name in ("Array", "AnyArray", "Indices", "Mask")
}  # of manifold.core.records
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
toc_object_entries = False
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = ["Source"]

sphinx_gallery_conf = {
    "examples_dirs": "_work/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "image_scrapers": ("matplotlib",),
    "remove_config_comments": True,
    "show_memory": False,
    "download_all_examples": False,
    "within_subsection_order": "FileNameSortKey",
    "min_reported_time": 1e9,
}


def _make_materials(*_: object) -> None:
    """Make what the gallery's scripts find in their folder, once: the corpus in RGB, its library and its map."""
    GALLERY.mkdir(parents=True, exist_ok=True)
    for script in (HERE / "examples").iterdir():
        reference_pages.write_if_changed(GALLERY / script.name, script.read_text(encoding="utf-8"))
    if (EXTRA / "explorer.html").exists():
        return
    EXTRA.mkdir(parents=True, exist_ok=True)
    for command in (
        "corpus corpus --rgb",
        "import corpus",
        "embed",
        f"explore -o {EXTRA / 'explorer.html'}",
    ):
        subprocess.run([sys.executable, "-m", "manifold", *command.split()], cwd=GALLERY, check=True)


os.environ["COLUMNS"] = "80"  # of the outputs of cells: as wide as the text
os.environ["PIP_NO_BUILD_ISOLATION"] = "0"  # cells that install an example need no network
os.environ["IPYTHONDIR"] = str(WORK / "ipython")  # whose profile begins with shell_cells
STARTUP = WORK / "ipython" / "profile_default" / "startup"
STARTUP.mkdir(parents=True, exist_ok=True)
shutil.copy(HERE / "shell_cells.py", STARTUP)
os.environ["PATH"] = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))  # `manifold`


class KeepPairsTogether(SphinxPostTransform):
    """Put no-break spaces around the slash of pairs of numbers such as 2.6 / 9.8, which else break across lines."""

    default_priority = 400

    def run(self, **_: object) -> None:
        """Replace the texts of the page."""
        for text in list(self.document.findall(nodes.Text)):
            if not isinstance(
                text.parent, nodes.literal | nodes.literal_block | nodes.math | nodes.math_block
            ):
                joined = re.sub(r"(?<=\d) / (?=\d)", "\N{NO-BREAK SPACE}/\N{NO-BREAK SPACE}", text)
                if joined != text:
                    text.parent.replace(text, nodes.Text(joined))


def _keep_colons_of_properties(_app: object, what: str, *given: object) -> None:
    """Begin docstrings of properties with an empty comment: napoleon takes words before a colon for a type."""
    lines = given[-1]
    if what in ("attribute", "property") and lines:
        lines[:0] = ["..", ""]


def setup(sphinx: object) -> None:
    """Write the pages that are made from code and results, and register what changes pages."""
    sphinx.add_html_math_renderer("katex", (formulas.visit, None), (formulas.visit, None))
    sphinx.add_css_file("katex/katex.min.css")
    sphinx.add_css_file("site.css")
    sphinx.add_post_transform(KeepPairsTogether)
    sphinx.connect("autodoc-process-docstring", _keep_colons_of_properties, priority=400)
    for write in (
        reference_pages.write_commands,
        reference_pages.write_api,
        reference_pages.write_citation,
        reference_pages.write_failure_modes,
        lambda *_: formulas.copy_styles(STATIC / "katex"),
        _make_materials,
    ):
        sphinx.connect("config-inited", write)
