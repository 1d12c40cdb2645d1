"""`manifold budget`: paths in, results and assets out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from manifold.errors import UsageError
from manifold.experiments.budget import example_scenes, output_folder, representations, scene_survey, search
from manifold.experiments.budget.output_folder import OutputFolder
from manifold.experiments.budget.pictures import Pictures
from manifold.experiments.budget.representations import Candidate
from manifold.experiments.budget.scene_document import SceneDocument, SceneMaterial
from manifold.experiments.budget.scene_survey import MaterialLighting
from manifold.experiments.budget.search import Difference, Tolerance
from manifold.io_rgl import material_name, read_bsdf
from manifold.model import predicted_file
from manifold.model.colours import ColourChoice
from manifold.plots import figures
from manifold.plots.plot_budget import budget_figure
from manifold.records import Array, Progress
from manifold.rendering import backend, image_metrics, render
from manifold.system import temporary


@dataclass(frozen=True)
class BudgetSettings:
    """How a scene is analysed.

    Attributes:
        size: pixels of the longer side.
        samples: light paths per pixel.
        seed: of the noise.
    """

    size: int = 128
    samples: int = 128
    seed: int = 0

    def __post_init__(self) -> None:
        render.RenderSettings(self.size, self.samples, self.seed)  # checks them


_TOLERANCE, _SETTINGS = Tolerance(), BudgetSettings()


@dataclass(frozen=True)
class Chosen:
    """The answer for one material.

    Attributes:
        material: its name.
        representation: in words.
        reason: why nothing cheaper.
        lighting: where and by what light the scene shows it.
        size, full_size: bytes of the answer, and of the whole file.
        numbers: how many describe it, where there is no file.
        milliseconds: for a million evaluations.
        predicted: CIEDE2000 by direct light.
        verified: difference of the renders, all materials exchanged.
        noise: difference of two renders of the reference with different seeds.
        asset: file that was written.
        bsdf: dictionary of Mitsuba.
        candidates: all of them: name, size, predicted, and where rendered alone, verified.
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
    candidates: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Budget:
    """The answer for a scene.

    Attributes:
        scene: its name.
        tolerance: what was asked for.
        chosen: per material that is seen.
        unseen: bytes of the materials that no pixel shows, by name; they stay as they are.
        notes: what a user should know, one line each.
        output: the scene that was written.
        backend: `llvm` or `scalar`.
        settings: how it was analysed.
    """

    scene: str
    tolerance: Tolerance
    chosen: tuple[Chosen, ...]
    unseen: tuple[tuple[str, int], ...]
    notes: tuple[str, ...]
    output: Path | None
    backend: str
    settings: BudgetSettings

    @property
    def size(self) -> int:
        """Bytes of all materials, those that stay among them."""
        return sum(one.size for one in self.chosen) + sum(size for _, size in self.unseen)

    @property
    def full_size(self) -> int:
        """Bytes of all whole files."""
        return sum(one.full_size for one in self.chosen) + sum(size for _, size in self.unseen)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        materials = [
            asdict(one) | {"asset": _path_text(one.asset), "bsdf": dict(one.bsdf)} for one in self.chosen
        ]
        return {
            "scene": self.scene,
            "tolerance": asdict(self.tolerance),
            "settings": asdict(self.settings),
            "backend": self.backend,
            "bytes": self.size,
            "full_bytes": self.full_size,
            "materials": materials,
            "unseen": [{"material": name, "bytes": size} for name, size in self.unseen],
            "notes": list(self.notes),
            "output": _path_text(self.output),
        }


def _path_text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def example(
    name: str, tolerance: Tolerance = _TOLERANCE, settings: BudgetSettings = _SETTINGS,
    output: Path | None = None, on_progress: Progress | None = None, picture: Path | None = None,
) -> Budget:  # fmt: skip
    """Budget one of the package's own scenes. Raises: as `example_scenes.write` and `budget_scene`."""
    with temporary.folder() as folder:
        scene = example_scenes.write(name, folder)
        return budget_scene(scene, tolerance, settings, output, on_progress, picture)


