"""Implements `manifold export`: writes a fit, a prediction or a measured file for a rendering engine."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifold.brdf.interface import BRDF, EvaluableBRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.orientation import aligned
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour.difference import VISIBLE
from manifold.colour.panel import SUN_DEG
from manifold.core import disk, shipped
from manifold.core.errors import UsageError
from manifold.core.judged_lights import BALL, BALL_COLUMN, LIGHTS, light_in_words
from manifold.core.metrics import Errors
from manifold.core.names import exceeds
from manifold.core.progress import Stages
from manifold.core.records import BsdfFile
from manifold.estimate.inputs import find_inputs
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource
from manifold.fit import fit_samples, fits
from manifold.fit.exports.direct import at_bounds, fit_target
from manifold.fit.exports.document import Export, TextureFiles
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.fit.exports.targets import Target, TargetBRDF, target_of
from manifold.fit.fit_metrics import ball_errors, missed_highlight
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import fit_bsdf
from manifold.formats.recognition import is_fit, is_library, is_rgl
from manifold.io_rgl import material_name, read_bsdf
from manifold.library.identity import file_sha256
from manifold.library.store import Library
from manifold.many.batch import Batch, BatchCommand, Content, Outcome
from manifold.model.colours import ColourChoice
from manifold.model.diagnostics import predict_and_diagnose
from manifold.model.manifold import load_model
from manifold.model.places import PlaceLike
from manifold.pictures import export_sheet, figures, html_page
from manifold.pictures import fit_comparison as comparison
from manifold.pictures.slice_figures import ShownBRDF
from manifold.registries import FIT_SUFFIX, TARGETS
from manifold.render import fit_json
from manifold.render.fitted_brdf import FittedBRDF

SHEET = "exports"
"""End of the name of a picture that shows a material and several of its exports."""
_PACK_PAGE, _PACK_BALLS = "index.html", "balls"  # page of a pack, and the folder of its pictures


@dataclass(frozen=True, eq=False)
class Subject:
    """A material to be exported.

    Attributes:
        source: origin of the material, as plain values.
        fit: content of its fit's JSON.
        material: the BRDF against which the error is measured; None means the fit itself.
        against: word for that BRDF: `measured file` or another origin, `prediction` or `fit`.
        notes: diagnostics of a prediction.
    """

    name: str
    source: dict[str, Any]
    fit: dict[str, Any]
    material: BRDF | None
    against: str
    notes: tuple[str, ...] = ()

    @cached_property
    def fitted(self) -> FittedBRDF:
        """The fit, as a BRDF."""
        return FittedBRDF(self.fit)

    @property
    def truth(self) -> EvaluableBRDF:
        """Return the BRDF to which targets are fitted: the material, or the fit if there is none."""
        return self.fitted if self.material is None else self.material

    @cached_property
    def samples(self) -> FitSamples:
        """Return samples of the BRDF to which targets are fitted."""
        return fit_samples.from_brdf(self.truth)

    @cached_property
    def principled_errors(self) -> Errors[float] | None:
        """Return the errors of the fit of `principled`; None if there is no material."""
        return None if self.material is None else ball_errors(self.fitted, self.material)


def subject_of_source(source: MaterialSource, against: Path | None) -> Subject:
    """Fit the material that a user names, and return both; `against` is described in `subject_of`."""
    if isinstance(source, FileSource):
        return subject_of(source.path, against)
    if against is not None:
        raise UsageError(f"{source}: --against {against} works only with the JSON of a fit; leave it out")
    if isinstance(source, LibrarySource):
        return subject_in_library(Library(source.library), source.name)
    return subject_of_prediction(source.model, source.place, library=source.library, colour=source.colour)


def subject_of(path: Path, against: Path | None = None) -> Subject:
    """Return the material to export: the fit in a JSON file, or a new fit to a `.bsdf` file.

    For a fit, `against` is the measured file with which the export is compared; None compares it with the fit.
    """
    if is_rgl(path):
        if against is not None:
            raise UsageError(f"{path}: --against {against} works only with the JSON of a fit; leave it out")
        return subject_of_file(read_bsdf(path), {"file": path.name, "sha256": file_sha256(path)})
    content = fit_json.read(path)
    source = {"fit": path.name, "sha256": file_sha256(path), "of": content["source"]}
    name = content["source"]["name"]
    if against is None:
        return Subject(name, source, content, None, "fit")
    file = read_bsdf(against)
    # as the fitted sample lay, which a library may have turned
    material = MeasuredBRDF(aligned(file)).turned(np.deg2rad(content.get("rotation_deg", 0.0)))
    return Subject(name, source, content, material, f"{file.origin} file")


def subject_of_prediction(
    model: Path, latent: PlaceLike, *, library: Path | None, colour: ColourChoice
) -> Subject:
    """Fit the material that a model predicts at a latent."""
    stages = Stages({"reading materials": 3, "fitting": 7})
    loaded = load_model(model, library)
    place = loaded.place(latent)
    stages.begin("reading materials")
    loaded.prepare()
    predicted = predict_and_diagnose(loaded, place, colour)
    name = latent if isinstance(latent, str) and latent in loaded.names else "predicted"
    source = {
        "model": shipped.named(model.name),
        "model_sha256": file_sha256(shipped.model_file(model)),
        "latent": None if predicted.latent is None else predicted.latent.tolist(),
        "walk": predicted.walk,
        "colour": predicted.colour,
    }
    stages.begin("fitting")
    fit = fits.document(fit_bsdf(predicted.brdf), fit_json.FitSource(name))
    return Subject(name, source, fit, predicted.brdf, "prediction", predicted.diagnostics)


def subject_of_file(file: BsdfFile, source: dict[str, Any]) -> Subject:
    """Fit the material of a file; `source` holds its origin as plain values."""
    fit = fits.document(fit_bsdf(file), fit_json.FitSource(file.name))
    return Subject(file.name, source, fit, MeasuredBRDF(fill_unmeasured(file)), f"{file.origin} file")


def subject_in_library(library: Library, name: str) -> Subject:
    """Fit a material of a library."""
    info = library.attributes(name)
    described = {"library": shipped.named(library.path.name), "file": info.source_file, "sha256": info.sha256}
    return subject_of_file(library.read(name), described)


def export(
    subject: Subject | MaterialSource, target: Target | str | None, path: Path, *, against: Path | None = None,
    picture: Path | None = None, balls: Path | None = None,
    textures: Callable[[Mapping[str, Any]], TextureFiles] | None = None,
) -> Outcome[Subject]:  # fmt: skip
    """Write a material for an export target; a target of None is chosen by the suffix of the file.

    The target's own shading model is fitted to the material, starting from the parameters of `principled`. If
    programs implement the model differently, pictures show the worst one. The result also holds the parameters and
    errors for a second target in the same file (`beside`), and the errors without a view-dependent base colour, if
    there is one.

    Args:
        subject: the material.
        target: the target or its name; None chooses it by the suffix of `path`.
        path: the file to write.
        against: measured file for the comparison, see `subject_of_source`.
        picture: file for a plot of the material and the fitted model; None draws none.
        balls: file for balls of both in two lights; None draws none.
        textures: function that writes textures for the fitted parameters; None gives the surface one material.
    """
    target = target if isinstance(target, Target) else target_of(target, path)
    disk.require_writable(path)
    if picture is not None:
        figures.require_writable(picture)
    if not isinstance(subject, Subject):
        stages = Stages({"": 8, "evaluating the target's model": 2})
        stages.begin("")
        subject = subject_of_source(subject, against)
        stages.begin("evaluating the target's model")
    rotation_deg = subject.fit.get("rotation_deg", 0.0)
    principled = PrincipledValues.from_fit(subject.fit["bsdf"], subject.fit["values"], rotation_deg)
    start, material = target.parameters(principled), subject.truth
    is_flattened = principled.anisotropic > 0.0 and start == target.parameters(
        replace(principled, anisotropic=0.0)
    )
    parameters = fit_target(target, start, subject.samples)
    other = None if target.beside is None else TARGETS[target.beside]
    beside = None if other is None else fit_target(other, other.parameters(principled), subject.samples)
    exported = _Exported.of(target, parameters, material)
    errors, worst, model = exported.each, exported.worst, exported.model
    made = Export(
        name=subject.name,
        target=target.name,
        parameters=parameters,
        source=subject.source,
        errors=errors[worst],
        principled_errors=subject.principled_errors,
        against=subject.against,
        beside=beside,
        textures=None if textures is None else textures(parameters),
        implementations={name: each for name, each in errors.items() if name is not None},
        colour_space=target.colour_space,
        caveat=target.caveat,
    )
    disk.write_bytes(path, target.content(made))
    if picture is not None:
        drawn = f"exported: {target.name}" + (f", {worst}" if worst else "")
        sources = [ShownBRDF(subject.against, material), ShownBRDF(drawn, model)]
        comparison.picture_of_brdfs(subject.name, sources, picture)
    content = made.to_json()
    if other is not None and beside is not None:
        of_other = _Exported.of(other, beside, material)
        content["beside"] = {"target": other.name, "parameters": beside, "errors": of_other.errors.to_json()}
    if target.curve and parameters[target.curve[0]]:
        plain = _Exported.of(target, {**parameters, target.curve[0]: []}, material)
        content["without_curve"] = plain.errors.to_json()
    if balls is not None:
        _write_balls(balls, subject, content)
    notes = (*subject.notes, *([target.caveat] if target.caveat else []))
    if exceeds(made.errors.ball, VISIBLE, 1):
        light = f"{made.errors.worst:.1f} in the worst light ({light_in_words(made.errors.worst_light)})"
        away = f"{made.errors.ball:.1f} {BALL} from the {subject.against}"
        notes = (f"not a close fit: {away}, above {VISIBLE:g}; {light}", *notes)
        if (missed := missed_highlight(model, material)) is not None:
            notes = (missed, *notes)
    if ends := at_bounds(target, parameters):
        notes = (f"at the end of the range: {', '.join(ends)}", *notes)
    if is_flattened:
        notes = (f"anisotropic, but {target.name} has no anisotropy: the same at all azimuths", *notes)
    return Outcome(subject.name, path, subject, content, notes=notes)


class _Exported(NamedTuple):
    """A target's model with parameters: its errors by implementation, and the worst of them."""

    each: dict[str | None, Errors[float]]
    worst: str | None
    model: TargetBRDF

    @property
    def errors(self) -> Errors[float]:
        """Errors of the worst implementation."""
        return self.each[self.worst]

    @classmethod
    def of(cls, target: Target, parameters: Mapping[str, Any], material: EvaluableBRDF) -> _Exported:
        """Compare a target's model with a material."""
        models = {name: TargetBRDF(target, parameters, name) for name in target.implementations or [None]}
        each = {name: ball_errors(model, material) for name, model in models.items()}
        worst = max(each, key=lambda name: each[name].ball)
        return cls(each, worst, models[worst])


