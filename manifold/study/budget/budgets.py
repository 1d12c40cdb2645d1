"""Analyses a scene for `manifold budget`, and writes the chosen files."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from manifold.core import disk
from manifold.core.errors import MissingFileError, UsageError
from manifold.core.progress import Stages
from manifold.core.records import plain
from manifold.estimate import predictions
from manifold.io_rgl import material_name, read_bsdf
from manifold.library.identity import require_outside_libraries
from manifold.many.batch import make_folder
from manifold.model.colours import ColourChoice
from manifold.pictures import figures
from manifold.render import backend, images, render
from manifold.study.budget import example_scenes, representations, scene_survey, search
from manifold.study.budget.budget_figure import budget_figure
from manifold.study.budget.representations import Representation
from manifold.study.budget.scene_document import SceneDocument, SceneMaterial
from manifold.study.budget.scene_survey import MaterialLighting
from manifold.study.budget.search import Difference, Tolerance
from manifold.study.budget.verification import Pictures


@dataclass(frozen=True)
class BudgetSettings:
    """The settings of the renders that analyse a scene.

    Attributes:
        size: size of the longer side in pixels.
        samples: light paths per pixel.
        seed: seed of the noise.
    """

    size: int = 128
    samples: int = 128
    seed: int = 0

    def __post_init__(self) -> None:
        render.RenderSettings(self.size, self.samples, self.seed)  # checks them


_TOLERANCE, _SETTINGS = Tolerance(), BudgetSettings()


class Candidate(NamedTuple):
    """A representation that could be chosen: its size, and its predicted and verified differences."""

    name: str
    bytes: int
    predicted: float
    verified: Difference | None


@dataclass(frozen=True, eq=False)
class Chosen:
    """The representation that was chosen for one material, and its cost.

    Attributes:
        representation: name of the chosen candidate.
        reason: why no cheaper representation was chosen.
        lighting: the directions and the light in which the scene shows the material.
        size, full_size: bytes of the chosen representation and of the whole file.
        numbers: number of parameters of the chosen representation; None for files.
        milliseconds: time of a million evaluations.
        predicted: predicted CIEDE2000 of the chosen representation.
        verified: difference of the renderings in which all materials are replaced.
        noise: difference of two renderings of the reference with different seeds.
        asset: path of the written file.
        bsdf: Mitsuba's dictionary of the chosen representation, without the name of a file that was not written.
        candidates: all candidates, cheapest first.
    """

    material: str
    representation: str
    reason: str
    lighting: str
    size: int
    full_size: int
    numbers: int | None
    milliseconds: float
    predicted: float
    verified: Difference
    noise: Difference
    asset: Path | None
    bsdf: Mapping[str, Any]
    candidates: tuple[Candidate, ...]


class Unseen(NamedTuple):
    """A material that no pixel shows, which stays unchanged."""

    material: str
    bytes: int


@dataclass(frozen=True)
class Budget:
    """The chosen representations of all materials of a scene.

    Attributes:
        backend: `llvm` or `scalar`.
        bytes, full_bytes: bytes of all chosen representations, and of all whole files.
        materials: the choice for each visible material.
        notes: notes for the user, one line each.
        output: the written scene.
    """

    scene: str
    tolerance: Tolerance
    settings: BudgetSettings
    backend: str
    bytes: int
    full_bytes: int
    materials: tuple[Chosen, ...]
    unseen: tuple[Unseen, ...]
    notes: tuple[str, ...]
    output: Path | None


def example(
    name: str, tolerance: Tolerance = _TOLERANCE, settings: BudgetSettings = _SETTINGS,
    output: Path | None = None, picture: Path | None = None,
) -> Budget:  # fmt: skip
    """Return the budget of one of the package's own scenes."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scene = example_scenes.write(name, folder)
        return budget_scene(scene, tolerance, settings, output, picture)


