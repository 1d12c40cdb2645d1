"""Files of scenes as trees: XML with the files that it includes in place, or JSON; of bounded depth."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from manifold.errors import FileFormatError, UsageError

_MOST_LEVELS = 100  # elements within elements; scenes of people have ten
_MOST_INCLUDES = 15  # files within files, as in Mitsuba


def read_tree(scene: Path) -> ET.Element | dict[str, Any]:
    """The `<scene>` element of an XML file, or the dictionary of a JSON file.

    `<include>` is replaced by what it names, as Mitsuba does it: relative paths start from the folder of the scene,
    also those within included files, and `$name` is the first default of that name.

    Raises:
        UsageError: the file, or one that it includes, cannot be read.
        FileFormatError: it is neither XML nor JSON of a scene, nested without end, or includes itself.
    """
    text = _read(scene, "name a Mitsuba scene, .xml or .json")
    if scene.suffix.lower() == ".json":
        try:
            return require_scene(json.loads(text), str(scene))
        except RecursionError as error:
            raise _too_deep(str(scene)) from error
        except json.JSONDecodeError as error:
            raise _no_scene(scene, error) from error
    tree = _parse(text, scene)
    if tree.tag != "scene":
        raise FileFormatError(f"{scene}: found <{tree.tag}>, expected <scene>; name a Mitsuba scene")
    _Inclusion(scene).inline(tree)
    return tree


def require_scene(content: Any, origin: str) -> dict[str, Any]:
    """Plain values that are a dictionary of Mitsuba. Raises: FileFormatError unless they are one of a scene."""
    _require_shallow(content, origin)
    if not isinstance(content, dict) or content.get("type") != "scene":
        raise FileFormatError(
            f"{origin}: no dictionary of the type scene; expected what `mi.load_dict` takes"
        )
    return content


def substituted(text: str, defaults: dict[str, str]) -> str:
    """A text with every `$name` replaced by the default of that name."""
    for name in sorted(defaults, key=len, reverse=True):
        text = text.replace(f"${name}", defaults[name])
    return text


class _Inclusion:
    """Puts included files in their place."""

    def __init__(self, scene: Path) -> None:
        self._scene = scene
        self._folders = [scene.parent.absolute()]
        self._defaults: dict[str, str] = {}

    def inline(self, node: ET.Element, depth: int = 0) -> None:
        """Replace all includes below an element, in the order of the document."""
        found: list[ET.Element] = []
        for child in node:
            if child.tag == "include":
                found += self._included(substituted(child.get("filename", ""), self._defaults), depth + 1)
                continue
            if child.tag == "default":
                self._defaults.setdefault(child.get("name", ""), child.get("value", ""))
            elif child.tag == "path":
                self._folders.append(self._folders[0] / substituted(child.get("value", ""), self._defaults))
            self.inline(child, depth)
            found.append(child)
        node[:] = found

    def _included(self, name: str, depth: int) -> list[ET.Element]:
        if depth > _MOST_INCLUDES:
            raise FileFormatError(
                f"{self._scene}: more than {_MOST_INCLUDES} files include each other, {name} last; end the circle"
            )
        path = next((folder / name for folder in self._folders if (folder / name).exists()), Path(name))
        root = _parse(_read(path, f"{self._scene} includes it"), path)
        self.inline(root, depth)
        if root.tag == "scene":
            return list(root)
        root.attrib.pop("version", None)
        return [root]


def _read(path: Path, advice: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # also no text, and names with null bytes
        reason = getattr(error, "strerror", None) or "no text"
        raise UsageError(f"{path}: cannot be read ({reason}); {advice}") from error


def _parse(text: str, path: Path) -> ET.Element:
    try:
        tree = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise _no_scene(path, error) from error
    _require_shallow(tree, str(path))
    return tree


def _require_shallow(content: Any, origin: str) -> None:
    """Raise FileFormatError where recursion would not end well."""
    level = [content]
    for _ in range(_MOST_LEVELS):
        level = [child for node in level for child in _children(node)]
        if not level:
            return
    raise _too_deep(origin)


def _children(node: Any) -> Iterable[Any]:
    if isinstance(node, dict):
        return node.values()
    return node if isinstance(node, list | ET.Element) else ()


def _too_deep(origin: str) -> FileFormatError:
    return FileFormatError(
        f"{origin}: nested more than {_MOST_LEVELS} deep; expected a Mitsuba scene, XML or JSON"
    )


def _no_scene(path: Path, error: Exception) -> FileFormatError:
    return FileFormatError(f"{path}: {error}; expected a Mitsuba scene, XML or JSON")
