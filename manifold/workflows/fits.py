"""The work behind `manifold fit`: files or a prediction in, one JSON per material out."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from manifold.brdf.measured import MeasuredBRDF
from manifold.errors import ManifoldError, UsageError
from manifold.fitting import fit_json, fit_samples
from manifold.fitting.bsdf_parameters import BsdfFamily, default_principled, diffuse, principled
from manifold.fitting.exports import TARGETS
from manifold.fitting.exports.target_fit import with_target
from manifold.fitting.fit_json import Source
from manifold.fitting.fit_metrics import METRICS
from manifold.fitting.principled import METHODS, FitResult, fit_bsdf
from manifold.fitting.processes import in_processes
from manifold.formats import registry
from manifold.io_rgl import material_name, read_bsdf
from manifold.library.identity import file_sha256, printable_name, require_material_name
from manifold.model import diagnostics
from manifold.model.colours import NEAREST, ColourChoice, choose_colour
from manifold.model.diagnostics import Diagnosis
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.records import Progress
from manifold.rendering import backend
from manifold.rendering.plugin_names import require_plugins, types_of
from manifold.system import atomic, small_files
from manifold.system.stages import Stages

_KILLED = (
    "not fitted, since a process was killed (out of memory?); use fewer --jobs, and run again for the rest"
)


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    Attributes:
        family, method, metric, noise, wide_colours: as in `principled.fit_bsdf`.
        sample: which of an instrument's file with several.
        target: whose own model is fitted as well, by name; the other settings are then the default ones.
    """

    family: BsdfFamily | None = None
    method: str = "gauss-newton"
    metric: str = "cube-root"
    noise: float = 0.01
    wide_colours: bool = False
    sample: str | None = None
    target: str | None = None

    def __post_init__(self) -> None:
        if self.target is not None:
            self._require_target(self.target)
        if self.method not in METHODS or self.metric not in METRICS:
            raise UsageError(
                f"method {self.method!r}, metric {self.metric!r}, expected one of {', '.join(METHODS)} and one of "
                f"{', '.join(METRICS)}"
            )
        if not 0 < self.noise < 1:
            raise UsageError(
                f"noise {self.noise:g}, expected a share of the values between 0 and 1, such as 0.01"
            )

    def _require_target(self, target: str) -> None:
        if target not in TARGETS:
            raise UsageError(f"no target is called {target!r}, expected one of {', '.join(TARGETS)}")
        options = {"family": "--free or --bsdf", "wide_colours": "--wide-colours"}
        given = [f.name for f in fields(self) if f.name != "target" and getattr(self, f.name) != f.default]
        if given:
            raise UsageError(
                f"{', '.join(options.get(name, f'--{name}') for name in given)}: not with --target, whose own model is "
                "fitted, from the default fit of principled on; leave one of them out"
            )

    def name_of(self, path: Path) -> str:
        """Of the material that is fitted."""
        return self.sample or material_name(path)

    def matches(self, content: dict[str, Any]) -> bool:
        """Whether a written fit was asked for in the same way, of the same version of this program."""
        wanted = asdict(METHODS[self.method]()) | {"noise": self.noise}
        wide = self.wide_colours
        families = [] if self.family is None else [self.family]
        if self.family is None:
            families = [default_principled(known, wide_colours=wide) for known in (True, False)]
            families.append(diffuse(wide_colours=wide))
        return (
            content["program"] == fit_json.PROGRAM
            and content["bsdf"] in [json.loads(json.dumps(family.to_json())) for family in families]
            and (content["method"], content["metric"]) == (self.method, self.metric)
            and content["hyperparameters"] == wanted
            and (content.get("target") or {}).get("name") == self.target
        )


@dataclass(frozen=True)
class FitOutcome:
    """One material of a run.

    Attributes:
        name: of the material; of the file where that is no name of a material.
        path: its JSON, which is there where the fit did not fail.
        content: what it holds; None where the fit failed.
        was_there: whether an earlier run had made it.
        failure: why there is none, else None.
        file: what was fitted; None for a prediction.
        diagnosis: of a prediction; None of a file.
    """

    name: str
    path: Path
    content: dict[str, Any] | None
    was_there: bool = False
    failure: str | None = None
    file: Path | None = None
    diagnosis: Diagnosis | None = None


def read_family(path: Path) -> BsdfFamily:
    """A BSDF family from a JSON file of `type`, `parameters` and `fixed`; see `BsdfFamily.from_json`.

    Raises:
        UsageError: the file is missing, or is no such description.
    """
    try:
        content = small_files.read_json(path, "a JSON description of a BSDF")
        require_plugins(types_of(content), str(path))
        return BsdfFamily.from_json(content)
    except ManifoldError as error:
        raise UsageError(str(error) if str(path) in str(error) else f"{path}: {error}") from error