def exported_model(content: Content) -> TargetBRDF:
    """Return the shading model that a result of `export` describes, in its worst implementation."""
    several = content.get("implementations") or {}
    worst = max(several, key=lambda name: several[name]["ball"]) if several else None
    return TargetBRDF(TARGETS[content["target"]], content["parameters"], worst)


class ExportSource(NamedTuple):
    """A material to export that is not yet read: its name, content identity, and a function that reads it."""

    name: str
    identity: str
    read: Callable[[], Subject]

    def __str__(self) -> str:
        return self.name

    def made_of(self) -> dict[str, Any]:
        """Return everything that the content depends on, as plain values."""
        return {"material": self.identity}


def exports(
    target: Target, *, with_pictures: bool = False, is_pack: bool = False
) -> BatchCommand[ExportSource]:
    """Return the batch command that writes the materials of `export_sources` for a target; existing files are kept.

    With pictures, each material is drawn beside the target's model into NAME_TARGET.png; a pack also has a page.
    """
    columns: dict[str, Callable[[Content], Any]] = {
        BALL_COLUMN: lambda content: content["errors"]["ball"],
        **{f"in {name}": partial(_ball_in, name) for name in target.implementations},
        "of principled": lambda content: (content["principled_errors"] or {}).get("ball"),
        "in the worst light": lambda content: content["errors"]["worst"],
        "worst light": lambda content: content["errors"]["worst_light"],
    }
    make = partial(_export, target=target, with_pictures=with_pictures, is_pack=is_pack)
    how = {"target": target.name} | ({"pack": True} if is_pack else {})
    conclude = partial(_write_index, target) if is_pack else None
    beside = partial(_pictures_of, target=target, with_pictures=with_pictures, is_pack=is_pack)
    return BatchCommand(
        "exports", make, how, target.file_suffix, columns=columns, beside=beside, conclude=conclude,
        is_shared=is_pack,
    )  # fmt: skip