@backend.variant_kept()
def budget_scene(
    scene: Path | Mapping[str, Any],
    tolerance: Tolerance = _TOLERANCE,
    settings: BudgetSettings = _SETTINGS,
    output: Path | None = None,
    picture: Path | None = None,
) -> Budget:
    """Find the cheapest representation of each measured material of a scene that keeps its picture.

    The scene is an XML or JSON file, or a Mitsuba dictionary of plain values. The chosen files and a scene
    that uses them are written to the folder `output`, which is created if missing; `picture` shows both renderings
    and the cost of every representation.
    """
    document = SceneDocument.read(scene)
    if picture is not None:
        figures.require_writable(picture)
    if output is not None:
        require_outside_libraries(output, into=True)
    stages = Stages(dict.fromkeys(("reading", "analysing the scene", "representations", "rendering"), 1))
    with TemporaryDirectory() as temporary, backend.only_errors():
        folder = Path(temporary)
        stages.begin("reading")
        files = {
            m.key: _measured_file(m, folder / f"predicted_{k}") for k, m in enumerate(document.materials)
        }
        is_rgb = _common_kind(files)
        target = None if output is None else output / f"{Path(document.origin).stem.replace(' ', '_')}.xml"
        names = _asset_names(files, is_rgb)
        if target is not None:
            _require_no_inputs(target, names.values(), [Path(document.origin), *files.values()])
            make_folder(target.parent, "the scene")
        stages.begin("analysing the scene")
        survey = scene_survey.survey(document, files, is_rgb, settings.size)
        stages.begin("representations")
        candidates = {
            key: representations.candidates(files[key], lighting, survey, folder / str(k))
            for k, (key, lighting) in enumerate(survey.lighting.items())
        }
        stages.begin("rendering")
        times = cache(lambda candidate: representations.milliseconds(candidate.bsdf, is_rgb))
        pictures = Pictures(document, files, survey, settings.samples, settings.seed)
        unseen = tuple(
            Unseen(material_name(path), path.stat().st_size)
            for key, path in files.items()
            if key not in candidates
        )
        answer = search.search(
            candidates, tolerance, pictures.differences, times, sum(one.bytes for one in unseen)
        )
        noise = pictures.noise()
        assets = {} if target is None else _write(document, target, names, answer.choice)
        chosen = tuple(
            Chosen(
                material=material_name(files[key]),
                representation=one.name,
                reason=_reason(candidates[key][: candidates[key].index(one)], answer.alone[key]),
                lighting=_lighting_in_words(survey.lighting[key]),
                size=one.size,
                full_size=next(c.size for c in candidates[key] if c.is_full),
                numbers=one.numbers,
                milliseconds=times(one),
                predicted=one.predicted,
                verified=answer.together[key],
                noise=noise[key],
                asset=assets.get(key),
                bsdf={
                    name: assets.get(key) if name == "filename" else value for name, value in one.bsdf.items()
                },
                candidates=tuple(
                    Candidate(c.name, c.size, c.predicted, answer.alone[key].get(c.name))
                    for c in candidates[key]
                ),
            )
            for key, one in answer.choice.items()
        )
        if picture is not None:
            both = pictures.beside(answer.choice)
            shown = [plain(one) for one in chosen]
            delta_e = images.ciede2000_map(*both)
            figures.save(budget_figure(*both, delta_e, shown, tolerance.delta_e), picture)
    kept = sum(one.bytes for one in unseen)
    return Budget(
        scene=document.origin,
        tolerance=tolerance,
        settings=settings,
        backend=backend.choose().kind,
        bytes=sum(one.size for one in chosen) + kept,
        full_bytes=sum(one.full_size for one in chosen) + kept,
        materials=chosen,
        unseen=unseen,
        notes=_notes(chosen, tolerance, [one.material for one in unseen]),
        output=target,
    )


def _measured_file(material: SceneMaterial, folder: Path) -> Path:
    """Return the file of a material; predictions are written first."""
    properties = material.properties
    if material.kind == "measured":
        path = Path(properties.get("filename", ""))
        if not path.is_file():
            raise MissingFileError(
                f"{path}: no such file; correct the file name of the BSDF of type measured in the scene"
            )
        return path
    if "model" not in properties or "latent" not in properties:
        raise UsageError("a manifold BSDF in the scene has no model or no latent; give both")
    try:
        latent = [float(part) for part in properties["latent"].split(",")]
    except ValueError:
        raise UsageError(
            f"a manifold BSDF has the latent '{properties['latent']}', expected numbers like '-0.3,1.2'"
        ) from None
    folder.mkdir()
    path = folder / f"predicted_{'_'.join(f'{v:g}' for v in latent)}.bsdf"
    reflectance, library = (
        Path(properties[n]) if n in properties else None for n in ("reflectance", "library")
    )
    colour = ColourChoice(properties.get("like"), reflectance, properties.get("srgb"))
    predictions.predict(
        Path(properties["model"]),
        latent,
        path,
        library=library,
        colour=colour,
    )
    return path


