"""Implements `manifold export --target shader`, which writes a table, code and a page for a material."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from manifold import __version__
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF, EvaluableBRDF
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.notebook import ball_image, sun_image
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import panel
from manifold.colour.conversion import file_to_srgb
from manifold.colour.panel import SUN_DEG
from manifold.core import disk
from manifold.core.defaults import SHADER_TOLERANCE
from manifold.core.errors import UsageError
from manifold.core.judged_lights import BALL, BALL_COLUMN, LIGHTS
from manifold.core.metrics import Errors
from manifold.core.names import exceeds
from manifold.core.records import BsdfFile
from manifold.estimate.inputs import Input
from manifold.estimate.source_files import read_source
from manifold.estimate.sources import FileSource, MaterialSource
from manifold.formats.recognition import is_fit
from manifold.many.batch import Batch, BatchCommand, Content, Outcome, make_folder
from manifold.model.output_file import FINE_OPTIONS
from manifold.pictures import html_page
from manifold.registries import FIT_SUFFIX
from manifold.render import images
from manifold.render.fitted_brdf import FittedBRDF
from manifold.shader import code, ktx2
from manifold.shader.averaged import averaged
from manifold.shader.lobes import fit_lobes
from manifold.shader.shader_page import make_page
from manifold.shader.table import SUMS, ShaderTable, Shape, shapes_of, tabulate

TARGET = "shader"
"""Name of the target in `manifold export --target`."""
MOST_BYTES = 1 << 20
"""Largest size of a texture in bytes."""

LAYOUT, TEXTURE, CODE, PAGE = "manifold.json", "manifold.ktx2", "manifold", "index.html"
PICTURE, BALLS = "manifold.png", "balls.png"
_PACK_PIXELS = 64


@dataclass(frozen=True, eq=False)
class Shader:
    """A material as the table of a shader.

    Attributes:
        table: the smallest table within the tolerance, or the best table of at most `MOST_BYTES`.
        errors: errors of the table against the source.
        source, against: the material, and its origin: a measured, completed or predicted file, or a fit.
        reference: a finer table, which the page draws in place of the source, and its error.
        notes: sentences for users.
    """

    name: str
    table: ShaderTable
    errors: Errors[float]
    source: EvaluableBRDF
    against: str
    reference: tuple[ShaderTable, float]
    notes: tuple[str, ...]


def make_shader(
    file: BsdfFile, material: EvaluableBRDF | None = None, *, tolerance: float = SHADER_TOLERANCE
) -> Shader:
    """Return the smallest table whose ball error (mean CIEDE2000 over the five test lights) is within a tolerance.

    The error is measured against the file or, if the file was measured from a fit, against the fit. An anisotropic
    material is averaged over its azimuths.
    """
    if not tolerance > 0.0:
        raise UsageError(f"a tolerance of {tolerance:g}, expected more than 0 {BALL}")
    notes = []
    source = MeasuredBRDF(fill_unmeasured(file)) if material is None else material
    against = f"{file.origin} file" if material is None else "fit"
    if not file.is_isotropic:
        notes.append("anisotropic: averaged over all azimuths of the sample, because the table is isotropic")
        file = averaged(file)
    brdf, rgb = MeasuredBRDF(fill_unmeasured(file)), file_to_srgb(fill_unmeasured(file))
    lobes, lights = fit_lobes(brdf, rgb.theta_i_rad), panel.judged()
    seen = lights.xyz(values_at(source, lights), source.bands)

    def errors_of(table: ShaderTable) -> Errors[float]:
        return lights.compare(seen, lights.xyz(table.eval(lights.wi, lights.wo), table.bands))

    best: tuple[ShaderTable, Errors[float]] | None = None
    shapes = shapes_of(rgb, MOST_BYTES)
    if not shapes:
        raise UsageError(
            f"{file.name}: its table would exceed {MOST_BYTES >> 20} MB; convert it to a coarser file"
        )
    for shape in shapes:
        table = tabulate(rgb, shape, lobes)
        errors = errors_of(table)
        if best is None or errors.ball < best[1].ball:
            best = table, errors
        if errors.ball <= tolerance:
            break
    assert best is not None
    table, errors = best
    if exceeds(errors.ball, tolerance, 2):
        notes.append(
            f"no table of at most {MOST_BYTES >> 20} MB is within {tolerance:g}: this is the best, "
            f"{errors.ball:.2f} {BALL}"
        )
    finest = Shape.of(len(rgb.theta_i_rad), rgb.spectra.shape[-1], *SUMS[-1], shapes[0].nodes)
    reference = tabulate(rgb, finest, lobes)
    beside = (reference, errors_of(reference).ball)
    return Shader(file.name, table, errors, source, against, beside, tuple(notes))


def read_material(source: MaterialSource) -> tuple[BsdfFile, EvaluableBRDF | None]:
    """Return the file of a source, and its fit or None; the file of a fit is measured by the virtual goniometer."""
    if not isinstance(source, FileSource) or not is_fit(source.path):
        return read_source(source), None
    fit = FittedBRDF.read(source.path)
    name = source.path.name.removesuffix(FIT_SUFFIX)
    file = goniometer.measure(
        cast(BRDF, fit),  # which is evaluated only
        name,
        resolution=FINE_OPTIONS.resolution,
        n_theta_i=FINE_OPTIONS.incidences,
    )
    return file, fit


def export(
    source: MaterialSource, folder: Path, *, tolerance: float = SHADER_TOLERANCE, with_picture: bool = False,
    prefix: str | None = None,
) -> Outcome[MaterialSource]:  # fmt: skip
    """Write the table, the code in all languages, the layout and the page of a material into a folder.

    With a picture, balls and slices of the source and the shader are also drawn side by side. Names in the code begin
    with `prefix`, by default `manifold`; several materials in one program need different prefixes.
    """
    code.renamed("", prefix)
    made = _export(
        Input(source.name, source), folder / LAYOUT, tolerance=tolerance, with_pictures=with_picture, prefix=prefix,
    )  # fmt: skip
    return Outcome(made["material"], folder / LAYOUT, source, made, notes=tuple(made["notes"]))


def exports(tolerance: float, *, with_pictures: bool = False, is_pack: bool = False) -> BatchCommand[Input]:
    """Return the batch command that writes a folder per material; a pack also has an overview page."""
    columns: dict[str, Callable[[Content], Any]] = {
        BALL_COLUMN: lambda content: content["errors"]["ball"],
        "kB": lambda content: round(content["bytes"] / 1000),
        "in the worst light": lambda content: content["errors"]["worst"],
        "worst light": lambda content: content["errors"]["worst_light"],
    }
    make = partial(_export, tolerance=tolerance, with_pictures=with_pictures, is_pack=is_pack)
    beside = partial(_files_of, with_pictures=with_pictures, is_pack=is_pack)
    how = {"target": TARGET, "tolerance": tolerance} | ({"pack": True} if is_pack else {})
    return BatchCommand(
        "shaders", make, how, f"/{LAYOUT}", columns=columns, beside=beside,
        conclude=_write_index if is_pack else None,
    )  # fmt: skip


def _files_of(path: Path, content: Content, *, with_pictures: bool, is_pack: bool) -> list[Path]:
    """Return the files beside the layout of a material."""
    names = [TEXTURE, PAGE, *(f"{CODE}.{language}" for language in content["code"])]
    names += [PICTURE] * with_pictures + [BALLS] * is_pack
    return [path.parent / name for name in names]


def _export(
    source: Input, path: Path, *, tolerance: float, with_pictures: bool = False, is_pack: bool = False,
    prefix: str | None = None,
) -> Content:  # fmt: skip
    """Write the files of a material beside its layout, and return that."""
    shader = make_shader(*read_material(source.source), tolerance=tolerance)
    glsl = code.glsl(shader.table, shader.name)
    translations = code.translated(glsl)
    texture = ktx2.content(shader.table.texels)
    texts = {"glsl": glsl, **translations.code}
    layout = _layout(shader, source, tolerance, len(texture), list(texts)) | {"prefix": prefix or CODE}
    if translations.note is not None:
        layout["notes"].append(translations.note)
    folder = path.parent
    make_folder(folder, "the files of a shader")
    disk.write_bytes(folder / TEXTURE, texture)
    for language, text in texts.items():
        disk.write_text(folder / f"{CODE}.{language}", code.renamed(text, prefix))
    disk.write_text(folder / PAGE, make_page(layout, glsl, shader.table, shader.reference))
    if is_pack:
        _write_balls(folder / BALLS, shader)
    if with_pictures:
        from manifold.pictures.fit_comparison import picture_of_brdfs
        from manifold.pictures.slice_figures import ShownBRDF

        sources = [ShownBRDF(shader.against, shader.source), ShownBRDF("exported: shader", shader.table)]
        picture_of_brdfs(shader.name, sources, folder / PICTURE)
    disk.write_text(path, json.dumps(layout, indent=1) + "\n")
    return layout


def _layout(
    shader: Shader, source: Input, tolerance: float, size: int, languages: list[str]
) -> dict[str, Any]:
    """Return the content of the layout's JSON, for code that reads the texture by itself."""
    table, shape = shader.table, shader.table.shape
    return {
        "format": "manifold shader",
        "program": f"manifold {__version__}",
        "material": shader.name,
        "target": TARGET,
        "source": {"from": str(source.source), **source.made_of()},
        "against": shader.against,
        "tolerance": tolerance,
        "errors": shader.errors.to_json(),
        "bytes": size,
        "code": languages,
        "texture": {
            "file": TEXTURE, "width": shape.width, "height": shape.height, "format": "R16G16B16A16_SFLOAT",
            "filter": "linear", "wrap": "clamp",
        },
        "incidences_deg": np.rad2deg(table.theta_i_rad).tolist(),
        "sums": {
            "columns": shape.columns, "rows": shape.rows, "first_row": 0,
            "channels": ["conditional sum over x", "total of the row", "marginal sum over y"],
        },
        "values": {
            "columns": shape.values, "rows": shape.values, "first_row": shape.first_value_row,
            "channels": ["R", "G", "B"],
        },
        "normals": {
            "columns": shape.nodes, "row": shape.normal_row,
            "channels": ["normal distribution", "projected area"],
        },
        "factor": table.factor,
        "sampling": {"alphas": table.lobes.alphas.tolist(), "weights": table.lobes.weights.tolist()},
        "fetches": {"eval": 6, "sample": 0, "pdf": 0},
        "notes": list(shader.notes),
    }  # fmt: skip