@backend.variant_kept()
def budget_scene(
    scene: Path | Mapping[str, Any],
    tolerance: Tolerance = _TOLERANCE,
    settings: BudgetSettings = _SETTINGS,
    output: Path | None = None,
    on_progress: Progress | None = None,
    picture: Path | None = None,
) -> Budget:
    """Find the cheapest representation of each measured material of a scene that keeps its picture.

    Args:
        scene: XML or JSON file, or a dictionary of Mitsuba made of plain values.
        tolerance: how much the picture may differ, and what it may cost.
        settings: how the scene is analysed.
        output: folder for the chosen files and a scene that uses them; made if missing.
        on_progress: called with (done, total, what).
        picture: also draw both renders, and what every representation costs.
    Raises:
        UsageError: see `SceneDocument`, `scene_survey.survey`, `budget.search` and `OutputFolder`; or bands are mixed.
        FileFormatError: the scene or a measured file is damaged.
    """
    document = SceneDocument.read(scene)
    if picture is not None:
        figures.require_writable(picture)
    if output is not None:
        output_folder.require_makeable(output)
        read = [document.origin, *(m.properties.get("filename", "") for m in document.materials)]
        output_folder.require_apart(output, read)
    step = on_progress or (lambda _done, _total, _what: None)
    with temporary.folder() as folder, backend.only_errors():
        step(0, 4, "reading")
        files = {}
        for k, material in enumerate(document.materials):
            (folder / f"predicted_{k}").mkdir()
            files[material.key] = _measured_file(material, folder / f"predicted_{k}")
        is_rgb = _common_kind(files)
        names = output_folder.asset_names(files, is_rgb)
        target = None
        if output is not None:
            scene_name = f"{Path(document.origin).stem.replace(' ', '_')}{document.suffix}"
            target = OutputFolder(output, scene_name, names.values())
        step(1, 4, "analysing the scene")
        survey = scene_survey.survey(document, files, is_rgb, settings.size)
        step(2, 4, "representations")
        candidates = {}
        for k, (key, lighting) in enumerate(survey.lighting.items()):
            (folder / str(k)).mkdir()
            candidates[key] = representations.candidates(files[key], lighting, survey, folder / str(k))
        step(3, 4, "rendering")
        times = cache(lambda candidate: representations.milliseconds(candidate.bsdf, is_rgb))
        pictures = Pictures(document, files, survey, settings.samples, settings.seed)
        unseen = tuple(
            (material_name(path), path.stat().st_size) for key, path in files.items() if key not in candidates
        )
        others = sum(size for _, size in unseen)
        answer = search.search(candidates, tolerance, pictures.differences, times, others)
        noise = pictures.noise()
        chosen = tuple(
            _chosen(
                material_name(files[key]), survey.lighting[key], candidates[key], answer, key, noise, times
            )
            for key in candidates
        )
        if picture is not None:
            _draw(picture, pictures.beside(answer.choice), chosen, tolerance)
        assets: dict[str, Path] = {}
        if target is not None:
            assets = _write(document, target, names, dict(zip(candidates, chosen, strict=True)))
        chosen = tuple(_with_asset(one, assets.get(key)) for key, one in zip(candidates, chosen, strict=True))
    step(4, 4, "done")
    return Budget(
        scene=document.origin,
        tolerance=tolerance,
        chosen=chosen,
        unseen=unseen,
        notes=_notes(chosen, tolerance, [name for name, _ in unseen]),
        output=None if target is None else target.scene,
        backend=backend.choose().kind,
        settings=settings,
    )


def _draw(path: Path, both: tuple[Array, Array], chosen: tuple[Chosen, ...], tolerance: Tolerance) -> None:
    delta_e = image_metrics.ciede2000_map(*both)
    figure = budget_figure(*both, delta_e, [vars(one) for one in chosen], tolerance.delta_e)
    figures.save(figure, path)


