"""Textures and engine materials of a specimen, from its pictures and readings (`manifold surface`)."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import encode_srgb
from manifold.colour.reflectances import spectral_changes
from manifold.core import disk
from manifold.core.defaults import SURFACE_TARGETS
from manifold.core.errors import UsageError
from manifold.core.judged_lights import BALL_COLUMN
from manifold.core.progress import Stages
from manifold.core.records import Array
from manifold.core.results import Result, derived, entry
from manifold.estimate.completions import Completed, complete, file_name
from manifold.fit.exports.document import TextureFiles
from manifold.fit.exports.principled_values import ior_to_f0
from manifold.fit.exports.targets import Target
from manifold.formats.readings import Readings
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.many.batch import only_run_in
from manifold.registries import TARGETS
from manifold.render.images import write_display, write_image
from manifold.surface import preview
from manifold.surface.estimate import Surface, brightest, estimate_surface
from manifold.surface.lamp_pictures import SurfacePictures
from manifold.surface.sparkle import DrawnFlakes, Flakes, Sparkle, sparkle_of
from manifold.surface.tiling import Textures, tile

_COAT_IORS = ("coat_ior", "coat ior")
_FEW_CUT = 0.005  # share of points that nobody misses
_VISIBLE_SPARKLE = 1.0  # glints per 10,000 pixels and lamp that a note mentions


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceFiles(Result):
    """The files of a written surface, and its statistics.

    Attributes:
        folder: the folder of the files.
        surface: the estimated surface of the specimen.
        sparkle: sparkle statistics of the specimen.
        textures: tiling textures.
        mm_per_pixel: width of a pixel of the textures; None if unknown.
        completed: the completed mean BRDF; None without readings.
        exports: ball errors (CIEDE2000) of the fitted engine models against the mean BRDF, by target.
        paths: paths of the written files by kind.
        notes: notes for the user, in sentences.
        seconds: total time.
    """

    surface: Surface

    @property
    @derived()
    def sample(self) -> str:
        """Name of the specimen."""
        return self.surface.name

    folder: Path = field(metadata=entry())
    textures: Textures

    @property
    @derived(row="pictures", words=lambda result: list(result.pictures))
    def pictures(self) -> tuple[str, ...]:
        """Labels of the pictures."""
        return tuple(self.surface.pictures.labels)

    @property
    @derived()
    def pixels(self) -> tuple[int, ...]:
        """Shape of the pictures."""
        return self.surface.third.shape

    @property
    @derived()
    def mean_srgb_linear(self) -> Array:
        """Mean colour, linear sRGB, shape (3,)."""
        return self.surface.mean

    @property
    @derived(
        row="colour variation",
        words=lambda result: "R {:.1f} %, G {:.1f} %, B {:.1f} % (standard deviation over mean)".format(
            *100.0 * result.albedo_std
        ),
    )  # fmt: skip
    def albedo_std(self) -> Array:
        """Standard deviation of the written albedo texture, divided by its mean, shape (3,)."""
        mean = self.surface.mean
        return np.asarray(np.minimum(mean * self.textures.albedo, 1.0).std(axis=(0, 1)) / mean)

    @property
    @derived(
        row="slopes", columns={"slope": (1,)},
        words=lambda result: "{:.3f} in x, {:.3f} in y (standard deviations)".format(*result.slope_std),
    )  # fmt: skip
    def slope_std(self) -> Array:
        """Standard deviation of the slopes of the normal texture, along x and y, shape (2,)."""
        return np.asarray(self.textures.slope.std(axis=(0, 1)))

    @property
    @derived()
    def gain(self) -> float:
        """Gain of the response to slope, see `Surface`."""
        return self.surface.gain

    @property
    @derived()
    def slope_uncertainty(self) -> Array:
        """Standard deviations of slopes, see `Surface`."""
        return self.surface.slope_std

    @property
    @derived(
        row="heights",
        words=lambda result: (
            f"{result.height_std_px:.2f} pixels"
            + (
                ""
                if result.mm_per_pixel is None
                else f", {result.mm_per_pixel * result.height_std_px:.2g} mm"
            )
            + " (standard deviation)"
        ),
    )
    def height_std_px(self) -> float:
        """Standard deviation of the height texture, in pixels."""
        return float(self.textures.height.std())

    mm_per_pixel: float | None = field(metadata=entry())
    sparkle: Sparkle = field(
        metadata=entry(
            row="sparkle", words="{.density:.1f} glints per lamp and 10,000 pixels", columns={"glints": ("density",)}
        )
    )  # fmt: skip

    @property
    @derived(
        row="flakes", json=False,
        words="{0.density:.0f} per 10,000 pixels, slopes {0.slope_std:.2f}, reflectance {0.reflectance:.3f}, roughness "
        "{0.roughness:.2f} (GGX alpha)",
    )  # fmt: skip
    def flakes(self) -> Flakes | None:
        """The flakes that would show the counted glints, see `Sparkle`."""
        return self.sparkle.flakes

    @property
    @derived(
        row="by the instrument",
        words=lambda result: [
            ", ".join(f"{key} {value}" for key, value in each.items()) for each in result.instrument
        ],
    )
    def instrument(self) -> list[dict[str, Any]]:
        """The instrument's graininess and sparkle, one entry per geometry, with the names of the workbook."""
        if self.completed is None:
            return []
        return [dict(values) for values in self.completed.completion.readings.texture.get("values", ())]

    paths: Mapping[str, Path]

    @property
    @derived(row="files", words=lambda result: list(result.files.values()))
    def files(self) -> dict[str, str]:
        """Names of the files in the folder, by kind."""
        return {kind: path.name for kind, path in self.paths.items()}

    exports: Mapping[str, float] = field(
        metadata=entry(
            json=lambda result: {target: {"ball": ball} for target, ball in result.exports.items()}
        )
    )
    completed: Completed | None

    @property
    @derived()
    def completion(self) -> Completed | None:
        """The completed mean BRDF; None without readings."""
        return self.completed

    notes: tuple[str, ...] = field(metadata=entry())
    seconds: float = field(metadata=entry())

    @property
    def rows(self) -> dict[str, object]:
        """Return the rows of the table, by label; last the errors of exports."""
        errors = {f"{target}, {BALL_COLUMN}": f"{ball:.2f}" for target, ball in self.exports.items()}
        return super().rows | errors


