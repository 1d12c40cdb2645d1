"""The work behind `manifold fit`: files or a prediction in, one JSON per material out."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from manifold.brdf.measured import BRDF
from manifold.colour.narrow_bands import with_spectra
from manifold.errors import ManifoldError, RendererError, UsageError
from manifold.fitting import fit_check, fit_json, fit_samples
from manifold.fitting.bsdf_parameters import BsdfFamily, default_principled, diffuse
from manifold.fitting.fit_json import Source
from manifold.fitting.fit_samples import FitSamples
from manifold.fitting.principled import METHODS, fit_bsdf
from manifold.formats import registry
from manifold.io_rgl import material_name, read_bsdf
from manifold.library.identity import file_sha256, require_material_name
from manifold.library.importing import find_files
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.diagnostics import Prediction
from manifold.model.manifold import Manifold
from manifold.records import BsdfFile, Progress
from manifold.rendering import backend
from manifold.system import atomic, reading
from manifold.system.names import printable
from manifold.system.stages import Stages
from manifold.workflows.output_index import Outcome, make_folder
from manifold.workflows.sources import LibrarySource, PlaceSource, read_source

Measured = Path | LibrarySource
"""A file, or a material of a library."""


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    Attributes:
        family, method, metric, noise, wide_colours: as in `principled.fit_bsdf`.
        sample: which of an instrument's file with several.
    """

    family: BsdfFamily | None = None
    method: str = "gauss-newton"
    metric: str = "appearance"
    noise: float = 0.01
    wide_colours: bool = False
    sample: str | None = None

    def name_of(self, source: Measured) -> str:
        """Of the material that is fitted."""
        if isinstance(source, LibrarySource):
            return source.name
        return self.sample or material_name(source)

    def fit(
        self,
        target: BRDF | BsdfFile | FitSamples,
        source: Source,
        notes: Sequence[str] = (),
        on_progress: Progress | None = None,
    ) -> dict[str, Any]:
        """The content of the JSON of a fit; its notes begin with those given."""
        found = fit_bsdf(
            target, self.family, method=self.method, metric=self.metric, noise=self.noise,
            wide_colours=self.wide_colours, on_progress=on_progress,
        )  # fmt: skip
        return fit_json.document(replace(found, notes=(*notes, *found.notes)), source)

    def matches(self, content: dict[str, Any]) -> bool:
        """Whether a written fit has these settings, and was made by this version of the program."""
        families = [self.family]
        if self.family is None:
            families = [default_principled(known, wide_colours=self.wide_colours) for known in (True, False)]
            families.append(diffuse(wide_colours=self.wide_colours))
        return (
            content["program"] == fit_json.PROGRAM
            and content["bsdf"] in [json.loads(json.dumps(family.to_json())) for family in families if family]
            and (content["method"], content["metric"]) == (self.method, self.metric)
            and content["hyperparameters"] == asdict(METHODS[self.method]()) | {"noise": self.noise}
        )


def read_family(path: Path) -> BsdfFamily:
    """A BSDF family from a JSON file of `type`, `parameters` and `fixed`; see `BsdfFamily.to_json`.

    Raises:
        UsageError: the file is missing.
        FileFormatError: it is no such description.
    """
    return fit_check.family_of(reading.read_json(path, "a JSON description of a BSDF"), str(path))


def fit_files(
    sources: Sequence[Path | LibrarySource], output: Path | None, settings: FitSettings, *,
    jobs: int | None = None, on_progress: Progress | None = None,
) -> list[Outcome[Measured]]:  # fmt: skip
    """Fit files, one JSON each, several at once; fits that an earlier run made alike are kept.

    Every JSON is written as soon as its fit is done.

    Args:
        sources: .bsdf files, folders searched at every depth for them, or materials of libraries.
        output: the JSON of a single file, or the folder for several; the working folder if None.
        settings: how.
        jobs: processes; one per core if None.
        on_progress: called after each material.
    Returns:
        One outcome per file, in order; a file that cannot be fitted does not stop the others.
    Raises:
        UsageError: a source or the output cannot be used.
        RendererError: Mitsuba is missing, or a process was killed.
    """
    paths: list[Measured] = []
    for source in sources:
        paths += [source] if isinstance(source, LibrarySource) else find_files([source])
    paths = list(dict.fromkeys(paths))
    if settings.sample is not None and len(paths) > 1:
        raise UsageError(f"sample {settings.sample} of {len(paths)} files, expected one file; name one")
    tasks, outcomes = _plan(paths, output, settings)
    backend.imported()

    def done(outcome: Outcome[Measured], path: Measured) -> None:
        outcomes[path] = outcome
        if on_progress is not None:
            on_progress(len(outcomes), len(paths), outcome.name)

    n = min(jobs or os.cpu_count() or 1, len(tasks))
    if n <= 1:
        for path, target in tasks.items():
            done(_fit_file(path, target, settings), path)
        return [outcomes[path] for path in paths]
    # Spawned, not forked: Dr.Jit's threads do not survive a fork.
    with ProcessPoolExecutor(n, multiprocessing.get_context("spawn"), _begin_process) as pool:
        try:
            fitted = {pool.submit(_fit_file, path, target, settings): path for path, target in tasks.items()}
            for future in as_completed(fitted):
                done(future.result(), fitted[future])
        except BrokenProcessPool:
            raise RendererError(
                "a process was killed (out of memory?); use fewer, and run again: finished fits are kept"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)
    return [outcomes[path] for path in paths]


