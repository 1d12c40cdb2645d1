"""Results and files as a flat mapping of names to numbers and short texts."""

from __future__ import annotations

import base64
import csv
import gzip
import hashlib
import json
import re
import struct
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Value = float | str
Numbers = dict[str, Value]

DROPPED = re.compile(
    r"(^|_)(seconds|milliseconds|ms|date|program|generator|sha256|hash|uuid|digest|version|path|backend)($|_)"
    r"|^(time|clock|renderer|ratio_to_clock|minimum|maximum|default|transform|per_band|affine|hyperparameters)"
    r"|^(fit|predict|scaled|fronts)$"  # of the chart: times, and what follows from them
)
"""Names of what differs from run to run, from machine to machine, or with the version; and of settings of fits."""

_FEW = 12  # numbers of a list that are kept one by one
_MANY_FILES = 6  # of one suffix in a folder: beyond, their numbers are summed up over the files
_MANY_NUMBERS = 200  # in a text: beyond, they are summed up
_LONG_TEXT = 120  # characters that are kept; of the rest, a hash
_QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
_CHANGING = re.compile(
    r"manifold \d+\.\d+\S*|\d{4}-\d\d-\d\dT?[\d:+.Z]*|(?<![\w.])/\S*/(?=\S)"
)  # versions, dates, folders
_HALVES = ("first", "radiance")  # texts of the page that are float16; the others are bytes
_LABELS = ("name", "key", "mode", "material", "target", "sample", "method")


def flat(value: Any, name: str = "") -> Numbers:
    """Everything in a JSON document, an array or a record of arrays, by its path."""
    if isinstance(value, Mapping):
        kept = {str(k): v for k, v in value.items() if not DROPPED.search(str(k))}
        return _joined(flat(v, f"{name}/{k}" if name else k) for k, v in kept.items())
    if isinstance(value, bool | np.bool_ | None):
        return {name: str(value)}
    if isinstance(value, int | float | np.number):
        return {name: float(value)}
    if isinstance(value, str):
        return {name: text_value(value)}
    if isinstance(value, np.ndarray):
        return of_array(value, name)
    return _of_list(list(value), name)


def _of_list(items: list[Any], name: str) -> Numbers:
    if len(items) > _FEW and all(isinstance(item, str) for item in items):
        return {name: text_value("; ".join(items))}
    array = _as_array(items)
    if array is not None:
        return of_array(array, name)
    if all(isinstance(i, list | tuple) and len(i) == 2 and isinstance(i[0], str) for i in items):
        named = [(str(key), value) for key, value in items]
    else:
        named = [(_label(item) or str(k), item) for k, item in enumerate(items)]
    if len({key for key, _ in named}) < len(named):
        named = [(f"{key}.{k}", item) for k, (key, item) in enumerate(named)]
    if len(named) > _FEW and all(isinstance(item, Mapping) for _, item in named):
        return over_many([flat(item) for _, item in named], name)
    return _joined(flat(item, f"{name}/{key}" if name else key) for key, item in named)


def _label(item: Any) -> str:
    """What tells an item of a list from the others, or nothing."""
    if not isinstance(item, Mapping):
        return ""
    found = [str(item[key]) for key in _LABELS if isinstance(item.get(key), str)]
    return " ".join(dict.fromkeys(Path(word).name for word in found[:2]))


def _as_array(items: list[Any]) -> np.ndarray | None:
    try:
        array = np.array(items)
    except ValueError:  # rows of different lengths
        return None
    return array if array.size and array.dtype.kind in "biuf" else None


def of_array(array: np.ndarray, name: str) -> Numbers:
    """Few numbers one by one; of many the shape, sums without cancellation, and quantiles."""
    if array.dtype.kind not in "biuf":
        return flat(array.tolist(), name)
    x = np.asarray(array, np.float64).ravel()
    if x.size <= _FEW:
        return {f"{name}/{k}" if x.size > 1 else name: float(v) for k, v in enumerate(x)}
    finite = x[np.isfinite(x)]
    made: Numbers = {f"{name}/shape": "x".join(map(str, array.shape))}
    if finite.size < x.size:
        made[f"{name}/not finite"] = float(x.size - finite.size)
    if finite.size == 0:
        return made
    made[f"{name}/positive"] = float(np.maximum(finite, 0.0).sum())
    if finite.min() < 0.0:
        made[f"{name}/negative"] = float(np.maximum(-finite, 0.0).sum())
    # Changes where values of an array change places.
    made[f"{name}/in order"] = float(np.abs(finite) @ (1.5 + np.cos(np.arange(finite.size))))
    for q, value in zip(_QUANTILES, np.quantile(finite, _QUANTILES), strict=True):
        made[f"{name}/q{q:.0%}"] = float(value)
    return made