def _measured_file(material: SceneMaterial, folder: Path) -> Path:
    """The file of a material; predictions are written first."""
    properties = material.properties
    if material.kind == "measured":
        path = Path(properties.get("filename", ""))
        if not path.is_file():
            raise UsageError(f"{path}: no such file; a BSDF of the type measured in the scene names it")
        return path
    if "model" not in properties or "latent" not in properties:
        raise UsageError("a manifold BSDF in the scene has no model or no latent; give both")
    try:
        latent = [float(part) for part in properties["latent"].split(",")]
    except ValueError:
        raise UsageError(
            f"a manifold BSDF has the latent '{properties['latent']}', expected numbers like '-0.3,1.2'"
        ) from None
    path = folder / f"predicted_{'_'.join(f'{v:g}' for v in latent)}.bsdf"
    reflectance, library = (
        Path(properties[n]) if n in properties else None for n in ("reflectance", "library")
    )
    colour = ColourChoice(properties.get("like"), reflectance, properties.get("srgb"))
    predicted_file.predict(
        Path(properties["model"]), latent, path, library=library, colour=colour, force=True
    )
    return path


def _common_kind(files: Mapping[str, Path]) -> bool:
    """Whether all files are linear sRGB."""
    kinds = {path: read_bsdf(path).bands.is_rgb for path in files.values()}
    if len(set(kinds.values())) > 1:
        rgb = next(path for path, is_rgb in kinds.items() if is_rgb)
        raise UsageError(f"{rgb}: an RGB file in a scene with spectral ones; use the _spec files throughout")
    return next(iter(kinds.values()))


# -- the answer -----------------------------------------------------------------------------------------------


def _chosen(
    name: str, lighting: MaterialLighting, candidates: list[Candidate], answer: search.Answer, key: str,
    noise: Mapping[str, Difference], times: Callable[[Candidate], float],
) -> Chosen:  # fmt: skip
    candidate, alone = answer.choice[key], answer.alone[key]
    return Chosen(
        material=name,
        representation=candidate.name,
        reason=_reason(candidates[: candidates.index(candidate)], alone),
        lighting=_lighting_in_words(lighting),
        size=candidate.size,
        full_size=next(c.size for c in candidates if c.is_full),
        numbers=candidate.numbers,
        milliseconds=times(candidate),
        predicted=candidate.predicted,
        verified=answer.together[key],
        noise=noise[key],
        asset=candidate.path,
        bsdf=candidate.bsdf,
        candidates=tuple(
            {
                "name": one.name,
                "bytes": one.size,
                "predicted": one.predicted,
                "verified": asdict(alone[one.name]) if one.name in alone else None,
            }
            for one in candidates
        ),
    )


def _reason(cheaper: list[Candidate], alone: Mapping[str, Difference]) -> str:
    """Why nothing cheaper: what comes closest among it."""
    if not cheaper:
        return "no representation is cheaper"
    rendered = [one for one in cheaper if one.name in alone]
    if rendered:
        best = min(rendered, key=lambda one: alone[one.name].delta_e)
        return f"best of the cheaper ones: {best.name}, CIEDE2000 {alone[best.name].delta_e:.2f}"
    best = min(cheaper, key=lambda one: one.predicted)
    return f"best of the cheaper ones: {best.name}, predicted {best.predicted:.1f}"


def _lighting_in_words(lighting: MaterialLighting) -> str:
    """The lighting and views of a material in the scene, in words."""
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
            f"the difference due to noise is {loudest:.2f}, far above the tolerance; use more --samples"
        )
    return tuple(notes)


def _with_asset(one: Chosen, asset: Path | None) -> Chosen:
    bsdf = dict(one.bsdf)
    if asset is not None:
        bsdf["filename"] = str(asset)
    elif "filename" in bsdf:
        bsdf["filename"] = None  # of a temporary file
    return replace(one, asset=asset, bsdf=bsdf)


def _write(
    document: SceneDocument, target: OutputFolder, names: Mapping[str, str], chosen: Mapping[str, Chosen]
) -> dict[str, Path]:
    """Copy the chosen files and write a scene that uses them; the files that were written, by key."""
    bsdfs = {key: one.bsdf for key, one in chosen.items()}
    sources = {key: one.asset for key, one in chosen.items() if one.asset is not None}
    target.prepare(names[key] for key in sources)
    assets = {}
    for key, source in sources.items():
        assets[key] = target.copy(source, names[key])
        filename = names[key] if document.suffix == ".xml" else str(assets[key].absolute())
        bsdfs[key] = {"type": "measured", "filename": filename}
    document.write(target.scene, bsdfs)
    return assets
