"""The work behind `manifold stability`: run, plot and write the catalogue of failure modes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from manifold.experiments.stability import advice_page
from manifold.experiments.stability.catalogue import MODES
from manifold.experiments.stability.trials import Stability, run_modes, select_modes
from manifold.plots import figures, plot_stability
from manifold.records import Progress
from manifold.system import atomic


def stability(
    only: Sequence[str] = (),
    picture: Path | None = None,
    page: Path | None = None,
    on_progress: Progress | None = None,
) -> Stability:
    """Try failure modes, all or some by name.

    Args:
        only: keys of modes.
        picture: where to draw error against severity.
        page: where to write what happened and what to do, as Markdown.
        on_progress: called with (done, total, what) after each method.
    Raises:
        UsageError: a name is unknown, or a file cannot be written.
    """
    modes = select_modes(MODES, only)
    if picture is not None:
        figures.require_writable(picture)
    if page is not None:
        atomic.require_writable(page)
    made = run_modes(modes, on_progress)
    if picture is not None:
        figures.save(plot_stability.panels(made, modes), picture)
    if page is not None:
        link = None if picture is None else os.path.relpath(picture, page.parent).replace(os.sep, "/")
        atomic.write_text(page, advice_page.markdown(made, modes, link))
    return made