def make_surface(
    library: Path,
    pictures: SurfacePictures,
    readings: Readings | None,
    folder: Path,
    *,
    name: str | None = None,
    size: int = 1024,
    targets: Sequence[str] = SURFACE_TARGETS,
    mm_per_pixel: float | None = None,
) -> SurfaceFiles:
    """Write the surface of a specimen into a folder, as textures and as materials of engines.

    Args:
        library: library of measured materials that completes the readings.
        pictures: pictures of the specimen.
        readings: readings of the specimen; if None, no mean BRDF is written.
        folder: folder to write into; it is created if missing, and locked against other runs.
        name: beginning of the names of files; by default the name of the specimen.
        size: width and height of the textures in pixels.
        targets: export targets, which must support textures; nothing is exported without readings.
        mm_per_pixel: width of a pixel of the pictures, which is recorded; None if unknown.

    Raises:
        UsageError: a target does not support textures, the folder cannot be written or another run writes to it, or a
            file would replace an input.
        MissingLibraryError: there are readings, but no library.
    """
    require_textured(targets)
    if readings is not None:
        Library.open(library)  # refused before anything is written
    _paths(pictures, readings, folder, name, targets)  # before the folder is made
    with only_run_in(folder, "the surface's files"):
        return write_surface(
            library, pictures, readings, folder, name=name, size=size, targets=targets, mm_per_pixel=mm_per_pixel
        )  # fmt: skip


def write_surface(
    library: Path,
    pictures: SurfacePictures,
    readings: Readings | None,
    folder: Path,
    *,
    name: str | None,
    size: int,
    targets: Sequence[str],
    mm_per_pixel: float | None,
) -> SurfaceFiles:
    """Write a surface into a folder whose lock is held; see `make_surface`."""
    start = time.perf_counter()
    paths = _paths(pictures, readings, folder, name, targets)
    stages = Stages({"completing": 4, "slopes and colours": 2, "textures": 2, "fitting exports": 10})
    disk.require_writable(paths["numbers"])
    paths["numbers"].unlink(missing_ok=True)  # a run that stops leaves no numbers of other textures
    stages.begin("completing")
    completed, brdf = None, None
    if readings is not None:
        completed = complete(library, readings, paths["mean"])
        brdf = MeasuredBRDF(read_bsdf(paths["mean"]))
    stages.begin("slopes and colours")
    surface = estimate_surface(pictures, brdf)
    sparkle = sparkle_of(surface)
    stages.begin("textures")
    textures = tile(surface, size)
    if brdf is None:  # the scale is free, and textures do not show all parts of the sample equally often
        surface = replace(surface, mean=surface.mean / brightest(surface.mean * textures.albedo))
    flakes = None
    if sparkle.flakes is not None and sparkle.density > _VISIBLE_SPARKLE:
        flakes = sparkle.flakes.drawn(size, np.random.default_rng(1))
    written = _write_textures(paths, surface.mean, textures, brdf, flakes)
    stages.begin("fitting exports")
    exports: dict[str, float] = {}
    cut = {"albedo": textures.cut_share(surface.mean)}
    if brdf is not None:
        with ThreadPoolExecutor(1) as beside:  # drawn while models are fitted
            drawn = beside.submit(preview.strip, brdf, textures, flakes)
            exports = write_exports(paths, textures, flakes, targets, cut)
            write_image(paths["picture"], drawn.result())
        written |= {"mean", "picture"}.union(*(_kinds_of(target, flakes) for target in exports))
    notes = (*textures.notes, *_notes(pictures, surface, sparkle, completed))
    if lost := [f"{name} {100.0 * share:.2g} %" for name, share in cut.items() if share > _FEW_CUT]:
        notes += (f"bright points are clipped in textures; shares of all points: {', '.join(lost)}",)
    if flakes is not None and exports:
        notes += notes_of_flakes(flakes, targets)
    made = SurfaceFiles(
        folder=folder, surface=surface, sparkle=sparkle, textures=textures, mm_per_pixel=mm_per_pixel,
        completed=completed, exports=MappingProxyType(exports),
        paths=MappingProxyType({kind: path for kind, path in paths.items() if kind in {*written, "numbers"}}),
        notes=notes, seconds=time.perf_counter() - start,
    )  # fmt: skip
    document = {"program": f"manifold {__version__}", **made.to_json()}
    disk.write_text(paths["numbers"], json.dumps(document, indent=2, allow_nan=False) + "\n")
    return made