def over_many(all_numbers: list[Numbers], name: str) -> Numbers:
    """The numbers of many alike things, summed up by their names."""
    made: Numbers = {f"{name}/count": float(len(all_numbers))}
    for key in dict.fromkeys(key for numbers in all_numbers for key in numbers):
        values = [numbers[key] for numbers in all_numbers if key in numbers]
        where = f"{name}/{key}"
        if all(isinstance(v, float) for v in values):
            made |= of_array(np.array(values), where)
        else:
            made[where] = text_value("; ".join(map(str, values)))
    return made


def text_value(text: str) -> str:
    """A text without folders, dates and versions; the end of a long one as a hash."""
    text = _CHANGING.sub("", " ".join(text.split()))
    if len(text) <= _LONG_TEXT:
        return text
    return f"{text[:_LONG_TEXT]}... {hashlib.sha256(text.encode()).hexdigest()[:8]}"


def of_text(text: str, name: str) -> Numbers:
    """The numbers of a text, each by the word before it, and its words."""
    text = _CHANGING.sub("", text)
    numbers = list(_NUMBER.finditer(text))
    words = " ".join(_NUMBER.sub("#", text).split())
    made: Numbers = {f"{name}/words": text_value(words)}
    if len(numbers) > _MANY_NUMBERS:
        return made | of_array(np.array([float(m[0]) for m in numbers]), name)
    counts: dict[str, int] = {}
    end, word = 0, "start"
    for match in numbers:
        before = re.findall(r"[A-Za-z_]\w*", text[end : match.start()])
        word, end = before[-1] if before else word, match.end()
        counts[word] = counts.get(word, 0) + 1
        made[f"{name}/{word}.{counts[word]}"] = float(match[0])
    return made


# -- files -------------------------------------------------------------------------------------------------


def of_folder(folder: Path) -> Numbers:
    """All files in a folder that are no links, in no library, and no logs of batches."""
    groups: dict[tuple[str, str], list[Path]] = {}
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        hidden = any(p.startswith(".") or p.endswith(".zarr") for p in inside.parts)
        linked = any((folder / p).is_symlink() for p in [inside, *inside.parents][:-1])
        if path.is_file() and path.suffix != ".jsonl" and not hidden and not linked:
            groups.setdefault((str(inside.parent), path.suffix), []).append(path)
    made: Numbers = {}
    for (parent, suffix), paths in groups.items():
        where = "" if parent == "." else f"{parent}/"
        if len(paths) > _MANY_FILES:
            made |= over_many([of_file(path, "") for path in paths], f"{where}*{suffix}")
        else:
            made |= _joined(of_file(path, where + path.name) for path in paths)
    return made


def of_file(path: Path, name: str) -> Numbers:
    """What is in a file, by its kind."""
    content = path.read_bytes()
    if content.startswith(b"tensor_file\0"):
        return _of_rgl(path, content, name)
    return _READERS.get(path.suffix, _of_text_file)(path, name)


def _of_text_file(path: Path, name: str) -> Numbers:
    return of_text(path.read_text(encoding="utf-8", errors="replace"), name)


def _of_rgl(path: Path, content: bytes, name: str) -> Numbers:
    """The fields as they are stored, and values, albedos and densities as the package evaluates them."""
    made: Numbers = {}
    at = 18
    for _ in range(struct.unpack_from("<I", content, 14)[0]):
        (length,) = struct.unpack_from("<H", content, at)
        field = content[at + 2 : at + 2 + length].decode()
        at += 2 + length
        ndim, kind, offset = struct.unpack_from("<HBQ", content, at)
        shape = struct.unpack_from(f"<{ndim}Q", content, at + 11)
        at += 11 + 8 * ndim
        array = np.frombuffer(content, _TENSOR_TYPES[kind], int(np.prod(shape)), offset).reshape(shape)
        if field == "description":
            made[f"{name}/{field}"] = text_value(array.tobytes().decode("utf-8", "replace"))
        elif field != "version":
            made |= of_array(array, f"{name}/{field}")
    return made | _joined([flat(_evaluated(path), name)])


def _evaluated(path: Path) -> dict[str, Any]:
    import manifold as mf

    brdf = mf.MeasuredBRDF(mf.read_bsdf(path))
    wi, wo = direction_pairs()
    return {"f": brdf.eval(wi, wo), "albedo": brdf.albedo(wi[::8]), "density": brdf.pdf(wi, wo)}