def family_of(names: str | None, path: Path | None, *, wide_colours: bool = False) -> BsdfFamily | None:
    """`principled` with the named parameters (commas between) free, or the family of a file; not both.

    None where neither is given, which `principled.fit_bsdf` decides.

    Raises:
        UsageError: both are given, or one cannot be used.
    """
    if path is not None and wide_colours:
        raise UsageError(
            "--wide-colours and --bsdf cannot be used together: a described BSDF names its ranges"
        )
    if names is not None and path is not None:
        raise UsageError(
            "--free and --bsdf cannot be used together: a described BSDF names its free parameters"
        )
    if path is not None:
        return read_family(path)
    if names is None:
        return None
    return principled([name.strip() for name in names.split(",")], wide_colours=wide_colours)


def find_files(sources: Sequence[Path]) -> list[Path]:
    """The .bsdf files among files and folders, in order; folders are searched at every depth and sorted.

    In folders, what is not a regular file is left out.

    Raises:
        UsageError: a source is missing, or a folder holds none.
    """
    found: list[Path] = []
    for source in sources:
        if os.path.isdir(source):
            inside = sorted(path for path in source.rglob("*.bsdf") if os.path.isfile(path))
            if not inside:
                raise UsageError(f"{source}: no .bsdf file in this folder; name another")
            found += inside
        elif os.path.isfile(source):
            found.append(source)
        else:
            raise UsageError(f"{source}: no such file or folder; name .bsdf files or folders of them")
    return list(dict.fromkeys(found))


def fit_files(
    sources: Sequence[Path], output: Path | None, settings: FitSettings, *, jobs: int | None = None,
    on_progress: Progress | None = None,
) -> list[FitOutcome]:  # fmt: skip
    """Fit files, one JSON each, several at once; fits that an earlier run made alike are kept.

    Every JSON is written as soon as its fit is done.

    Args:
        sources: .bsdf files, or folders searched at every depth for them.
        output: the JSON of a single file, or the folder for several; the working folder if None.
        settings: how.
        jobs: processes; one per core if None.
        on_progress: called after each material.
    Returns:
        One outcome per file, in order; a file that cannot be fitted does not stop the others, nor does a process
        that is killed make those undone that were finished.
    Raises:
        UsageError: a source or the output cannot be used.
        RendererError: Mitsuba is missing.
    """
    paths = find_files(sources)
    if settings.sample is not None and len(paths) > 1:
        raise UsageError(f"--sample {settings.sample} of {len(paths)} files, expected one file; name one")
    tasks, outcomes = _plan(paths, output, settings)
    backend.choose()  # probed once, here, and not by every process

    def done(outcome: FitOutcome) -> None:
        outcome = _written(outcome)
        assert outcome.file is not None
        outcomes[outcome.file] = outcome
        if on_progress is not None:
            on_progress(len(outcomes), len(paths), outcome.name)

    n = min(jobs or os.cpu_count() or 1, len(tasks))
    if n <= 1:
        for path, target in tasks.items():
            done(_fit_file(path, target, settings))
    else:
        calls = [(path, target, settings) for path, target in tasks.items()]
        with closing(in_processes(_fit_file, calls, n, initializer=_use_one_thread)) as fitted:
            for outcome in fitted:
                done(outcome)
    for path, target in tasks.items():
        if path not in outcomes:
            outcomes[path] = FitOutcome(settings.name_of(path), target, None, failure=_KILLED, file=path)
    return [outcomes[path] for path in paths]


def fit_prediction(
    model: Path, latent: Place, output: Path | None, settings: FitSettings, *,
    library: Path | None = None, colour: ColourChoice = NEAREST, on_progress: Progress | None = None,
) -> FitOutcome:  # fmt: skip
    """Fit the material that a model predicts at a latent; arguments as in `predicted_file.predict` and `fit_files`.

    Raises:
        UsageError, LatentError, ModelError: the model, the latent or the output cannot be used.
    """
    path = Path("predicted.fit.json") if output is None else output
    atomic.require_writable(path)
    direct = "" if settings.target is None else f"fitting the model of {settings.target}"
    stages = Stages(
        on_progress, {"reading materials": 3, "sampling": 1, "fitting": 6, **({direct: 4} if direct else {})}
    )
    loaded = Manifold.load(model, library)
    x = loaded.require_latent(latent)
    loaded.prepare(stages.begin("reading materials"))
    chosen = choose_colour(loaded, latent, colour)
    brdf = loaded.predict(latent, chosen.colours)
    stages.begin("sampling")
    samples = fit_samples.from_brdf(brdf)
    source = Source(
        name=path.name.removesuffix(".json").removesuffix(".fit"),
        latent=tuple(float(v) for v in x),
        model=model.name,
        model_sha256=file_sha256(model),
        colour=chosen.words,
    )
    content = fit_json.document(_fit(samples, settings, stages.begin("fitting")), source)
    if settings.target is not None:
        stages.begin(direct)
        content = with_target(content, TARGETS[settings.target], brdf, "prediction")
    fit_json.write_document(path, content)
    diagnosis = diagnostics.of_brdf(loaded, x, brdf, chosen)
    return FitOutcome(source.name, path, content, diagnosis=diagnosis)


