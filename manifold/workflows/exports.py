"""The work behind `manifold export`: a fit, a prediction or a file in; a file of an engine out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.colour import ball_colours
from manifold.errors import UsageError
from manifold.fitting import fit_json, fit_samples
from manifold.fitting.exports import loss, target_fit
from manifold.fitting.exports.direct import NOTICEABLE, fit_target
from manifold.fitting.exports.document import Export
from manifold.fitting.exports.principled_values import Principled
from manifold.fitting.exports.targets import Target, target_of
from manifold.fitting.fit_samples import FitSamples
from manifold.fitting.fitted_brdf import FittedBRDF
from manifold.fitting.principled import fit_bsdf
from manifold.io_rgl import read_bsdf
from manifold.library.identity import file_sha256
from manifold.model.colours import NEAREST, ColourChoice, choose_colour
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.records import Array, BsdfFile, Progress
from manifold.system import atomic
from manifold.system.stages import Stages


@dataclass(frozen=True, eq=False)
class Subject:
    """A material that is to be exported.

    Attributes:
        name: of the material.
        source: where it comes from, plain values.
        fit: content of its fit's JSON.
        material: what the loss is measured against; the fit itself if None.
        against: that in words.
    """

    name: str
    source: dict[str, Any]
    fit: dict[str, Any]
    material: BRDF | None
    against: str


@dataclass(frozen=True)
class ExportOutcome:
    """One material of a run.

    Attributes:
        name: of the material.
        path: the written file.
        export: what was written; None where that failed, or an earlier run did it.
        was_there: whether an earlier run had made it.
        failure: why there is none, else None.
        notes: of the fit.
    """

    name: str
    path: Path
    export: dict[str, Any] | None
    was_there: bool = False
    failure: str | None = None
    notes: tuple[str, ...] = ()


def target_for(name: str | None, path: Path, source: Path | None) -> Target:
    """The target of that name, or else the one that the file's suffix and the model of a fit tell.

    Raises:
        UsageError, FileFormatError: there is none, or the fit cannot be used.
    """
    is_fit = name is None and source is not None and source.suffix.lower() == ".json"
    entry = fit_json.read(source).get("target") if is_fit and source is not None else None
    return target_of(name, path, None if entry is None else entry["name"])


def subject_of(path: Path, against: Path | None = None) -> Subject:
    """The material of a fit's JSON or of a `.bsdf` file, which is fitted.

    Args:
        path: the file.
        against: for a fit, the measured file to compare with; the fit itself if None.
    Raises:
        UsageError, FileFormatError: a file cannot be used.
    """
    if path.suffix.lower() == ".bsdf":
        if against is not None:
            raise UsageError(
                f"--against needs the JSON of a fit, found {path}, which is compared with itself"
            )
        return subject_of_file(read_bsdf(path), {"file": path.name, "sha256": file_sha256(path)})
    content = fit_json.read(path)
    source = {"fit": path.name, "sha256": file_sha256(path), "of": content["source"]}
    measured, compared = None, "fit"
    if against is not None:
        measured, compared = MeasuredBRDF(read_bsdf(against)), "measured file"
    elif (entry := content.get("target")) is not None:
        compared = entry["against"]
        if not fit_json.is_untouched(content):
            raise UsageError(
                f"{path}: changed since it was fitted, so that its errors are no longer known; name the measured file "
                "with --against, or fit again"
            )
    return Subject(content["source"]["name"], source, content, measured, compared)


def subject_of_prediction(
    model: Path, latent: Place, *, library: Path | None = None, colour: ColourChoice = NEAREST,
    on_progress: Progress | None = None,
) -> Subject:  # fmt: skip
    """The material that a model predicts at a latent, fitted.

    Raises:
        UsageError, LatentError, ModelError: the model or the latent cannot be used.
    """
    stages = Stages(on_progress, {"reading materials": 3, "fitting": 7})
    loaded = Manifold.load(model, library)
    x = loaded.require_latent(latent)
    loaded.prepare(stages.begin("reading materials"))
    chosen = choose_colour(loaded, latent, colour)
    brdf = loaded.predict(latent, chosen.colours)
    name = latent if isinstance(latent, str) and latent in loaded.names else "predicted"
    source = {
        "model": model.name,
        "model_sha256": file_sha256(model),
        "latent": [float(v) for v in x],
        "colour": chosen.words,
    }
    return _fitted(name, source, fit_samples.from_brdf(brdf), brdf, "prediction", stages.begin("fitting"))


def subject_of_file(file: BsdfFile, source: dict[str, Any]) -> Subject:
    """A measured material, fitted, with plain values that say where it comes from."""
    return _fitted(file.name, source, fit_samples.from_file(file), MeasuredBRDF(file), "measured file")


def _fitted(
    name: str, source: dict[str, Any], samples: FitSamples, material: BRDF, against: str,
    on_progress: Progress | None = None,
) -> Subject:  # fmt: skip
    content = fit_json.document(fit_bsdf(samples, on_progress=on_progress), fit_json.Source(name))
    return Subject(name, source, content, material, against)


def export(subject: Subject, target: Target, path: Path, *, is_direct: bool = False) -> ExportOutcome:
    """Write a material for a target.

    Args:
        subject: the material.
        target: where to.
        path: the file.
        is_direct: fit the target's own model to the material, from the mapped parameters on; a fit of that model is
            written as it is.
    Raises:
        UsageError: the fit has no counterpart in engines, or is of another target's model; or the file cannot be
            written.
        FileFormatError: parameters in a fit of the target's model cannot be used.
    """
    principled = Principled.from_fit(subject.fit["bsdf"], subject.fit["values"])
    parameters, entry = target.parameters(principled), subject.fit.get("target")
    if entry is not None:
        is_direct = True
        parameters = target_fit.parameters(entry, target, subject.source.get("fit", subject.name))
    elif is_direct:
        material = FittedBRDF(subject.fit) if subject.material is None else subject.material
        parameters = fit_target(target, parameters, fit_samples.from_brdf(material), material)
    own, of_principled = _errors(subject, lambda view, light: target.brdf(parameters, view, light))
    made = Export(
        name=subject.name,
        target=target.name,
        parameters=parameters,
        source=subject.source,
        method="direct" if is_direct else "mapping",
        loss=own,
        principled_loss=of_principled,
        loss_against=subject.against,
    )
    atomic.write_bytes(path, target.content(made, principled))
    notes = tuple(subject.fit["notes"])
    if made.loss > NOTICEABLE and not is_direct:
        notes += (f"visibly different from the {made.loss_against}: --direct fits the target's own model",)
    return ExportOutcome(subject.name, path, made.to_json(), notes=notes)


def _errors(subject: Subject, model: Callable[[Array, Array], Array]) -> tuple[float, float | None]:
    """Mean CIEDE2000 on the ball of a target's model, and of `principled`: None where that is the reference."""
    entry = subject.fit.get("target")
    if entry is not None and subject.material is None:
        return entry["ciede2000"], entry["principled_ciede2000"]
    fitted = loss.material_xyz(FittedBRDF(subject.fit))
    if subject.material is None:
        return ball_colours.delta_e(loss.rgb_xyz(model), fitted), None
    reference = loss.material_xyz(subject.material)
    return ball_colours.delta_e(loss.rgb_xyz(model), reference), ball_colours.delta_e(fitted, reference)
