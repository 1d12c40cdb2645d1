"""Lists the contents of a file, a library or a model, as rows and tables for `manifold info`.

Modules that only one kind needs (zarr, models) are imported at first use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold.core import shipped
from manifold.core.errors import FileFormatError, LibraryError, UsageError
from manifold.core.judged_lights import BALL
from manifold.core.metrics import Errors
from manifold.core.names import percent
from manifold.core.records import Array, Bands, BsdfFile, plain
from manifold.estimate.picture_colours import colour_of, reading_at
from manifold.estimate.source_files import source_file
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource
from manifold.formats import registry
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings
from manifold.formats.recognition import Kind, kind_of, read_export
from manifold.formats.workbook_pictures import picture_directions, picture_geometry, picture_values
from manifold.io_rgl import read_bsdf
from manifold.model.coherence import Coherence
from manifold.model.expected_error import NOT_CALIBRATED
from manifold.model.model_file import OLD_LAYOUT, read_model

if TYPE_CHECKING:
    from manifold.brdf.consistency import Consistency
    from manifold.model.settings import Settings

_MOST_LISTED = 40  # samples, or cells, one by one

Table = tuple[Sequence[str], Sequence[Sequence[object]]]
"""Column headings and rows of a table."""


def inspect_instrument_file(
    path: Path, format_name: str
) -> tuple[dict[str, object], dict[str, Any], list[Table]]:
    """Return the labels and values of an instrument's file, their JSON, and tables (headings, rows) of its samples."""
    records = registry.read_all(path)
    first = records[0]
    rows: dict[str, object] = {"format": format_name, "instrument": first.instrument}
    rows |= {"samples": len(records)} if len(records) > 1 else {"sample": first.name}
    rows |= _of_table(first) if isinstance(first, DenseTable) else _of_readings(first)
    rows["values in 1/sr"] = _range(np.concatenate([record.values.ravel() for record in records]))
    for k, note in enumerate(dict.fromkeys(note for record in records for note in record.notes), start=1):
        rows["note" if k == 1 else f"note {k}"] = note
    size = path.stat().st_size
    rows["size"] = f"{size / 1e6:.3g} MB" if size >= 1e5 else f"{size / 1e3:.3g} kB"
    tables: list[Table] = []
    if len(records) > 1:
        listed = [(r.name, _count(r), str(r.bands)) for r in records[:_MOST_LISTED]]
        tables.append((("sample", "pairs", "bands"), listed))
    textured = [record for record in records if isinstance(record, Readings) and record.texture]
    if textured:
        rows["texture"] = "graininess, sparkle or pictures of the sample, listed below"
    for record in textured[:_MOST_LISTED]:
        for key, value in record.texture.items():
            heads, cells = _picture_table(record) if key == "images" else _texture_table(key, value)
            if len(records) > 1:
                heads, cells = ("sample", *heads), [(record.name, *row) for row in cells]
            tables.append((heads, cells))
    document = {"path": str(path), "format": format_name, "samples": [_document(r) for r in records]}
    return rows, document, tables


def _of_readings(readings: Readings) -> dict[str, object]:
    theta_i = np.rad2deg(np.arccos(np.clip(readings.wi[:, 2], 0.0, 1.0)))
    theta_o = np.rad2deg(np.arccos(np.clip(readings.wo[:, 2], 0.0, 1.0)))
    incidences = np.unique(np.round(theta_i, 1))
    return {
        "readings": len(readings),
        "bands": _bands(readings.bands),
        "theta_i in degrees": [f"{t:g}" for t in incidences[:12]] + (["..."] if incidences.size > 12 else []),
        "theta_o in degrees": f"{theta_o.min():.1f} to {theta_o.max():.1f}",
        "measured values": percent(readings.measured.mean(), 1),
        **(
            {"gloss": [f"{u:g} at {a:g} degrees" for a, u in readings.gloss.items()]}
            if readings.gloss
            else {}
        ),
    }


def _of_table(table: DenseTable) -> dict[str, object]:
    return {
        "table": " x ".join(str(a.size) for a in table.axes) + f", {table.coordinates} angles",
        "kind": "isotropic" if table.is_isotropic else "anisotropic",
        "bands": _bands(table.bands),
        "measured nodes": percent(table.measured.mean(), 1),
    }


def _bands(bands: Bands) -> str:
    return f"{bands}: {', '.join(bands.labels)}" if 1 < bands.count <= 4 and not bands.is_rgb else str(bands)