def _plan(
    paths: Sequence[Path], output: Path | None, settings: FitSettings
) -> tuple[dict[Path, Path], dict[Path, FitOutcome]]:
    """The JSON of every file, and the outcomes of those that cannot have one."""
    is_single = output is not None and len(paths) == 1 and not output.is_dir()
    folder = Path() if output is None else output
    if is_single:
        atomic.require_writable(folder)
    elif folder.exists() and not folder.is_dir():
        raise UsageError(
            f"{folder}: is a file, expected a folder for {len(paths)} fits; name a folder with -o"
        )
    else:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise UsageError(f"{folder}: cannot write into this folder; name another with -o")
    targets: dict[Path, Path] = {}
    refused: dict[Path, FitOutcome] = {}
    taken: dict[Path, Path] = {}
    for path in paths:
        name = settings.name_of(path)
        target = folder if is_single else folder / f"{name}.fit.json"
        try:
            require_material_name(name)
            if taken.setdefault(target, path) != path:
                raise UsageError(f"{path} and {taken[target]} have the same name; fit them into two folders")
            atomic.require_writable(target)
            targets[path] = target
        except UsageError as error:
            refused[path] = FitOutcome(printable_name(path.name), target, None, failure=str(error), file=path)
    return targets, refused


def _use_one_thread() -> None:
    """One process per core: more threads in each would only wait for each other."""
    backend.drjit().set_thread_count(0)


def _fit_file(path: Path, target: Path, settings: FitSettings) -> FitOutcome:
    """The fit of a file, not yet written: whoever is killed here leaves nothing behind."""
    name = settings.name_of(path)
    try:
        source = Source(name=name, file=path.name, sha256=file_sha256(path))
        there = _earlier(target, source, settings)
        if there is not None:
            return FitOutcome(name, target, there, was_there=True, file=path)
        material = None if settings.target is None else _measured(path)
        samples, notes = _samples(path, settings.sample)
        found = _fit(samples, settings)
        content = fit_json.document(replace(found, notes=(*notes, *found.notes)), source)
        if settings.target is not None and material is not None:
            content = with_target(content, TARGETS[settings.target], material, "measured file")
        return FitOutcome(name, target, content, file=path)
    except ManifoldError as error:
        return FitOutcome(name, target, None, failure=str(error), file=path)
    except OSError as error:
        reason = f"{path} cannot be read ({error.strerror})"
        return FitOutcome(name, target, None, failure=reason, file=path)


def _measured(path: Path) -> MeasuredBRDF:
    """The BRDF of an RGL file, which covers the ball."""
    known = registry.identify(path)
    if known is not None:
        raise UsageError(
            f"{path}: {known.name}, expected a .bsdf for --target, which compares balls; write one with "
            "`manifold complete` or `manifold convert`"
        )
    return MeasuredBRDF(read_bsdf(path))


def _samples(path: Path, sample: str | None) -> tuple[fit_samples.FitSamples, tuple[str, ...]]:
    """Of an RGL file, or of an instrument's, and what was ambiguous or is left out, in sentences."""
    if registry.identify(path) is None:
        if sample is not None:
            raise UsageError(f"{path} holds one material; leave --sample out")
        return fit_samples.from_file(read_bsdf(path)), ()
    readings = registry.read_readings(path, sample, fit_samples.MAX_PAIRS)
    notes = readings.notes
    if readings.gloss:
        notes += ("fits do not use gloss; `manifold complete` does, and its file can be fitted",)
    return fit_samples.from_readings(readings), notes


def _fit(
    samples: fit_samples.FitSamples, settings: FitSettings, on_progress: Progress | None = None
) -> FitResult:
    return fit_bsdf(
        samples, settings.family, method=settings.method, metric=settings.metric, noise=settings.noise,
        wide_colours=settings.wide_colours, on_progress=on_progress,
    )  # fmt: skip


def _written(outcome: FitOutcome) -> FitOutcome:
    """The outcome, its JSON written unless it is there; a failure where that is impossible."""
    if outcome.content is None or outcome.was_there:
        return outcome
    try:
        fit_json.write_document(outcome.path, outcome.content)
    except ManifoldError as error:
        return replace(outcome, content=None, failure=str(error))
    return outcome


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
