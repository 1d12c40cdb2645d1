"""Mitsuba scenes as documents: finding their measured materials, and replacing them.

A scene is an XML file, or a dictionary of plain values as `mi.load_dict` takes it (in files: JSON), where `to_world`
may be a matrix of four rows. Sought are BSDFs of the types `measured` and `manifold`, at any depth, in included files
too: these become part of the document.
"""

from __future__ import annotations

import copy
import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from manifold.errors import UsageError
from manifold.experiments.budget import scene_files
from manifold.rendering import backend, images
from manifold.rendering.plugin_names import require_plugins, types_of
from manifold.system import atomic, small_files

KINDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "measured": ("filename",),
        "manifold": ("model", "library", "latent", "like", "reflectance", "srgb", "tolerance"),
    }
)
"""Plugin names of measured materials, and their properties."""

_FILES = ("filename", "model", "library", "reflectance")
_LARGEST_FILM = 1 << 16
_FILM_SIZE = (768, 576)  # Mitsuba's own default
_NUMBERS = {"float": float, "integer": int}


@dataclass(frozen=True)
class SceneMaterial:
    """A measured material of a scene.

    Attributes:
        key: identifies it in the scene; the same file or prediction used twice is one material.
        kind: `measured` or `manifold`.
        properties: of the plugin, paths made absolute.
    """

    key: str
    kind: str
    properties: Mapping[str, str]