def _write_balls(path: Path, shader: Shader) -> None:
    """Draw four balls side by side: the source and the shader in the studio, then both under a sun."""
    parts = []
    for draw in (ball_image, partial(sun_image, degrees=SUN_DEG)):
        for brdf in (shader.source, shader.table):
            shown, inside = draw(brdf, size=_PACK_PIXELS)
            parts.append(np.where(inside[..., None], shown, 0.12))
    images.write_display(path, np.concatenate(parts, axis=1))


def _write_index(made: Batch[Input]) -> None:
    """Write the page of a pack: balls of the sources beside those of the shaders, with the differences."""
    cards = []
    for one in made.outcomes:
        if one.content is not None:
            errors, folder = one.content["errors"], one.path.parent.name
            size = f"{one.content['bytes'] / 1000:.0f} kB"
            words = f"{errors['ball']:.2f}, in {errors['worst_light']} {errors['worst']:.2f}; {size}"
            cards.append(
                html_page.card(
                    f"{folder}/{BALLS}", f"balls of {one.name}", f"{folder}/{PAGE}", one.name, words
                )
            )
    intro = (
        "Each picture: source, shader; source, shader. Left in the studio, right under a sun "
        f"{SUN_DEG:.0f} degrees beside the view. CIEDE2000 of the ball between the two, in the mean of "
        f"{LIGHTS}, and in the worst; size of the texture."
    )
    title = f"{len(cards)} measured materials as shaders"
    html_page.write(made.folder / PAGE, title, intro, f"<main>{''.join(cards)}</main>")