def direction_pairs(count: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (count, 3) twice, spread over the hemisphere; every fourth is near the mirror direction."""
    k = np.arange(count)
    theta_i, theta_o = 1.45 * ((0.618 * k) % 1.0), 1.45 * ((0.382 * k + 0.2) % 1.0)
    phi_i, phi_o = 2.4 * k, 4.1 * k
    near = k % 4 == 0
    theta_o, phi_o = np.where(near, theta_i + 0.02, theta_o), np.where(near, phi_i + np.pi, phi_o)

    def vector(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)

    return vector(theta_i, phi_i), vector(theta_o, phi_o)


def _of_json(path: Path, name: str) -> Numbers:
    return flat(json.loads(path.read_text(encoding="utf-8")), name)


def _of_csv(path: Path, name: str) -> Numbers:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    if len(rows) < 2 or len({len(row) for row in rows}) > 1 or _NUMBER.fullmatch(rows[0][-1]):
        return _of_text_file(path, name)
    made: Numbers = {}
    for head, *cells in zip(*rows, strict=True):
        if DROPPED.search(head):
            continue
        where = f"{name}/{head}"
        if all(_NUMBER.fullmatch(cell) for cell in cells):
            made |= of_array(np.array(cells, float), where)
        else:
            made[where] = text_value("; ".join(cells))
    return made


def _of_workbook(path: Path, name: str) -> Numbers:
    import openpyxl

    made: Numbers = {}
    for sheet in openpyxl.load_workbook(path, data_only=True):
        cells = [cell for row in sheet.iter_rows(values_only=True) for cell in row if cell is not None]
        made |= of_array(np.array([c for c in cells if isinstance(c, int | float)]), f"{name}/{sheet.title}")
        made[f"{name}/{sheet.title}/words"] = text_value(" ".join(c for c in cells if isinstance(c, str)))
    return made


def _of_picture(path: Path, name: str) -> Numbers:
    from PIL import Image

    with Image.open(path) as image:
        return of_picture(np.asarray(image.convert("RGB"), float), name)


def _of_exr(path: Path, name: str) -> Numbers:
    import mitsuba

    if mitsuba.variant() is None:
        mitsuba.set_variant("scalar_rgb")
    return of_picture(np.array(mitsuba.Bitmap(str(path))), name)


def of_picture(pixels: np.ndarray, name: str) -> Numbers:
    """Size, mean colour, and the means of 3 x 3 parts."""
    rows, columns = pixels.shape[:2]
    made: Numbers = {f"{name}/size": f"{columns} x {rows}"}
    made |= of_array(pixels.reshape(rows * columns, -1).mean(axis=0), f"{name}/mean")
    parts = [
        column.mean()
        for row in np.array_split(pixels, 3, axis=0)
        for column in np.array_split(row, 3, axis=1)
    ]
    return made | of_array(np.array(parts), f"{name}/parts")


def _of_glb(path: Path, name: str) -> Numbers:
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    made = flat(json.loads(content[20 : 20 + length]), name)
    rest = content[20 + length + 8 :]
    return made | of_array(np.frombuffer(rest[: len(rest) // 4 * 4], "<u2"), f"{name}/buffer")


def _of_model(path: Path, name: str) -> Numbers:
    import h5py

    made: Numbers = {}

    def visit(where: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or DROPPED.search(where):
            return
        array = np.asarray(item)
        if array.dtype == np.uint8:  # a JSON document
            made.update(flat(json.loads(array.tobytes()), f"{name}/{where}"))
        else:
            made.update(of_array(array, f"{name}/{where}"))

    with h5py.File(path) as file:
        file.visititems(visit)
    return made


def _of_page(path: Path, name: str) -> Numbers:
    found = re.search(r'id="data">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    return {} if found is None else flat(_unpacked(json.loads(found[1])), name)


def _unpacked(value: Any, key: str = "") -> Any:
    """A document of the page whose packed texts are arrays."""
    if isinstance(value, dict):
        return {k: _unpacked(v, k) for k, v in value.items()}
    if isinstance(value, list):
        return [_unpacked(v, key) for v in value]
    if isinstance(value, str) and value.startswith("H4sI"):  # gzip in base64
        content = gzip.decompress(base64.b64decode(value))
        return np.frombuffer(content, "<f2" if key in _HALVES else np.int8)
    return value


def _of_doubles(path: Path, name: str) -> Numbers:
    content = path.read_bytes()
    return of_array(np.frombuffer(content[len(content) % 8 + 8 * (len(content) % 8 > 0) :], "<f8"), name)


def _joined(parts: Iterable[Numbers]) -> Numbers:
    made: Numbers = {}
    for part in parts:
        made |= part
    return made


_TENSOR_TYPES = dict(
    enumerate(["u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"], start=1)
)
_READERS: dict[str, Callable[[Path, str], Numbers]] = {
    ".json": _of_json, ".xompt": _of_json, ".csv": _of_csv, ".xlsx": _of_workbook, ".png": _of_picture,
    ".exr": _of_exr, ".glb": _of_glb, ".h5": _of_model, ".html": _of_page, ".binary": _of_doubles,
    ".bin": _of_doubles,
}  # fmt: skip