def _ball_in(implementation: str, content: Content) -> float:
    ball: float = content["implementations"][implementation]["ball"]
    return ball


def exports_of_many(targets: Sequence[Target], *, with_pictures: bool = False) -> BatchCommand[ExportSource]:
    """Return the batch command that fits every material of `export_sources` once, and writes it for several targets.

    With pictures, balls of each material and its exports are drawn into NAME_exports.png.
    """
    columns: dict[str, Callable[[Content], Any]] = {
        f"{BALL_COLUMN}, {target.name}": partial(_ball_of, target.name) for target in targets
    }
    make = partial(_export_many, targets=targets, with_pictures=with_pictures)
    beside = partial(_files_beside, targets=targets, with_pictures=with_pictures)
    how = {"targets": [target.name for target in targets]}
    suffix = paths_for(Path(), "", targets)[0].name
    return BatchCommand("exports", make, how, suffix, columns=columns, beside=beside)


def _ball_of(target: str, content: Content) -> float:
    ball: float = content["targets"][target]["errors"]["ball"]
    return ball


def paths_for(folder: Path, name: str, targets: Sequence[Target]) -> list[Path]:
    """Return the file paths of a material for several targets."""
    return [folder / f"{name}{target.file_suffix}" for target in targets]


def picture_of(path: Path, target: Target) -> Path:
    """Return the path of the picture of an export, NAME_TARGET.png, because other commands write NAME.png."""
    name = path.name.removesuffix(target.suffix).removesuffix(f"_{target.name}")
    return path.with_name(f"{name}_{target.name}.png")


