"""The work behind `manifold fit`: files or a prediction in, one JSON per material out."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from manifold import atomic, backend
from manifold.colour_choice import NEAREST, ColourChoice, choose_colour
from manifold.errors import ManifoldError, UsageError
from manifold.fitting import fit_json, fit_samples
from manifold.fitting.bsdf_parameters import BsdfFamily, diffuse, principled
from manifold.fitting.fit_json import Source
from manifold.fitting.fit_metrics import METRICS
from manifold.io_rgl import material_name, read_bsdf
from manifold.model import Manifold
from manifold.principled import METHODS, FitResult, fit
from manifold.records import Array, Progress


@dataclass(frozen=True)
class FitSettings:
    """How to fit.

    Attributes:
        family, method, metric, noise: as in `principled.fit`.
    """

    family: BsdfFamily | None = None
    method: str = "gauss-newton"
    metric: str = "cube-root"
    noise: float = 0.01

    def __post_init__(self) -> None:
        if self.method not in METHODS or self.metric not in METRICS:
            raise UsageError(
                f"method {self.method!r}, metric {self.metric!r}, expected one of {', '.join(METHODS)} and one of "
                f"{', '.join(METRICS)}"
            )
        if not 0 < self.noise < 1:
            raise UsageError(
                f"noise {self.noise:g}, expected a share of the values between 0 and 1, such as 0.01"
            )

    def made(self, content: dict[str, Any]) -> bool:
        """Whether a written fit was asked for in the same way, of the same version of this program."""
        wanted = asdict(METHODS[self.method]()) | {"noise": self.noise}
        families = [principled(), diffuse()] if self.family is None else [self.family]
        return (
            content["program"] == fit_json.PROGRAM
            and content["bsdf"] in [json.loads(json.dumps(family.to_json())) for family in families]
            and (content["method"], content["metric"]) == (self.method, self.metric)
            and content["hyperparameters"] == wanted
        )


@dataclass(frozen=True)
class FitOutcome:
    """One material of a run.

    Attributes:
        name: of the material.
        path: its JSON.
        content: what it holds; None where the fit failed.
        was_there: whether an earlier run had made it.
        failure: why there is none, else None.
    """

    name: str
    path: Path
    content: dict[str, Any] | None
    was_there: bool = False
    failure: str | None = None


def read_family(path: Path) -> BsdfFamily:
    """A BSDF family from a JSON file of `type`, `parameters` and `fixed`; see `BsdfFamily.from_json`.

    Raises:
        UsageError: the file is missing, or is no such description.
    """
    try:
        return BsdfFamily.from_json(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; name a JSON description of a BSDF") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise UsageError(f"{path}: {error}, expected a JSON description of a BSDF") from error


def family_of(names: str | None, path: Path | None) -> BsdfFamily | None:
    """`principled` with the named parameters (commas between) free, or the family of a file; not both.

    None where neither is given, which `principled.fit` decides.

    Raises:
        UsageError: both are given, or one cannot be used.
    """
    if names is not None and path is not None:
        raise UsageError(
            "--free and --bsdf cannot be used together: a described BSDF names its free parameters"
        )
    if path is not None:
        return read_family(path)
    return None if names is None else principled([name.strip() for name in names.split(",")])


def find_files(sources: Sequence[Path]) -> list[Path]:
    """The .bsdf files among files and folders, in order, folders sorted.

    Raises:
        UsageError: a source is missing, or a folder holds none.
    """
    found: list[Path] = []
    for source in sources:
        if source.is_dir():
            inside = sorted(source.glob("*.bsdf"))
            if not inside:
                raise UsageError(f"{source}: no .bsdf file in this folder; name another")
            found += inside
        elif source.is_file():
            found.append(source)
        else:
            raise UsageError(f"{source}: no such file or folder; name .bsdf files or folders of them")
    return list(dict.fromkeys(found))


def fit_files(
    sources: Sequence[Path], output: Path | None, settings: FitSettings, *, jobs: int | None = None,
    on_progress: Progress | None = None,
) -> list[FitOutcome]:  # fmt: skip
    """Fit files, one JSON each, several at once; fits that an earlier run made alike are kept.

    Args:
        sources: .bsdf files, or folders of them.
        output: the JSON of a single file, or the folder for several; the working folder if None.
        settings: how.
        jobs: processes; one per core if None.
        on_progress: called after each material.
    Returns:
        One outcome per file, in order; a file that cannot be fitted does not stop the others.
    Raises:
        UsageError: a source or the output cannot be used.
    """
    paths = find_files(sources)
    targets = _targets(paths, output)
    outcomes: dict[Path, FitOutcome] = {}

    def done(path: Path, outcome: FitOutcome) -> None:
        outcomes[path] = outcome
        if on_progress is not None:
            on_progress(len(outcomes), len(paths), outcome.name)

    n = min(jobs or os.cpu_count() or 1, len(paths))
    if n <= 1:
        for path in paths:
            done(path, _fit_file(path, targets[path], settings))
        return [outcomes[path] for path in paths]
    # Spawned, not forked: Dr.Jit's threads do not survive a fork. The backend is probed once, here.
    backend.choose()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(n, context, initializer=_use_one_thread) as pool:
        futures = {pool.submit(_fit_file, path, targets[path], settings): path for path in paths}
        try:
            for future in as_completed(futures):
                done(futures[future], future.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [outcomes[path] for path in paths]


def fit_prediction(
    model: Path, latent: Array | Sequence[float], output: Path | None, settings: FitSettings, *,
    library: Path | None = None, colour: ColourChoice = NEAREST, on_progress: Progress | None = None,
) -> FitOutcome:  # fmt: skip
    """Fit the material that a model predicts at a latent; arguments as in `pipeline.predict` and `fit_files`.

    Raises:
        UsageError, LatentError, ModelError: the model, the latent or the output cannot be used.
    """
    path = Path("predicted.fit.json") if output is None else output
    atomic.require_writable(path)
    loaded = Manifold.load(model, library)
    x = loaded.require_latent(latent)
    loaded.prepare(on_progress)
    chosen = choose_colour(loaded, x, colour)
    samples = fit_samples.from_brdf(loaded.predict(x, chosen.colours))
    source = Source(
        name=path.name.removesuffix(".json").removesuffix(".fit"),
        latent=tuple(float(v) for v in x),
        model=model.name,
        model_sha256=_sha256(model),
        colour=chosen.words,
    )
    return _finish(path, source, _fit(samples, settings))


def _targets(paths: Sequence[Path], output: Path | None) -> dict[Path, Path]:
    """The JSON of every file."""
    if output is not None and len(paths) == 1 and not output.is_dir():
        atomic.require_writable(output)
        return {paths[0]: output}
    folder = Path() if output is None else output
    if folder.exists() and not folder.is_dir():
        raise UsageError(
            f"{folder}: is a file, expected a folder for {len(paths)} fits; name a folder with -o"
        )
    folder.mkdir(parents=True, exist_ok=True)
    targets = {path: folder / f"{material_name(path)}.fit.json" for path in paths}
    taken: dict[Path, Path] = {}
    for path, target in targets.items():
        atomic.require_writable(target)
        if target in taken:
            raise UsageError(
                f"{path} and {taken[target]} would both become {target}; fit them into two folders"
            )
        taken[target] = path
    return targets


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _use_one_thread() -> None:
    """One process per core: more threads in each would only wait for each other."""
    backend.drjit().set_thread_count(0)


def _fit_file(path: Path, target: Path, settings: FitSettings) -> FitOutcome:
    name = material_name(path)
    try:
        source = Source(name=name, file=path.name, sha256=_sha256(path))
        there = _earlier(target, source, settings)
        if there is not None:
            return FitOutcome(name, target, there, was_there=True)
        samples = fit_samples.from_file(read_bsdf(path))
        return _finish(target, source, _fit(samples, settings))
    except ManifoldError as error:
        return FitOutcome(name, target, None, failure=f"{name}: {error}")
    except OSError as error:
        return FitOutcome(name, target, None, failure=f"{name}: {path} cannot be read ({error.strerror})")


def _fit(samples: fit_samples.FitSamples, settings: FitSettings) -> FitResult:
    return fit(samples, settings.family, method=settings.method, metric=settings.metric, noise=settings.noise)


def _finish(path: Path, source: Source, result: FitResult) -> FitOutcome:
    fit_json.write(path, result, source)
    return FitOutcome(source.name, path, fit_json.document(result, source))


def _earlier(target: Path, source: Source, settings: FitSettings) -> dict[str, Any] | None:
    """What an earlier run wrote for the same file and settings, or None."""
    if not target.is_file():
        return None
    try:
        content = fit_json.read(target)
    except ManifoldError:
        return None  # not a fit, or of another version: it is written anew
    return content if content["source"]["sha256"] == source.sha256 and settings.made(content) else None