def require_textured(targets: Sequence[str]) -> None:
    """Raise UsageError if a target does not support textures."""
    textured = [name for name, target in TARGETS.items() if target.textures]
    if unknown := [name for name in targets if name not in textured]:
        raise UsageError(f"found the target {unknown[0]!r}, expected one of {', '.join(textured)}")


def _paths(
    pictures: SurfacePictures,
    readings: Readings | None,
    folder: Path,
    name: str | None,
    targets: Sequence[str],
) -> dict[str, Path]:
    """Return the paths of all files that a surface may have, by kind; raise UsageError if one is an input."""
    stem = name or ("surface" if readings is None else file_name(readings).removesuffix(".bsdf"))
    endings = {
        "mean": ".bsdf", "albedo": "_albedo.png", "normal": "_normal.png", "height": "_height.exr",
        "changes": "_changes.exr", "flakes": "_flakes.png", "flake_weights": "_flake_weights.png",
        "mitsuba": "_mitsuba.xml", "picture": ".png",
    }  # fmt: skip
    for target in targets:
        endings |= {
            target: f"_{target}{TARGETS[target].suffix}", f"{target}_base": f"_{target}_base.png",
            f"{target}_coat": f"_{target}_coat.png",
        }  # fmt: skip
    paths = {kind: folder / f"{stem}{ending}" for kind, ending in (endings | {"numbers": ".json"}).items()}
    inputs = {os.path.realpath(source) for source in pictures.sources}
    for path in paths.values():
        if os.path.realpath(path) in inputs:
            raise UsageError(f"{path}: is an input of this command; name another folder")
    return paths


def _kinds_of(name: str, flakes: DrawnFlakes | None) -> set[str]:
    """Return the kinds of a target's files."""
    return {name, f"{name}_base"} | ({f"{name}_coat"} if _shows_flakes(name, flakes) else set())


def _shows_flakes(name: str, flakes: DrawnFlakes | None) -> bool:
    return flakes is not None and "coat_normal" in TARGETS[name].textures


def _write_textures(
    paths: Mapping[str, Path], mean: Array, textures: Textures, brdf: MeasuredBRDF | None,
    flakes: DrawnFlakes | None,
) -> set[str]:  # fmt: skip
    """Write the files for renderers; return their kinds."""
    written = {"albedo", "normal", "height", "changes"}
    write_display(paths["albedo"], encode_srgb(np.clip(mean * textures.albedo, 0.0, 1.0)))
    write_display(paths["normal"], 0.5 + 0.5 * textures.normal)
    write_image(paths["height"], textures.height[..., None])
    if flakes is not None:
        normals = np.where(flakes.mask[..., None], flakes.normal, textures.normal)
        write_display(paths["flakes"], 0.5 + 0.5 * normals)
        write_display(paths["flake_weights"], np.repeat(flakes.share * flakes.mask[..., None], 3, axis=-1))
        written |= {"flakes", "flake_weights"}
    changes = textures.albedo
    if brdf is not None:
        wi, wo = np.array([[0.0, 0.0, 1.0]]), np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
        changes = spectral_changes(textures.albedo, brdf.eval(wi, wo)[0], brdf.bands)
        disk.write_text(paths["mitsuba"], mitsuba_document(paths, flakes))
        written.add("mitsuba")
    write_image(paths["changes"], changes.astype(np.float16))  # steps of 1 / 2000
    return written


_MITSUBA = """<!-- A surface of manifold: call manifold.surface.bsdf.register() before mi.load_file.
     On shapes whose v runs upwards, such as rectangles, scale v by -1. -->
"""