def _files_beside(
    path: Path, content: Content, *, targets: Sequence[Target], with_pictures: bool
) -> list[Path]:
    """Return the files of all but the first target, and the picture."""
    name = path.name.removesuffix(paths_for(Path(), "", targets)[0].name)
    return [
        *paths_for(path.parent, name, targets)[1:],
        *[path.parent / f"{name}_{SHEET}.png"] * with_pictures,
    ]


def _export_many(
    source: ExportSource, path: Path, *, targets: Sequence[Target], with_pictures: bool
) -> Content:
    subject = source.read()
    beside = _files_beside(path, {}, targets=targets, with_pictures=with_pictures)
    made = _write_all(subject, targets, [path, *beside[: len(targets) - 1]])
    if with_pictures:
        _write_balls(beside[-1], subject, *(one.content or {} for one in made))
    notes = [
        f"{target.name}: {note}" for target, one in zip(targets, made, strict=True) for note in one.notes
    ]
    contents = {target.name: one.content for target, one in zip(targets, made, strict=True)}
    return {"targets": contents, "notes": notes}


def _write_all(subject: Subject, targets: Sequence[Target], paths: Sequence[Path]) -> list[Outcome[Subject]]:
    return [export(subject, target, path) for target, path in zip(targets, paths, strict=True)]


