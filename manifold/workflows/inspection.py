"""Contents of a file, a library or a model, as rows and tables for `manifold info`.

What only one of them needs (zarr, Numba, models) is imported where it is used.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manifold.errors import LibraryError, UsageError
from manifold.formats import registry, tensor_file
from manifold.io_rgl import read_bsdf
from manifold.model.model_file import HDF5_MAGIC, MAGIC, read_model
from manifold.records import BsdfFile, Progress
from manifold.rendering import backend, libllvm
from manifold.system.small_files import begins_with
from manifold.workflows.inspection_record import Inspection, Table
from manifold.workflows.instrument_inspection import inspect_instrument_file

if TYPE_CHECKING:
    from manifold.library.store import Library

_FIT = b'{\n  "format": "manifold fit"'
_KINDS = {
    "monochrome": "monochrome: structure on the map, a colour per band",
    "blend": "blends of whole materials",
    "material": "whole materials",
}


def inspect(
    path: Path, *, library: Path | None = None, verify: bool = False, on_progress: Progress | None = None
) -> Inspection:
    """Inspect a file of a BRDF or an instrument, a library, a model or the JSON of a fit, recognised by content.

    Args:
        path: what to look at.
        library: where a model's library is now, if not where the model remembers it.
        verify: read and hash a library again.
        on_progress: called with (done, total, what).
    Raises:
        UsageError: there is nothing at this path, or verification is asked of something else than a library.
        FileFormatError, LibraryError, ModelError: it is damaged.
    """
    if not path.exists():
        raise UsageError(
            f"{path}: no such path; name a file of a BRDF or an instrument, a library, a model, or a fit"
        )
    if path.is_dir():
        return _inspect_library(path, verify, on_progress)
    if verify:
        raise UsageError(f"{path}: only libraries can be verified; this is a file")
    if path.suffix in (".h5", ".hdf5") or begins_with(path, MAGIC, HDF5_MAGIC):
        return _inspect_model(path, library)
    if begins_with(path, _FIT):
        return _inspect_fit(path)
    if path.is_file() and (known := registry.identify(path)) is not None:
        return inspect_instrument_file(path, known.name)
    if path.is_file() and path.suffix.lower() != ".bsdf" and not begins_with(path, tensor_file.MAGIC):
        raise registry.unknown(path)
    return _inspect_file(read_bsdf(path), path)


def inspect_renderer() -> Inspection:
    """Mitsuba's backend on this machine, and why; every LLVM library is tried again."""
    chosen = backend.choose(refresh=True)
    tried = {probe.library: probe.outcome for probe in chosen.probes}
    libraries = list(dict.fromkeys([*tried, *libllvm.find_libraries()]))
    outcomes = [(library, tried.get(library, "not tested: a newer one works")) for library in libraries]
    if not tried:
        outcomes = [(library, "not tested: scalar was requested") for library in libraries]
    rows: dict[str, object] = {
        "Mitsuba": libllvm.mitsuba_version(),
        "variants": f"{chosen.kind}, " + ("vectorised" if chosen.is_llvm else "one sample at a time"),
        "libLLVM": chosen.library or "none",
    }
    if chosen.advice is not None:
        rows["advice"] = chosen.advice
    table = Table(("library", "outcome"), tuple((str(library), outcome) for library, outcome in outcomes))
    document = chosen.to_json() | {"libraries": {str(library): outcome for library, outcome in outcomes}}
    return Inspection("Renderer", rows, document, (table,) if libraries else ())


def _inspect_file(file: BsdfFile, path: Path) -> Inspection:
    from manifold.brdf.unmeasured import unmeasured_cells, unmeasured_share

    P, T, B, H, W = file.spectra.shape
    mask = file.measured_mask
    share = unmeasured_share(file, unmeasured_cells(file))
    rows: dict[str, object] = {
        "description": file.description,
        "kind": "isotropic" if file.is_isotropic else f"anisotropic, {P} incident azimuths",
        "bands": str(file.bands),
        "theta_i in degrees": [f"{np.rad2deg(t):.1f}" for t in file.theta_i_rad],
        "outgoing grid": f"{H} x {W}",
        "ndf": " x ".join(str(n) for n in file.ndf.shape),
        "vndf": " x ".join(str(n) for n in file.vndf.shape[2:]),
        "pipeline version": ".".join(str(v) for v in file.version),
        "measured cells": f"{mask.mean():.1%}",
        "exact zeros": f"{np.mean(file.spectra == 0):.1%}",
        "unmeasured cells above the horizon": f"{share:.1%}",
        "values": f"{file.spectra.min():.4g} to {file.spectra.max():.4g}",
        "size": f"{path.stat().st_size / 1e6:.1f} MB",
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
    }
    return Inspection(f"{path.name}: RGL material", rows, document)