class SceneDocument:
    """A scene whose measured materials and film can be exchanged before it is loaded or written."""

    def __init__(self, content: ET.Element | dict[str, Any], origin: str, folder: Path) -> None:
        """Take the tree of an XML file or a dictionary; `folder` is what its relative paths start from.

        Raises:
            UsageError: there is no sensor, no measured material, or one with other properties than the plugin's.
        """
        self._content, self.origin = content, origin
        self._is_xml = isinstance(content, ET.Element)
        require_plugins(_types(content), origin)
        self._resolve(folder)
        found = [_material(self._properties(node)) for node in _bsdfs(content)]
        for material in found:
            _require_known(material, origin)
        self.materials = tuple({material.key: material for material in found}.values())
        if not self.materials:
            raise UsageError(
                f"{origin}: no measured materials; expected BSDFs of the type measured or manifold in the scene"
            )
        if _first_sensor(content) is None:
            raise UsageError(f"{origin}: no sensor; expected a camera in the scene")

    @classmethod
    def read(cls, scene: Path | Mapping[str, Any]) -> SceneDocument:
        """A scene from an XML file, a JSON file, or a dictionary of plain values.

        Raises:
            UsageError: there is no such file, or nothing in it to work with.
            FileFormatError: it is neither XML nor JSON of a scene; see `scene_files.read_tree`.
        """
        if isinstance(scene, Mapping):
            try:
                content = json.loads(json.dumps(dict(scene)))
            except (TypeError, ValueError, RecursionError) as error:
                raise UsageError(
                    f"the scene contains an object that is not plain data ({error}); expected numbers, strings, "
                    "lists and dictionaries"
                ) from error
            return cls(scene_files.require_scene(content, "the scene"), "the scene", Path())
        return cls(scene_files.read_tree(scene), str(scene), scene.parent.absolute())

    @property
    def suffix(self) -> str:
        """Of a file that holds it."""
        return ".xml" if self._is_xml else ".json"

    @property
    def film_size(self) -> tuple[int, int]:
        """Width and height in pixels of the first sensor's film."""
        sensor: Any = _first_sensor(self._content)
        film = _film(sensor)
        properties = {} if film is None else self._properties(film)
        try:
            width, height = (
                int(properties.get(n, d)) for n, d in zip(("width", "height"), _FILM_SIZE, strict=True)
            )
        except ValueError as error:
            raise UsageError(
                f"{self.origin}: size of the film: {error}; expected numbers of pixels"
            ) from error
        if min(width, height) < 1 or max(width, height) > _LARGEST_FILM:
            found = f"{width} x {height}" if max(width, height) <= _LARGEST_FILM else "more"
            raise UsageError(
                f"{self.origin}: size of the film: found {found}, expected at least 1 x 1 pixels and at most "
                f"{_LARGEST_FILM} x {_LARGEST_FILM}"
            )
        return width, height

    def load(self, mi: Any, bsdfs: Mapping[str, Mapping[str, Any]], film: Mapping[str, Any]) -> Any:
        """The scene in the variant that is set, with BSDFs by key in place of its materials, and another film.

        Raises:
            UsageError: Mitsuba refuses the scene.
        """
        content = self._with(bsdfs, film)
        try:
            if isinstance(content, ET.Element):
                return mi.load_string(ET.tostring(_without_paths(content), encoding="unicode"))
            return mi.load_dict(_with_transforms(mi, content))
        except Exception as error:  # Mitsuba raises bare RuntimeErrors, and plugins their own
            reason = " ".join(str(error).split())[-200:]
            raise UsageError(
                f"{self.origin}: Mitsuba refuses the scene ({reason}); check it there"
            ) from error

    def write(self, path: Path, bsdfs: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the scene with BSDFs by key in place of its materials. Raises: as `atomic.replacing`."""
        content = self._with(bsdfs, None)
        if isinstance(content, ET.Element):
            ET.indent(content)
            atomic.write_text(path, ET.tostring(content, encoding="unicode") + "\n")
        else:
            atomic.write_text(path, json.dumps(content, indent=1) + "\n")

    def _with(self, bsdfs: Mapping[str, Mapping[str, Any]], film: Mapping[str, Any] | None) -> Any:
        content = copy.deepcopy(self._content)
        for node in list(_bsdfs(content)):
            replacement = bsdfs.get(_material(self._properties(node)).key)
            if replacement is not None:
                _replace(node, replacement)
        if film is not None:
            sensor: Any = _first_sensor(content)
            old = _film(sensor)
            if isinstance(sensor, ET.Element):
                if old is not None:
                    sensor.remove(old)
                sensor.append(_element("film", film))
            else:
                name = next((k for k, v in sensor.items() if v is old), "film")
                sensor[name] = dict(film)
        return content

    def _resolve(self, folder: Path) -> None:
        """Make paths of files absolute: from the folder, those that the scene names, or Mitsuba's."""

        folders, known = [folder], backend.search_folders()

        def absolute(value: str) -> str:
            found = next((f / value for f in [*folders, *known] if scene_files.exists(f / value)), None)
            if found is None:
                return value
            _require_harmless(found, self.origin)
            return str(found.absolute())

        if isinstance(self._content, ET.Element):
            for node in self._content.iter("path"):
                node.set("value", absolute(node.get("value", "")))
                folders.append(Path(node.get("value", "")))
            for node in self._content.iter():
                if node.tag == "string" and node.get("name") in _FILES:
                    node.set("value", absolute(node.get("value", "")))
                elif node.get("filename"):
                    node.set("filename", absolute(node.get("filename", "")))
        else:
            for entry in _dictionaries(self._content):
                for name in _FILES:
                    if isinstance(entry.get(name), str):
                        entry[name] = absolute(entry[name])

    def _properties(self, node: Any) -> dict[str, str]:
        """Type and properties of a plugin, as text; nothing for those that are plugins themselves."""
        if not isinstance(node, ET.Element):
            return {k: "" if isinstance(v, dict) else str(v) for k, v in node.items()}
        own = {child.get("name", ""): child.get("value", "") for child in node}
        return own | {"type": node.get("type", "")}


def _require_harmless(path: Path, origin: str) -> None:
    """Raise UsageError for what Mitsuba would read without end, or make more of than fits in memory."""
    if path.is_dir():
        return
    if not path.is_file():
        raise UsageError(f"{origin}: {path} is not a regular file; name one")
    if (
        path.suffix.lower() in (".spd", ".txt", ".csv", ".xml")
        and path.stat().st_size > small_files.MOST_TEXT
    ):
        raise UsageError(
            f"{origin}: {path} has {path.stat().st_size} bytes, expected at most {small_files.MOST_TEXT}"
        )
    images.require_size(path)


def _require_known(material: SceneMaterial, origin: str) -> None:
    """Raise UsageError where a property would be ignored."""
    for name in material.properties:
        if name.startswith("latent_"):
            raise UsageError(
                f"{origin}: a manifold BSDF with textures of latents; expected one latent, as 'x,y'"
            )
        if name not in KINDS[material.kind]:
            raise UsageError(
                f"{origin}: a {material.kind} BSDF has a property '{name}', "
                f"expected {', '.join(KINDS[material.kind])} only; leave it out"
            )


def _material(properties: Mapping[str, str]) -> SceneMaterial:
    kind = properties["type"]
    # Its name in the scene is not what it is.
    own = {k: v for k, v in sorted(properties.items()) if k not in ("type", "id", "")}
    return SceneMaterial(f"{kind} {own}", kind, own)


def _without_paths(tree: ET.Element) -> ET.Element:
    """A scene without the folders in which it looks for files, which are absolute, and for plugins too."""
    for parent in list(tree.iter()):
        for child in parent.findall("path"):
            parent.remove(child)
    return tree


def _types(content: Any) -> Iterator[object]:
    if not isinstance(content, ET.Element):
        return types_of(content)
    return (node.get("type") for node in content.iter() if "type" in node.attrib)


def _dictionaries(content: Any) -> Iterator[dict[str, Any]]:
    if isinstance(content, dict):
        yield content
        for value in content.values():
            yield from _dictionaries(value)


def _bsdfs(content: Any) -> Iterator[Any]:
    if isinstance(content, ET.Element):
        yield from (node for node in content.iter("bsdf") if node.get("type") in KINDS)
    else:
        yield from (entry for entry in _dictionaries(content) if entry.get("type") in KINDS)


def _first_sensor(content: Any) -> Any:
    if isinstance(content, ET.Element):
        return next(content.iter("sensor"), None)
    cameras = ("perspective", "orthographic", "thinlens")
    return next((entry for entry in _dictionaries(content) if entry.get("type") in cameras), None)


def _film(sensor: Any) -> Any:
    if isinstance(sensor, ET.Element):
        return sensor.find("film")
    return next(
        (v for v in sensor.values() if isinstance(v, dict) and str(v.get("type")).endswith("film")), None
    )


def _replace(node: Any, replacement: Mapping[str, Any]) -> None:
    """Turn a BSDF into another in place; its name and identity stay."""
    if isinstance(node, ET.Element):
        kept = {k: v for k, v in node.attrib.items() if k in ("id", "name")}
        made = _element("bsdf", replacement)
        node.clear()
        node.attrib.update(kept | made.attrib)
        node.extend(made)
    else:
        kept = {k: v for k, v in node.items() if k == "id"}
        node.clear()
        node.update(copy.deepcopy(dict(replacement)) | kept)


def _element(tag: str, content: Mapping[str, Any], name: str | None = None) -> ET.Element:
    """A dictionary of a plugin as XML."""
    if content["type"] == "rgb":
        made = ET.Element("rgb", {"value": ", ".join(f"{v:.9g}" for v in content["value"])})
    else:
        made = ET.Element(tag, {"type": content["type"]})
        for key, value in content.items():
            if isinstance(value, Mapping):
                made.append(_element("rfilter" if key == "rfilter" else "spectrum", value, key))
            elif key != "type":
                kind = next((k for k, python in _NUMBERS.items() if type(value) is python), "string")
                made.append(ET.Element(kind, {"name": key, "value": str(value)}))
    if name is not None:
        made.set("name", name)
    return made


def _with_transforms(mi: Any, content: Any) -> Any:
    if not isinstance(content, dict):
        return content
    return {
        key: mi.ScalarTransform4f(value)
        if key == "to_world" and isinstance(value, list)
        else _with_transforms(mi, value)
        for key, value in content.items()
    }