def mitsuba_document(paths: Mapping[str, Path], flakes: DrawnFlakes | None) -> str:
    """Return the material as Mitsuba XML, which refers to textures in the same folder."""
    surface = (
        f'<bsdf type="normalmap">{_texture("normalmap", paths["normal"])}<bsdf type="surface">'
        f'{_texture("changes", paths["changes"])}<bsdf name="nested" type="measured">'
        f'<string name="filename" value="{escape(paths["mean"].name)}"/></bsdf></bsdf></bsdf>'
    )
    if flakes is not None:
        mirror = flakes.flakes.reflectance / flakes.share
        surface = (
            f'<bsdf type="blendbsdf">{_texture("weight", paths["flake_weights"], "nearest")}{surface}'
            f'<bsdf type="normalmap">{_texture("normalmap", paths["flakes"], "nearest")}<bsdf type="roughconductor">'
            '<string name="material" value="none"/><string name="distribution" value="ggx"/>'
            f'<float name="alpha" value="{flakes.flakes.roughness:.4f}"/>'
            f'<spectrum name="specular_reflectance" value="{mirror:.4f}"/></bsdf></bsdf></bsdf>'
        )
    document = ElementTree.fromstring(surface.replace("<bsdf", '<bsdf version="3.0.0"', 1))
    ElementTree.indent(document, "    ")
    return _MITSUBA + ElementTree.tostring(document, encoding="unicode") + "\n"


def _texture(name: str, path: Path, filter_type: str = "bilinear") -> str:
    return (
        f'<texture name="{name}" type="bitmap"><string name="filename" value="{escape(path.name)}"/>'
        f'<boolean name="raw" value="true"/><string name="filter_type" value="{filter_type}"/></texture>'
    )


def write_exports(
    paths: Mapping[str, Path], textures: Textures, flakes: DrawnFlakes | None, targets: Sequence[str],
    cut: dict[str, float],
) -> dict[str, float]:  # fmt: skip
    """Fit the engines' models to the mean BRDF, write them with textures, and return their ball errors by target.

    Flakes are written as a clear coat with its own normals, which replaces the coat of the fitted model. `cut`
    receives the share of clipped points of each base texture.
    """
    from manifold.fit import exporting

    subject = exporting.subject_of(paths["mean"])
    balls = {}
    for name in targets:
        target = TARGETS[name]

        def write_files(values: Mapping[str, Any], name: str = name, target: Target = target) -> TextureFiles:
            base = np.asarray(values[target.base_colour])
            cut[f"{name} base"] = textures.cut_share(base)
            write_display(paths[f"{name}_base"], encode_srgb(np.clip(base * textures.albedo, 0.0, 1.0)))
            if flakes is None or not _shows_flakes(name, flakes):
                return TextureFiles(paths[f"{name}_base"], paths["normal"])
            ior = next((value for key, value in values.items() if key.lower() in _COAT_IORS), 1.5)
            flake = (
                min(flakes.flakes.reflectance / ior_to_f0(ior), 1.0),
                np.sqrt(flakes.flakes.roughness),
                0.0,
            )
            around = *(values[key] for key in target.coat[:2]), 0.0
            write_display(paths[f"{name}_coat"], np.where(flakes.mask[..., None], flake, around))
            return TextureFiles(
                paths[f"{name}_base"], paths["normal"], paths[f"{name}_coat"], paths["flakes"]
            )

        outcome = exporting.export(subject, target, paths[name], textures=write_files)
        balls[name] = float((outcome.content or {})["errors"]["ball"])
    return balls


def notes_of_flakes(flakes: DrawnFlakes, targets: Sequence[str]) -> tuple[str, ...]:
    """Return notes about properties of the flakes that the engines' materials cannot show."""
    notes = tuple(
        f"{name}: no flakes, because its coat shares the normals of its base"
        for name in targets
        if not _shows_flakes(name, flakes)
    )
    if (reflectance := flakes.flakes.reflectance) > (most := ior_to_f0(1.5)):
        notes += (f"flakes reflect {reflectance:.2f} straight on, those of engines' materials {most:.2f}",)
    return notes


def _notes(
    pictures: SurfacePictures, surface: Surface, sparkle: Sparkle, completed: Completed | None
) -> tuple[str, ...]:
    notes = pictures.notes
    across, along = surface.slope_std
    if across > 2.0 * along:
        notes += (
            "all lamps lie in one plane: slopes perpendicular to it are estimated by integrability only, and relief "
            "lit from that side is uncertain",
        )
    if sparkle.density > _VISIBLE_SPARKLE:
        notes += (
            f"{sparkle.density:.1f} glints per lamp and 10,000 pixels: spots brighter than a smooth relief explains, "
            f"{100 * sparkle.seen_once:.0f} % of them under only one lamp",
        )
    return notes if completed is None else (*notes, *completed.diagnostics)