def _range(values: Any) -> str:
    return f"{np.nanmin(values):.4g} to {np.nanmax(values):.4g}" if np.any(np.isfinite(values)) else "none"


def _count(record: registry.Record) -> int:
    return len(record) if isinstance(record, Readings) else int(np.count_nonzero(record.measured))


def _picture_table(readings: Readings) -> Table:
    """Return a table of pictures: geometry, size, mean colour, and its ratio to the reading's colour."""
    heads = ("picture", "camera, lamp in degrees", "pixels", "mean linear sRGB", "ratio to the reading")
    rows = []
    for caption, content in readings.texture["images"].items():
        geometry, factor = picture_geometry(caption), np.full(3, np.nan)
        lamp = "" if geometry is None else f"{geometry[0]:g}, {geometry[1]:g}".replace("nan", "diffuse")
        try:
            values = picture_values(content)
        except FileFormatError as error:
            rows.append((caption, lamp, str(error), "", ""))
            continue
        mean = values.mean(axis=(0, 1))
        if geometry is not None and np.isfinite(geometry[1]):
            factor = mean / colour_of(readings, reading_at(readings, *picture_directions(*geometry)))
        colours = (" ".join(f"{v:.3f}" for v in each) for each in (mean, factor))
        size = f"{values.shape[1]} x {values.shape[0]}"
        rows.append((caption, lamp, size, *("" if "nan" in each else each for each in colours)))
    return heads, rows


def _texture_table(key: str, value: Any) -> Table:
    """Return a table of a list of entries with their columns, or of single values."""
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        columns = tuple(dict.fromkeys(column for entry in value for column in entry))
        return columns, [[entry.get(c, "") for c in columns] for entry in value]
    items = value.items() if isinstance(value, Mapping) else [(key, value)]
    return ("texture", "value"), [(str(k), str(v)) for k, v in items]


def _document(record: registry.Record) -> dict[str, Any]:
    nm = record.bands.wavelengths_nm
    document: dict[str, Any] = {
        "name": record.name,
        "instrument": record.instrument,
        "wavelengths_nm": None if nm is None else list(nm),
        "pairs": _count(record),
        "notes": list(record.notes),
    }
    if isinstance(record, Readings):
        document["gloss"] = {f"{angle:g}": units for angle, units in record.gloss.items()}
        document["texture"] = {k: _plain(v) for k, v in record.texture.items()}
    else:
        document["shape"] = list(record.values.shape)
    return document


