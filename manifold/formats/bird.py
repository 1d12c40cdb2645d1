"""BRDF files of the BiRD project (EURAMET): JSON with a row for every value, and its uncertainty.

Angles are in degrees or radians, wavelengths in nm or um, values in 1/sr. Values of several polarisation states at
the same directions and wavelength are averaged, which gives the value of unpolarised light if the states are
orthogonal.

Source: BiRD project, BRDF_JSON_schema version 1.0.
"""

from __future__ import annotations

import datetime
import json
import re
import uuid
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__
from manifold.core import disk
from manifold.core.defaults import GONIOMETER
from manifold.core.names import in_one_line
from manifold.core.records import Array
from manifold.formats.geometries import by_band, directions
from manifold.formats.readings import Readings
from manifold.formats.text import ErrorContext, angle_unit, decode, nanometres, read_bytes
from manifold.formats.values import weights_of

_REMEDY = "export the file again"
_LARGEST = 200_000_000  # bytes
_SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
_ANGLES = {"theta_i": "theta_i", "phi_i": "phi_i", "theta_r": "theta_o", "phi_r": "phi_o"}
_NOT_STATED = "not stated"
_MOST_THETA_DEG, _MOST_PHI_DEG = 89.999999, 360.0  # the schema excludes the horizon


def sniff(head: bytes) -> bool:
    """Return whether a file's beginning is JSON that names the schema, or has its variables."""
    text = decode(head)
    return text.lstrip().startswith("{") and (
        re.search(r"brdf_json_schema", text, re.IGNORECASE) is not None
        or all(re.search(rf'"{key}"\s*:', text) for key in ("theta_i", "theta_r", "BRDF"))
    )


def read(path: Path) -> list[Readings]:
    """Return readings at all wavelengths, with NaN where a pair of directions has no value.

    Readings with a larger uncertainty get a smaller weight; their `scatter` is the uncertainty of their cube roots.
    """
    context = ErrorContext(path, _REMEDY)
    try:
        content = json.loads(read_bytes(path, _LARGEST))
        data, metadata = content["data"], content.get("metadata", {})
        name = metadata.get("sample", {}).get("name") or path.stem
        instrumentation = metadata.get("instrumentation")
    except (ValueError, RecursionError) as error:
        raise context.error(f"no JSON ({' '.join(str(error).split())[:80]})") from None
    except (KeyError, TypeError, AttributeError):
        raise context.error("no section 'data', expected a BRDF file of the BiRD schema") from None
    if not isinstance(data, dict):
        raise context.error("no section 'data', expected a BRDF file of the BiRD schema")
    f, unit = _variable(data, "BRDF", context)
    if unit not in ("1/sr", "sr^-1"):
        raise context.error(f"of unit '{unit}', expected sr^-1", field="BRDF")
    angles = {ours: _angle(data, key, len(f), context) for key, ours in _ANGLES.items()}
    notes: list[str] = []
    kept, wi, wo = directions(angles, context, notes)
    f = f[kept]
    uncertainty = _uncertainty(data, len(kept), context)[kept]
    nm = _wavelengths(data, len(kept), context)[kept]
    rows = by_band(np.hstack([wi, wo]), nm, context)
    if rows.repeated:
        if "polarization_i" not in data and "polarization_r" not in data:
            notes.append(f"{rows.repeated} values repeat directions and wavelength: their means are taken")
        else:
            notes.append(
                "values of several states of polarisation: their means are taken, as for unpolarised light"
            )
    elif "polarization_i" in data or "polarization_r" in data:
        notes.append("values of one state of polarisation: taken as those of unpolarised light")

    values, errors = rows.table(f), rows.table(uncertainty * f)
    said = weights_of(errors / np.maximum(values, np.finfo(float).tiny))
    if said is not None:
        notes.append(said.note)
    instrument = instrumentation.get("name") if isinstance(instrumentation, dict) else None
    return [
        Readings(
            str(name), str(instrument or "BiRD file"), wi[rows.first], wo[rows.first], rows.wavelengths_nm, values,
            notes=tuple(notes), **({"repeatability": GONIOMETER} if said is None else said.readings),
        )
    ]  # fmt: skip


def _variable(
    data: dict[str, Any], key: str, context: ErrorContext, count: int | None = None
) -> tuple[Array, str]:
    """Return the values (n,) of a variable and their unit."""
    variable = data.get(key)
    values = variable.get("values") if isinstance(variable, dict) else None
    if not isinstance(variable, dict) or not isinstance(values, list) or not values:
        raise context.error("has no values, expected one for every row", field=key)
    if any(
        isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e300
        for value in values
    ):
        raise context.error("has values that are not numbers of at least 0", field=key)
    if count is not None and len(values) != count:
        raise context.error(f"has {len(values)} values, expected {count}, as many as the BRDF has", field=key)
    return np.array(values, dtype=np.float64), str(variable.get("unit", ""))


