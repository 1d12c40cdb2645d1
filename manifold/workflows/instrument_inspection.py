"""Contents of an instrument's file, as rows and tables for `manifold info`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from manifold.formats import registry
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings
from manifold.records import Bands

_MOST_SAMPLES = 40  # listed one by one


def inspect_instrument_file(
    path: Path, format_name: str
) -> tuple[dict[str, object], dict[str, Any], list[tuple[Sequence[str], Sequence[Sequence[object]]]]]:
    """Samples, directions, bands, notes and texture of a file of a known format.

    Returns:
        labels and values, the same for JSON, and tables: their heads and rows.
    Raises:
        FileFormatError: the file is damaged.
    """
    records = registry.read_all(path)
    first = records[0]
    rows: dict[str, object] = {"format": format_name, "instrument": first.instrument}
    rows |= {"samples": len(records)} if len(records) > 1 else {"sample": first.name}
    rows |= _of_table(first) if isinstance(first, DenseTable) else _of_readings(first)
    rows["values in 1/sr"] = _range(np.concatenate([record.values.ravel() for record in records]))
    for k, note in enumerate(dict.fromkeys(note for record in records for note in record.notes), start=1):
        rows[f"note {k}"] = note
    size = path.stat().st_size
    rows["size"] = f"{size / 1e6:.3g} MB" if size >= 1e5 else f"{size / 1e3:.3g} kB"
    tables: list[tuple[Sequence[str], Sequence[Sequence[object]]]] = []
    if len(records) > 1:
        listed = [(r.name, _count(r), str(r.bands)) for r in records[:_MOST_SAMPLES]]
        tables.append((("sample", "pairs", "bands"), listed))
    textures = [record.texture for record in records if isinstance(record, Readings) and record.texture]
    if textures:
        rows["texture"] = "graininess, sparkle or images of the sample are below"
        tables += [_texture_table(key, value) for key, value in textures[0].items()]
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
        "measured values": f"{readings.measured.mean():.1%}",
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
        "measured nodes": f"{table.measured.mean():.1%}",
    }


def _bands(bands: Bands) -> str:
    return f"{bands}: {', '.join(bands.labels)}" if 1 < bands.count <= 4 and not bands.is_rgb else str(bands)


def _range(values: Any) -> str:
    return f"{np.nanmin(values):.4g} to {np.nanmax(values):.4g}" if np.any(np.isfinite(values)) else "none"


def _count(record: registry.Record) -> int:
    return len(record) if isinstance(record, Readings) else int(np.count_nonzero(record.measured))


def _texture_table(key: str, value: Any) -> tuple[Sequence[str], Sequence[Sequence[object]]]:
    """Images by their size, a list of entries with their columns, or single values."""
    if key == "images" and isinstance(value, Mapping):
        return ("flake image", "size"), [(name, f"{len(data) / 1e3:.1f} kB") for name, data in value.items()]
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
    """Values that JSON has; images by their length in bytes."""
    if isinstance(value, bytes):
        return {"bytes": len(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)
