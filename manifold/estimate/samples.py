"""Samples that instruments have read, found in files: one or several files of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold import progress
from manifold.disk import matching
from manifold.errors import ManifoldError
from manifold.formats import registry
from manifold.formats.readings import Readings
from manifold.library.identity import alike
from manifold.library.importing import find_files

_SAME_INCIDENCE = 1e-3  # between unit vectors


@dataclass(frozen=True)
class Sample:
    """One sample, which one or several instruments have read.

    Attributes:
        name: of what is made of it.
        parts: files, and the name that it has in each; None in a file that holds no other.
        note: why its readings are put together, or are not; None where there was nothing to decide.
    """

    name: str
    parts: tuple[tuple[Path, str | None], ...]
    note: str | None = None

    def __str__(self) -> str:
        return " and ".join(str(path) for path, _ in self.parts)


def is_readings(path: Path) -> bool:
    """Whether a file's content is an instrument's; what describes files beside them may look like it."""
    return path.suffix not in (".md", ".json") and registry.identify(path) is not None


def safe_name(name: str) -> str:
    """The name of a file for that of a sample."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name).strip(".") or "sample"


def find_samples(sources: Iterable[Path]) -> list[Sample]:
    """The samples that instruments' files hold; readings of one by several instruments are put together.

    Files are of one sample where it has one name in them and instruments differ. Where one instrument has read a name
    twice, they may be two samples, and stay apart, named by their files.

    Args:
        sources: files, patterns, and folders, which are searched for files of readings.
    Raises:
        UsageError: a source is missing, or a folder holds no readings.
    """
    groups: dict[str, list[_Part]] = {}
    given = [path for source in sources for path in matching(str(source))]
    paths = find_files(given, is_readings, "readings file")
    for path in progress.each(paths, str):
        try:
            records = registry.read_all(path)
        except ManifoldError:  # which whatever completes it is told again
            groups[str(path)] = [_Part(path, None, path.stem, "", 0, None)]
            continue
        for one in records:
            sample = one.name if len(records) > 1 else None
            part = _Part(
                path, sample, one.name.strip(), one.instrument, one.bands.count, _only_incidence_deg(one)
            )
            groups.setdefault(alike(part.name), []).append(part)
    found = [sample for parts in groups.values() for sample in _in_samples(parts)]
    lone = [parts[0] for parts in groups.values() if len(parts) == 1]
    incidences = {part.incidence_deg for part in lone}
    is_apart = len(found) == len(lone) == len(incidences) > 1 and None not in incidences
    if is_apart and len({part.instrument for part in lone}) == 1:
        note = f"{len(lone)} files have one incidence each, all different: --merge if they are of one sample"
        return [replace(sample, note=note) for sample in found]
    return found


class _Part(NamedTuple):
    """What one file says of a sample; `sample` is its name where the file has several."""

    path: Path
    sample: str | None
    name: str
    instrument: str
    bands: int
    incidence_deg: float | None


def _only_incidence_deg(record: registry.Record) -> float | None:
    """The incidence of readings that have one, in degrees; None of others."""
    if (
        not isinstance(record, Readings)
        or len(record) == 1
        or np.ptp(record.wi, axis=0).max() > _SAME_INCIDENCE
    ):
        return None
    return round(float(np.rad2deg(np.arccos(min(record.wi[0, 2], 1.0)))), 1)


def _in_samples(parts: list[_Part]) -> list[Sample]:
    """The samples of files in which the names agree."""
    name = parts[0].name
    if len(parts) == 1:
        return [Sample(safe_name(name), (parts[0][:2],))]
    files = ", ".join(part.path.name for part in parts)
    if len({part.instrument for part in parts}) == len(parts):
        spectral_first = sorted(parts, key=lambda part: -part.bands)  # others are corrected by it
        note = f"put together from {files}, in which the sample is named {name}"
        return [Sample(safe_name(name), tuple(part[:2] for part in spectral_first), note)]
    note = f"{files} hold readings of {name} by one instrument: completed apart; --merge if they are of one sample"
    return [
        Sample(safe_name("_".join(filter(None, (part.path.stem, part.sample)))), (part[:2],), note)
        for part in parts
    ]
