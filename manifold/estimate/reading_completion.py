"""Completes readings in memory; `completions` also writes and checks a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from manifold.core import shipped
from manifold.estimate import instruments
from manifold.estimate.completion import Completion
from manifold.estimate.completions import atoms_of
from manifold.estimate.expected import calibrate
from manifold.estimate.left_out_readings import left_out_readings
from manifold.estimate.picture_colours import with_picture_colours
from manifold.formats.readings import Readings
from manifold.library.store import Library


def complete_readings(
    readings: Readings | Path | str, library: Library | Path | str = shipped.BUILT_IN
) -> Completion:
    """Complete the readings of a material to all directions, with the materials of a library as prior.

    Nothing is written; `manifold.estimate.complete` writes a file and checks its values.

    Args:
        readings: readings of one specimen, or the path of their file.
        library: library of measured materials, or its path; by default the built-in library.

    Returns:
        The completion, with its BRDF in `brdf` and the expected errors in `expected`.

    Raises:
        BandMismatchError: the bands of the readings and the library cannot be combined.
        UsageError: the file has several specimens, or no reading can be used.
        FileFormatError: the format of the file is unknown, or the file is damaged.
    """
    if not isinstance(readings, Readings):
        readings, _ = instruments.read([Path(readings)])
    if not isinstance(library, Library):
        library = Library(library)
    completion = Completion.of(atoms_of(library), with_picture_colours(readings))
    calibration = calibrate(completion.atoms, completion.exposed, library)
    return replace(completion, expected=calibration.expected(completion, left_out_readings(completion)))