def _plain(value: Any) -> Any:
    """Return values that JSON can hold; images are replaced by their length in bytes."""
    if isinstance(value, bytes):
        return {"bytes": len(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)


_KINDS = {
    "blend": "blends of whole materials",
    "gplvm": "whole materials",
}


@dataclass(frozen=True)
class Inspection:
    """The contents of a file: rows of labels and values, their JSON, and the problems that verification found."""

    title: str
    rows: dict[str, object]
    document: dict[str, Any]
    tables: Sequence[Table] = ()
    problems: list[str] = field(default_factory=list)


def inspect(
    path: Path,
    *,
    library: Path | None = None,
    verify: bool = False,
) -> Inspection:
    """Inspect a file of a BRDF or an instrument, a library, a model or the JSON of a fit, recognised by content.

    `library` is the path of the model's library, if it was moved. `verify` reads a library and compares all hashes.
    """
    kind = kind_of(path)
    if kind is Kind.NOTHING:
        raise UsageError(
            f"{path}: no such path; name a file of a BRDF or an instrument, a library, a model, or a fit"
        )
    if kind in (Kind.LIBRARY, Kind.FOLDER):
        return _inspect_library(path, verify)
    if verify:
        raise UsageError(f"{path}: only libraries can be verified; this is {kind}")
    if kind is Kind.MODEL:
        return _inspect_model(path, library)
    if kind is Kind.FIT:
        return _inspect_fit(path)
    if kind is Kind.RGL:
        return _inspect_file(read_bsdf(path), path)
    if (known := registry.identify(path)) is None:
        raise registry.unknown(path)
    return Inspection(f"{path.name}: {known.name}", *inspect_instrument_file(path, known.name))


def inspect_export(path: Path) -> Inspection | None:
    """Inspect a JSON file that `manifold export` wrote for an engine; return None for other files."""
    content = read_export(path)
    if content is None:
        return None
    rows: dict[str, object] = {"material": content["material"]}
    rows |= {
        name: ", ".join(f"{v:.4g}" for v in np.atleast_1d(value))
        for name, value in content["parameters"].items()
    }
    rows |= {
        "colour space": content["colour_space"],
        "CIEDE2000 of the ball": f"{Errors(**content['errors'])}, against the {content['against']}",
        "program": content["program"],
    }
    return Inspection(f"{path}: export for {content['target']}", rows, content | {"path": str(path)})


def inspect_source(source: MaterialSource, *, library: Path | None, verify: bool) -> Inspection:
    """Inspect a path, see `inspect`, a material of a library, or a prediction."""
    if isinstance(source, FileSource):
        return inspect(source.path, library=library, verify=verify)
    if verify:
        raise UsageError(f"{source}: only libraries can be verified; this is a material")
    with source_file(source) as path:
        found = _inspect_file(read_bsdf(path), path, is_compact=_is_compact(source))
    return replace(found, title=f"{source}: RGL material", document=found.document | {"path": str(source)})


def _is_compact(source: MaterialSource) -> bool:
    from manifold.library.store import Library

    if not isinstance(source, LibrarySource):
        return False
    return Library(source.library).attributes(source.name).accuracy is not None


def _inspect_file(file: BsdfFile, path: Path, *, is_compact: bool = False) -> Inspection:
    from manifold.brdf.consistency import check_consistency
    from manifold.brdf.unmeasured_cells import unmeasured_cells, unmeasured_share

    P, T, B, H, W = file.spectra.shape
    mask = file.measured_mask
    share = unmeasured_share(file, unmeasured_cells(file))
    checked = check_consistency(file, has_exact_luminance=not is_compact)
    unit = (
        "; times ndf / (4 sigma) they are f cos(theta_o) in 1/sr"
        if file.jacobian
        else ", f cos(theta_o) in 1/sr"
    )
    rows: dict[str, object] = {
        "description": file.description,
        "kind": "isotropic" if file.is_isotropic else f"anisotropic, {P} incident azimuths",
        "bands": str(file.bands),
        "theta_i in degrees": [f"{np.rad2deg(t):.1f}" for t in file.theta_i_rad],
        "outgoing grid": f"{H} x {W} cells",
        "ndf": f"{' x '.join(str(n) for n in file.ndf.shape)} nodes",
        "vndf": f"{' x '.join(str(n) for n in file.vndf.shape[2:])} nodes",
        "pipeline version": ".".join(str(v) for v in file.version),
        "valid cells": f"{percent(mask.mean(), 1)} of all cells",
        "zeros": f"{percent(np.mean(file.spectra == 0), 1)} of all values",
        "unmeasured cells above the horizon": percent(share, 1),
        "stored values": f"{file.spectra.min():.4g} to {file.spectra.max():.4g}{unit}",
        "size": f"{path.stat().st_size / 1e6:.1f} MB",
        "findings": checked.findings or "none",
    }
    document = {
        "path": str(path),
        "name": file.name,
        "description": file.description,
        "shape": [P, T, B, H, W],
        "wavelengths_nm": None if file.wavelengths_nm is None else [float(w) for w in file.wavelengths_nm],
        "theta_i_rad": [float(t) for t in file.theta_i_rad],
        "phi_i_rad": [float(p) for p in file.phi_i_rad],
        "version": list(file.version),
        "measured_share": float(mask.mean()),
        "zero_share": float(np.mean(file.spectra == 0)),
        "unmeasured_share": share,
        "consistency": plain(checked),
    }
    tables = [_incidence_table(file, checked), _cell_table(file, checked)]
    return Inspection(f"{path.name}: RGL material", rows, document, tables)


def _incidence_table(file: BsdfFile, checked: Consistency) -> Table:
    """Return a table of albedo, negative values and reciprocity by polar angle, the worst over azimuths each."""
    albedo, negative = checked.albedo.max(axis=0), checked.negative_share.max(axis=0)  # [T, B]
    distance = np.abs(np.log(np.nan_to_num(checked.reciprocity, nan=1.0)))
    ratio = np.take_along_axis(checked.reciprocity, distance.argmax(axis=0)[None], axis=0)[0]  # [T]
    labels = file.bands.labels
    heads = ["theta_i in degrees"]
    if file.bands.is_rgb:
        heads += [f"{what} {label}" for what in ("albedo", "negative") for label in labels]
    else:
        heads += ["mean albedo", "largest albedo", "at", "negative"]
    rows = []
    for t, theta in enumerate(np.rad2deg(file.theta_i_rad)):
        row = [f"{theta:.1f}"]
        if file.bands.is_rgb:
            row += [f"{a:#.3g}" for a in albedo[t]] + [percent(share, 1) for share in negative[t]]
        else:
            row += [f"{albedo[t].mean():#.3g}", f"{albedo[t].max():#.3g}", labels[albedo[t].argmax()]]
            row += [percent(negative[t].mean(), 1)]
        rows.append([*row, "" if np.isnan(ratio[t]) else f"{ratio[t]:.2f}"])
    return [*heads, "f(wi, wo) / f(wo, wi), median"], rows


def _cell_table(file: BsdfFile, checked: Consistency) -> Table:
    """Return the stored values that disagree most, beside their neighbours."""
    heads = ("phi_i, theta_i in degrees", "band", "row", "column", "stored value", "expected", "neighbours")
    rows = []
    for cell in checked.cells[:_MOST_LISTED]:
        p, t, b, row, column = cell.at
        degrees = f"{np.rad2deg(file.phi_i_rad[p]):.1f}, {np.rad2deg(file.theta_i_rad[t]):.1f}"
        around = "" if np.isnan(cell.low) else f"{cell.low:.4g} to {cell.high:.4g}"
        numbers = (f"{cell.value:.4g}", f"{cell.expected:.4g}")
        rows.append((degrees, file.bands.labels[b], row, column, *numbers, around))
    return heads, rows


def _inspect_fit(path: Path) -> Inspection:
    from manifold.render import fit_json

    content = fit_json.read(path)
    source, metric = content["source"], content["metric"]
    of = source["file"] or "a BRDF"
    if source["latent"] is not None:
        of = f"the prediction of {source['model']} at latent {_words(source['latent'])}"
    elif source.get("walk") is not None:
        of = f"the prediction of {source['model']} {source['walk']}"
    rows: dict[str, object] = {
        "material": source["name"],
        "fitted to": of,
        "BSDF": content["bsdf"]["type"],
        "relative residual": f"{metric} {content['residuals'][metric]:.3f}",
    }
    if content["notes"]:
        rows["notes"] = tuple(content["notes"])
    tables = {"parameter": content["values"]}
    return Inspection(
        f"{path.name}: fit by {content['program']}",
        rows,
        content | {"path": str(path)},
        [((head, "value"), [(k, _words(v)) for k, v in found.items()]) for head, found in tables.items()],
    )


def _quantiles(errors: Errors[Array]) -> tuple[str, ...]:
    """Return medians and 90th percentiles of the errors of several materials, one line per error."""
    median, p90 = errors.median, errors.p90
    return (
        f"median {median.ball:.1f}, 90th percentile {p90.ball:.1f} {BALL}",
        f"cube-root error: median {percent(median.cube_root)}, 90th percentile {percent(p90.cube_root)}",
    )


def _words(value: float | list[float]) -> str:
    """Return a number, a colour, or the range of a value per band, in words."""
    values = value if isinstance(value, list) else [value]
    if len(values) > 4:
        return f"{min(values):.4g} to {max(values):.4g} in {len(values)} bands"
    return ", ".join(f"{v:.4g}" for v in values)


def _inspect_library(path: Path, verify: bool) -> Inspection:
    from manifold.library.identity import origins_in_words
    from manifold.library.store import Library

    library = Library(path)
    about = shipped.about() if shipped.is_built_in(path) else {}
    materials = [library.attributes(name) for name in library.names]
    others, size = origins_in_words(materials), library.disk_bytes
    errors = [m.accuracy for m in materials if m.accuracy is not None]
    rows: dict[str, object] = {
        "materials": f"{len(materials)}" + (f", {others}" if others else ""),
        "bands": str(library.bands),
        "size": (f"{size / 1e6:.1f} MB, as files " if size else "as files ")
        + f"{sum(m.bytes for m in materials) / 1e6:.1f} MB",
        "content hash": library.content_hash,
        "schema version": library.schema_version,
    }
    if errors:
        rows["compact"] = [
            f"{len(errors)} of the materials",
            f"largest errors {max(e.ball for e in errors):.2f} {BALL}, "
            f"{percent(max(e.cube_root for e in errors), 2)} cube-root error",
        ]
    rows |= {key: about[key] for key in ("source", "licence", "citation") if key in about}
    if about:
        rows["sha256"] = tuple(f"{value}  {key}" for key, value in about["sha256"].items())
        rows["model"] = f"{shipped.MODEL_FILE.stat().st_size / 1e3:.1f} kB; -M {shipped.BUILT_IN}"
    problems = library.verify() if verify else []
    if verify:
        rows["verified"] = "all hashes match" if not problems else f"{len(problems)} damaged"
    table = [
        (
            m.name,
            f"{m.shape[3]} x {m.shape[4]}"
            + (f" x {m.shape[0]} azimuths" if m.shape[0] > 1 else "")
            + (f", turned by {np.rad2deg(m.rotation_rad):.1f} degrees" if m.rotation_rad else ""),
            ".".join(str(v) for v in m.pipeline_version),
            f"{m.bytes / 1e6:.1f}",
            *(
                ["-" if m.accuracy is None else f"{m.accuracy.ball:.2f}, {percent(m.accuracy.cube_root, 2)}"]
                if errors
                else []
            ),
            m.description,
        )
        for m in materials
    ]
    document = {
        "path": shipped.named(path),
        "schema_version": library.schema_version,
        "bands": str(library.bands),
        "content_hash": rows["content hash"],
        "bytes": size,
        "materials": [asdict(material) for material in materials],
        "verified": verify,
        "problems": problems,
    } | ({"about": about} if about else {})
    columns = ("material", "grid", "pipeline", "MB", *(["ball, cube root"] if errors else []), "description")
    return Inspection(f"{shipped.named(path)}: library", rows, document, [(columns, table)], problems)


def _process_rows(s: Settings, statistics: Mapping[str, float]) -> dict[str, object]:
    """Return the rows of a Gaussian process, which blends have not."""
    from manifold.model.settings import GplvmSettings

    if not isinstance(s, GplvmSettings):
        return {}
    kernel = f"{s.kernel} + delta, length scale {s.length_scale:g}, mu {s.mu:g}"
    end, start = statistics["objective"], statistics["objective_start"]
    return {"kernel": kernel, "optimizer": s.optimizer, "objective": f"{end:.6g} (start {start:.6g})"}


def _inspect_model(path: Path, library: Path | None) -> Inspection:
    from manifold.model.manifold import Manifold
    from manifold.model.model_file import restore

    stored = read_model(path)
    s, space, left_out = restore(path, stored)
    found, missing = None, None
    try:
        found = Manifold.load(path, library).library
    except LibraryError as error:
        if library is not None:
            raise
        missing = str(error)
    rows: dict[str, object] = {
        "materials": space.materials_in_words,
        "library": f"{missing}; predictions, renders and reports need it" if found is None else found.path,
        "bands": stored.n_bands or "unknown without the library" if found is None else found.bands,
        "kind": _KINDS[s.kind],
        "latent dimensions": s.latent_dim,
        "mapping": s.mapping,
        **_process_rows(s, stored.statistics),
        "size": f"{shipped.model_file(path).stat().st_size / 1e3:.1f} kB",
    }
    coherence = Coherence.from_statistics(stored.statistics)
    if coherence is not None:
        rows["detour"], rows["neighbours kept"] = coherence.words
    elif stored.has_old_layout:
        rows["layout"] = OLD_LAYOUT
    columns = ["material", *(f"x{k + 1}" for k in range(s.latent_dim))]
    table: list[tuple[object, ...]] = [
        (name, *space.printed(row)) for name, row in zip(stored.names, space.X, strict=True)
    ]
    errors = None
    if left_out is None:
        rows["left-out errors"] = list(NOT_CALIBRATED)
    else:
        kept = "latents of the others kept; `manifold report` refits them"
        rows["left-out errors"] = (*_quantiles(left_out.errors), kept)
        if left_out.blended is not None:
            rows["in blended colours"] = _quantiles(left_out.blended)
        columns += ["left out: ball", "cube root"]
        both = left_out.errors.ball.tolist(), left_out.errors.cube_root.tolist()
        each = zip(left_out.materials.tolist(), *both, strict=True)
        errors = {stored.names[i]: {"ball": ball, "cube_root": root} for i, ball, root in each}
        words = {name: (f"{e['ball']:.1f}", percent(e["cube_root"])) for name, e in errors.items()}
        table = [(*row, *words.get(str(row[0]), ("", ""))) for row in table]
    document = {
        "path": str(path),
        "library": shipped.named(stored.library if found is None else found.path),
        "library_problem": missing,
        "settings": s.to_json(),
        "statistics": stored.statistics,
        "latents": {name: row.tolist() for name, row in zip(stored.names, space.X, strict=True)},
        "left_out": errors,
    }
    return Inspection(f"{path}: manifold model", rows, document, [(columns, table)])