def fit_prediction(
    place: PlaceSource, output: Path | None, settings: FitSettings, on_progress: Progress | None = None
) -> Outcome[Prediction]:
    """Fit the material that a model predicts at a place; arguments as in `fit_files`.

    Raises:
        UsageError, LatentError, ModelError: the model, the latent or the output cannot be used.
    """
    path = Path("predicted.fit.json") if output is None else output
    atomic.require_writable(path)
    stages = Stages(on_progress, {"reading materials": 3, "fitting": 7})
    loaded = Manifold.load(place.model, place.library)
    loaded.prepare(stages.begin("reading materials"))
    predicted = diagnostics.predict(loaded, place.place, place.colour)
    source = Source(
        name=path.name.removesuffix(".json").removesuffix(".fit"),
        latent=tuple(predicted.latent.tolist()),
        model=place.model.name,
        model_sha256=file_sha256(place.model),
        colour=predicted.colour,
    )
    content = settings.fit(predicted.brdf, source, on_progress=stages.begin("fitting"))
    fit_json.write_document(path, content)
    return Outcome(source.name, path, predicted, content)


def _plan(
    paths: Sequence[Measured], output: Path | None, settings: FitSettings
) -> tuple[dict[Measured, Path], dict[Measured, Outcome[Measured]]]:
    """The JSON of every file, and the outcomes of those that cannot have one."""
    folder = Path() if output is None else output
    is_single = output is not None and len(paths) == 1 and not output.is_dir()
    if is_single:
        atomic.require_writable(folder)
    else:
        make_folder(folder, f"{len(paths)} fits")
    targets: dict[Measured, Path] = {}
    refused: dict[Measured, Outcome[Measured]] = {}
    taken: dict[Path, Measured] = {}
    for path in paths:
        name = settings.name_of(path)
        target = folder if is_single else folder / f"{name}.fit.json"
        try:
            require_material_name(name)
            if taken.setdefault(target, path) != path:
                raise UsageError(f"{path} and {taken[target]} have the same name; fit them into two folders")
            targets[path] = target
        except UsageError as error:
            refused[path] = Outcome(printable(path.name), target, path, failure=str(error))
    return targets, refused


def _begin_process() -> None:
    """Leave Ctrl-C to the parent, and the other cores to the other processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    backend.drjit().set_thread_count(0)


def _fit_file(path: Measured, target: Path, settings: FitSettings) -> Outcome[Measured]:
    """Fit a material and write the JSON, unless an earlier run has."""
    name = settings.name_of(path)
    try:
        if isinstance(path, LibrarySource):
            info = Library(path.library).attributes(name)
            source = Source(name=name, file=info.source_file, sha256=info.sha256)
        else:
            source = Source(name=name, file=path.name, sha256=file_sha256(path))
        there = _earlier(target, source, settings)
        if there is not None:
            return Outcome(name, target, path, there, was_there=True)
        content = _fit(path, source, settings)
        fit_json.write_document(target, content)
        return Outcome(name, target, path, content)
    except ManifoldError as error:
        return Outcome(name, target, path, failure=str(error))
    except OSError as error:
        return Outcome(name, target, path, failure=f"{path} cannot be read ({error.strerror})")


def _fit(path: Measured, source: Source, settings: FitSettings) -> dict[str, Any]:
    """The content of the fit of a material, or of an instrument's file with what was ambiguous or left out as notes."""
    if isinstance(path, LibrarySource):
        return settings.fit(read_source(path), source)
    known = registry.identify(path)
    if known is None:
        if settings.sample is not None:
            raise UsageError(f"{path} holds one material, found a sample {settings.sample}; leave it out")
        return settings.fit(read_bsdf(path), source)
    readings = with_spectra(registry.read_readings(path, settings.sample, fit_samples.MAX_PAIRS))
    notes = readings.notes
    if readings.gloss:
        notes += ("fits do not use gloss; `manifold complete` does, and its file can be fitted",)
    return settings.fit(fit_samples.from_readings(readings), source, notes)


def _earlier(target: Path, source: Source, settings: FitSettings) -> dict[str, Any] | None:
    """The fit that an earlier run wrote for the same file and settings, or None."""
    if not target.is_file():
        return None
    try:
        content = fit_json.read(target)
    except ManifoldError:
        return None  # not a fit, or of another version: it is written anew
    known = content["source"]
    is_same = known["sha256"] == source.sha256 and settings.matches(content)
    if settings.sample is not None:
        is_same &= known["name"] == source.name
    return content if is_same and fit_json.is_untouched(content) else None