def _angle(data: dict[str, Any], key: str, count: int, context: ErrorContext) -> Array:
    values, unit = _variable(data, key, context, count)
    if (of_angle := angle_unit(unit)) is None:
        raise context.error(f"of unit '{unit}', expected deg or rad", field=key)
    return values if of_angle == "radians" else np.deg2rad(values)


def _wavelengths(data: dict[str, Any], count: int, context: ErrorContext) -> Array:
    key = "wavelength_r" if "wavelength_i" not in data and "wavelength_r" in data else "wavelength_i"
    if key not in data:
        raise context.error("is missing, expected the wavelength of every row", field=key)
    values, unit = _variable(data, key, context, count)
    if np.any(values <= 0.0) or (nm := nanometres(values, unit)) is None:
        raise context.error(
            f"{values.min():g} or more of unit '{unit}', expected wavelengths in nm", field=key
        )
    return nm


def _uncertainty(data: dict[str, Any], count: int, context: ErrorContext) -> Array:
    """Return the relative standard uncertainty of every value, 0 if none is given."""
    f = np.array(data["BRDF"]["values"], dtype=np.float64)
    if "uBRDF" in data:
        values, unit = _variable(data, "uBRDF", context, count)
    elif isinstance(one := data["BRDF"].get("uncertainty"), dict) and isinstance(
        one.get("value"), int | float
    ):
        values, unit = np.full(count, float(one["value"])), str(one.get("unit", ""))
    else:
        return np.zeros(count)
    if unit == "%":
        return values / 100.0
    if unit not in ("1/sr", "sr^-1"):
        raise context.error(f"of unit '{unit}', expected sr^-1 or %", field="uBRDF")
    return np.divide(values, f, out=np.zeros(count), where=f > 0.0)


def write(path: Path, readings: Readings, method: str) -> None:
    """Write spectral readings as a BiRD file, with an uncertainty of every value if they have a `scatter`.

    The fields on who measured, where and with which instrument are left empty.
    """
    nm = np.asarray(readings.bands.wavelengths_nm)
    pair, band = np.nonzero(readings.measured)
    f = np.maximum(readings.values[pair, band], 0.0)

    def variable(values: Array, unit: str, digits: int) -> dict[str, Any]:
        return {"unit": unit, "values": [float(f"{value:.{digits}g}") for value in values]}

    def angles(w: Array) -> tuple[Array, Array]:
        theta = np.rad2deg(np.arccos(np.clip(w[pair, 2], -1.0, 1.0)))
        phi = np.mod(np.rad2deg(np.arctan2(w[pair, 1], w[pair, 0])), _MOST_PHI_DEG)
        return np.minimum(theta, _MOST_THETA_DEG), np.where(phi >= _MOST_PHI_DEG - 5e-8, 0.0, phi)

    (theta_i, phi_i), (theta_r, phi_r) = angles(readings.wi), angles(readings.wo)
    data = {
        "wavelength_i": variable(nm[band], "nm", 9),
        "theta_i": variable(theta_i, "deg", 10),
        "phi_i": variable(phi_i, "deg", 10),
        "theta_r": variable(theta_r, "deg", 10),
        "phi_r": variable(phi_r, "deg", 10),
        "BRDF": variable(f, "sr^-1", 7),
    }
    if np.any(readings.scatter > 0.0):
        data["uBRDF"] = variable(3.0 * readings.scatter[pair] * f, "sr^-1", 4)
        data["uBRDF"]["comments"] = (
            "standard uncertainty, coverage factor 1"
            if method == "measurement"
            else "expected error of a prediction: a typical error, not a standard uncertainty"
        )
    where = {"country": _NOT_STATED, "city": _NOT_STATED, "street": _NOT_STATED, "building_nr": _NOT_STATED,
             "postal_code": _NOT_STATED}  # fmt: skip
    provenance = {
        "organization": _NOT_STATED, "location": where, "email": "not.stated@example.invalid",
        "contact_person": _NOT_STATED,
    }  # fmt: skip
    metadata = {
        "schema": _SCHEMA,
        "id": uuid.UUID(bytes=sha256(f.tobytes()).digest()[:16], version=5).urn,
        "type": "BRDF",
        "timestamp": datetime.datetime.fromtimestamp(0, datetime.UTC).isoformat(),
        "provenance": provenance,
        "description": f"{in_one_line(readings.name)}, from: {in_one_line(readings.instrument)}; the timestamp is not "
        "that of the measurement",
        "method": method,
        "instrumentation": "NA",
        "software": {"name": "manifold", "version": __version__},
        "sample": {
            "name": in_one_line(readings.name), "type": _NOT_STATED, "shape": _NOT_STATED, "dimensions": {},
            "zero_azimuth_location": _NOT_STATED,
        },
        "environment": "NA",
    }  # fmt: skip
    disk.write_text(path, json.dumps({"metadata": metadata, "data": data}, ensure_ascii=False) + "\n")