def _inspect_fit(path: Path) -> Inspection:
    from manifold.fitting import fit_json

    content = fit_json.read(path)
    source, metric, entry = content["source"], content["metric"], content.get("target")
    of = source["file"] or "a BRDF"
    if source["latent"] is not None:
        of = f"the prediction of {source['model']} at latent {_words(source['latent'])}"
    rows: dict[str, object] = {
        "material": source["name"],
        "fitted to": of,
        "BSDF": content["bsdf"]["type"],
        "relative residual": f"{metric} {content['residuals'][metric]:.3f}",
    }
    if content["notes"]:
        rows["notes"] = tuple(content["notes"])
    tables = [("parameter", content["values"])]
    if entry is not None:
        ball = f"{entry['ciede2000']:.2f} CIEDE2000 on the ball"
        rows["target"] = f"{entry['name']}, {ball} against the {entry['against']}"
        tables.append((f"parameter of {entry['name']}", entry["parameters"]))
    return Inspection(
        f"{path.name}: fit by {content['program']}",
        rows,
        content | {"path": str(path)},
        tuple(
            Table((head, "value"), tuple((k, _words(v)) for k, v in found.items())) for head, found in tables
        ),
    )


def _words(value: float | list[float]) -> str:
    """A number, a colour, or the range of a value per band."""
    values = value if isinstance(value, list) else [value]
    if len(values) > 4:
        return f"{min(values):.4g} to {max(values):.4g} in {len(values)} bands"
    return ", ".join(f"{v:.4g}" for v in values)


def _inspect_library(path: Path, verify: bool, on_progress: Progress | None) -> Inspection:
    from manifold.library.store import Library

    library = Library.open(path)
    info = library.info
    synthetic = sum(m.is_synthetic for m in info.materials)
    rows: dict[str, object] = {
        "materials": f"{len(info.materials)}" + (f", {synthetic} of them synthetic" if synthetic else ""),
        "bands": str(info.bands),
        "size": f"{info.bytes / 1e6:.1f} MB",
        "content hash": info.content_hash,
        "schema version": info.schema_version,
    }
    problems: list[str] = []
    if verify:
        problems = library.verify(on_progress)
        rows["verified"] = "all hashes match" if not problems else f"{len(problems)} damaged"
    table = Table(
        ("material", "grid", "pipeline", "MB", "description"),
        tuple(
            (
                m.name,
                f"{m.shape[3]} x {m.shape[4]}" + (f" x {m.shape[0]} azimuths" if m.shape[0] > 1 else ""),
                ".".join(str(v) for v in m.pipeline_version),
                f"{m.bytes / 1e6:.1f}",
                m.description,
            )
            for m in info.materials
        ),
    )
    document = {
        "path": str(path),
        "schema_version": info.schema_version,
        "bands": str(info.bands),
        "content_hash": info.content_hash,
        "bytes": info.bytes,
        "materials": [asdict(m) for m in info.materials],
        "verified": verify,
        "problems": problems,
    }
    return Inspection(f"{path}: library", rows, document, (table,) if info.materials else (), problems)


def _inspect_model(path: Path, library: Path | None) -> Inspection:
    from manifold.model.restoring import restore

    stored = read_model(path)
    s, space, left_out = restore(path, stored)
    found, missing = _library_of(path, library)
    rows: dict[str, object] = {
        "materials": len(stored.names),
        "library": found.path
        if found is not None
        else f"{missing}; predictions, renders and reports need it",
        "bands": found.bands if found is not None else stored.n_bands or "unknown without the library",
        "kind": _KINDS[s.kind],
        "latent dimensions": s.latent_dim,
        "mapping": s.mapping,
        "kernel": f"{s.kernel} + delta, length scale {s.length_scale:g}, mu {s.mu:g}",
        "condition of K": f"{space.gp.condition:.3g}",
        "optimizer": s.optimizer,
        "criterion": s.criterion,
        "objective": f"{stored.statistics['objective']:.6g} (start {stored.statistics['objective_start']:.6g})",
        "size": f"{path.stat().st_size / 1e3:.1f} kB",
    }
    errors = None if left_out is None else np.column_stack([left_out.ball, left_out.cube_root])
    if errors is not None:
        low, high = np.quantile(errors, (0.5, 0.9), axis=0)
        rows["left-out errors"] = [
            f"median {low[0]:.1f}, 90th percentile {high[0]:.1f} CIEDE2000 of the ball",
            f"{low[1]:.0%}, {high[1]:.0%} cube-root error",
        ]
    table = Table(
        (
            "material",
            *(f"x{k + 1}" for k in range(s.latent_dim)),
            *(("left out: ball", "cube root") if errors is not None else ()),
        ),
        tuple(
            (
                name,
                *space.printed(row),
                *(() if errors is None else (f"{errors[k, 0]:.1f}", f"{errors[k, 1]:.0%}")),
            )
            for k, (name, row) in enumerate(zip(stored.names, space.X, strict=True))
        ),
    )
    document = {
        "path": str(path),
        "library": str(stored.library if found is None else found.path),
        "library_problem": missing,
        "settings": dict(vars(s)),
        "statistics": stored.statistics,
        "latents": {name: [float(v) for v in row] for name, row in zip(stored.names, space.X, strict=True)},
        "left_out": None
        if errors is None
        else {
            name: {"ball": float(e[0]), "cube_root": float(e[1])}
            for name, e in zip(stored.names, errors, strict=True)
        },
    }
    return Inspection(f"{path}: manifold model", rows, document, (table,))


def _library_of(path: Path, named: Path | None) -> tuple[Library | None, str | None]:
    """The library of a model, or why it cannot be used; one that was named has to be usable."""
    from manifold.model.manifold import Manifold

    try:
        return Manifold.load(path, named).library, None
    except LibraryError as error:
        if named is not None:
            raise
        return None, str(error)