def _common_kind(files: Mapping[str, Path]) -> bool:
    """Return whether all files are linear sRGB."""
    kinds = {path: read_bsdf(path).bands.is_rgb for path in files.values()}
    if len(set(kinds.values())) > 1:
        rgb = next(path for path, is_rgb in kinds.items() if is_rgb)
        raise UsageError(f"{rgb}: an RGB file in a scene with spectral files; use only _spec files")
    return next(iter(kinds.values()))


# -- the answer -----------------------------------------------------------------------------------------------


def _reason(cheaper: list[Representation], alone: Mapping[str, Difference]) -> str:
    """Return why nothing cheaper was chosen, with the closest of the cheaper representations."""
    if not cheaper:
        return "no representation is cheaper"
    rendered = [one for one in cheaper if one.name in alone]
    if rendered:
        best = min(rendered, key=lambda one: alone[one.name].delta_e)
        return f"best of the cheaper ones: {best.name}, CIEDE2000 in the scene's light {alone[best.name].delta_e:.2f}"
    best = min(cheaper, key=lambda one: one.predicted)
    return f"best of the cheaper ones: {best.name}, predicted {best.predicted:.1f}"


def _lighting_in_words(lighting: MaterialLighting) -> str:
    """Describe the lighting and views of a material in the scene."""
    (a, b), (c, d) = lighting.angles_deg(lighting.wi), lighting.angles_deg(lighting.wo)
    text = f"{100 * lighting.share:.0f} % of the picture, seen at {a:.0f}-{b:.0f} deg, lit at {c:.0f}-{d:.0f} deg"
    if lighting.bands.is_rgb:
        return text
    spectrum = lighting.spectrum
    effective = float(spectrum.sum() ** 2 / (spectrum**2).sum()) / len(spectrum)
    return f"{text}, by light in {100 * effective:.0f} % of the spectrum"


def _notes(chosen: tuple[Chosen, ...], tolerance: Tolerance, hidden: list[str]) -> tuple[str, ...]:
    notes = [f"no pixel shows {name} in direct light; it is kept unchanged" for name in hidden]
    loudest = max(one.noise.rendered for one in chosen)
    if loudest > 2.0 * tolerance.delta_e:
        notes.append(
            f"the difference due to noise is {loudest:.2f}, far above the tolerance; use more samples"
        )
    return tuple(notes)


def _asset_names(files: Mapping[str, Path], is_rgb: bool) -> dict[str, str]:
    """Return the unique file name of each material in the output folder, by key."""
    kind = "rgb" if is_rgb else "spec"
    names: dict[str, str] = {}
    for key, path in files.items():
        base, k = material_name(path), 2
        while f"{base}_{kind}.bsdf" in names.values():
            base, k = f"{material_name(path)}_{k}", k + 1
        names[key] = f"{base}_{kind}.bsdf"
    return names


def _require_no_inputs(target: Path, names: Iterable[str], inputs: Sequence[Path]) -> None:
    """Raise UsageError if the scene or a file beside it would replace an input."""
    read = {path.resolve() for path in inputs}
    for path in (target, *(target.parent / name for name in names)):
        if path.resolve() in read:
            raise UsageError(f"{path}: this command would replace its own input; name another folder")


def _write(
    document: SceneDocument, target: Path, names: Mapping[str, str], choice: Mapping[str, Representation]
) -> dict[str, Path]:
    """Copy the chosen files beside a scene that uses them; the files that were written, by key."""
    bsdfs, assets = {key: one.bsdf for key, one in choice.items()}, {}
    for key, one in choice.items():
        if one.path is not None:
            assets[key] = target.parent / names[key]
            with disk.replacing(assets[key]) as partial:
                shutil.copyfile(one.path, partial)
            bsdfs[key] = {"type": "measured", "filename": names[key]}
    document.write(target, bsdfs)
    return assets