def export_many(
    material: MaterialSource, targets: Sequence[Target], folder: Path, name: str, *, against: Path | None = None,
    picture: Path | None = None,
) -> list[Outcome[Subject]]:  # fmt: skip
    """Fit a material once, and write it for several targets into a folder, which is created if missing.

    `against` is described in `subject_of_source`; `picture` shows balls of the material and of all exports.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = paths_for(folder, name, targets)
    for path in paths:
        disk.require_writable(path)
    subject = subject_of_source(material, against)
    made = _write_all(subject, targets, paths)
    if picture is not None:
        _write_balls(picture, subject, *(one.content or {} for one in made))
    return made


def _pictures_of(
    path: Path, content: Content, *, target: Target, with_pictures: bool, is_pack: bool
) -> list[Path]:
    """Return the pictures that belong to an export."""
    ball = path.parent / _PACK_BALLS / f"{path.name.removesuffix(target.file_suffix)}.png"
    return [picture_of(path, target)] * with_pictures + [ball] * is_pack


def _write_index(target: Target, made: Batch[ExportSource]) -> None:
    """Write the page of a pack: materials beside their exports, with the differences, and what failed."""
    cards = []
    for one in made.outcomes:
        if one.content is not None:
            errors = one.content["errors"]
            words = f"{errors['ball']:.1f}, in {errors['worst_light']} {errors['worst']:.1f}"
            picture = f"{_PACK_BALLS}/{one.name}.png"
            cards.append(html_page.card(picture, f"balls of {one.name}", one.path.name, one.name, words))
    intro = (
        "Each picture: left the material, right its export; above in the studio, below under a sun "
        f"{SUN_DEG:.0f} degrees beside the view. CIEDE2000 of the ball between the two, in the mean of "
        f"{LIGHTS} that the fit did not use, and in the worst (sun N: a sun N degrees beside the view)."
    )
    failed = [f"{one.name}: {one.failure}" for one in made.outcomes if one.failure is not None]
    body = f"<main>{''.join(cards)}</main>" + html_page.Section("Not exported", notes=failed).html()
    html_page.write(made.folder / _PACK_PAGE, f"{len(cards)} materials for {target.title}", intro, body)


def _write_balls(path: Path, subject: Subject, *exports: Content) -> None:
    """Draw balls of a material and of its exports in two lights, with their differences."""
    columns = [export_sheet.SheetColumn(subject.against, subject.truth)]
    for content in exports:
        words = f"CIEDE2000 {content['errors']['ball']:.1f} ({LIGHTS})"
        columns.append(export_sheet.SheetColumn(content["target"], exported_model(content), words))
    path.parent.mkdir(parents=True, exist_ok=True)
    export_sheet.draw(subject.name, columns, path)


def _export(
    source: ExportSource, path: Path, *, target: Target, with_pictures: bool, is_pack: bool
) -> Content:
    picture = picture_of(path, target) if with_pictures else None
    balls = path.parent / _PACK_BALLS / f"{source.name}.png" if is_pack else None
    made = export(source.read(), target, path, picture=picture, balls=balls)
    return (made.content or {}) | {"notes": list(made.notes)}


def all_sources(materials: Sequence[MaterialSource]) -> list[ExportSource]:
    """Return the materials of several sources, including folders and libraries, without reading them."""
    found: list[ExportSource] = []
    for material in materials:
        if isinstance(material, FileSource) and (material.path.is_dir() or is_library(material.path)):
            found += export_sources(material.path)
        else:
            (one,) = find_inputs([material])
            identity = json.dumps(one.made_of(), sort_keys=True)
            found.append(ExportSource(one.name, identity, partial(subject_of_source, material, None)))
    return found


def export_sources(source: Path) -> list[ExportSource]:
    """List every material of a library, or every `.bsdf` file and fit in a folder (recursively), without reading."""
    if is_library(source):
        library = Library(source)
        return [
            ExportSource(
                name, library.attributes(name).content_sha256, partial(subject_in_library, library, name)
            )
            for name in library.names
        ]
    fits: dict[str, Path] = {}
    files: dict[str, Path] = {}
    for path in sorted(source.rglob("*")):
        kind = files if is_rgl(path) else fits if is_fit(path) else None
        if kind is None or not path.is_file():
            continue
        name = material_name(Path(path.name.removesuffix(FIT_SUFFIX)))
        if kind.setdefault(name, path) != path:
            raise UsageError(f"{path} and {kind[name]} have the same name; export them into two folders")
    found = []
    for name in sorted({*fits, *files}):
        used = [path for path in (fits.get(name), files.get(name)) if path is not None]
        found.append(ExportSource(name, "".join(map(file_sha256, used)), partial(subject_of, *used)))
    if not found:
        raise UsageError(
            f"{source}: neither a library nor a folder with .bsdf files or fits; name another source"
        )
    return found
