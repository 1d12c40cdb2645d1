"""Files of scenes as trees: XML with defaults and included files in place, or JSON; of bounded depth and size."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from manifold.errors import FileFormatError
from manifold.rendering.plugin_names import holds_none
from manifold.system import small_files

_MOST_LEVELS = 100  # elements within elements; scenes of people have ten
_MOST_INCLUDES = 15  # files within files, as in Mitsuba
_MOST_FILES = 1000
_MOST_CHARACTERS = 1_000_000  # that come from defaults
_MOST_BYTES = 64 << 20  # of all included files


def read_tree(scene: Path) -> ET.Element | dict[str, Any]:
    """The `<scene>` element of an XML file, or the dictionary of a JSON file.

    `<include>` is replaced by what it names, as Mitsuba does it: relative paths start from the folder of the scene,
    also those within included files, and `$name` is the first default of that name.

    Raises:
        UsageError: the file, or one that it includes, cannot be read.
        FileFormatError: it is neither XML nor JSON of a scene, nested without end, or includes itself.
    """
    if scene.suffix.lower() == ".json":
        return require_scene(small_files.read_json(scene, "a Mitsuba scene, .xml or .json"), str(scene))
    tree = _parse(small_files.read_text(scene, advice="name a Mitsuba scene, .xml or .json"), scene)
    if tree.tag != "scene":
        raise FileFormatError(f"{scene}: found <{tree.tag}>, expected <scene>; name a Mitsuba scene")
    _Expansion(scene).expand(tree)
    return tree


def require_scene(content: Any, origin: str) -> dict[str, Any]:
    """Plain values that are a dictionary of Mitsuba. Raises: FileFormatError unless they are one of a scene."""
    _require_shallow(content, origin)
    if not isinstance(content, dict) or content.get("type") != "scene":
        raise FileFormatError(
            f"{origin}: no dictionary of the type scene; expected what `mi.load_dict` takes"
        )
    if holds_none(content):
        raise FileFormatError(f"{origin}: null in the scene, expected a value; remove that entry")
    return content


class _Expansion:
    """Puts included files and defaults in their place, and counts what that makes."""

    def __init__(self, scene: Path) -> None:
        self._scene = scene
        self._folders = [scene.parent.absolute()]
        self._defaults: dict[str, str] = {}
        self._files = self._characters = self._bytes = 0

    def expand(self, node: ET.Element, depth: int = 0) -> None:
        """Replace all below an element, in the order of the document: Mitsuba takes the first default of a name."""
        for key, value in node.attrib.items():
            node.set(key, self._substituted(value))
        found: list[ET.Element] = []
        for child in node:
            if child.tag == "include":
                found += self._included(self._substituted(child.get("filename", "")), depth + 1)
            elif child.tag == "default":
                value = self._substituted(child.get("value", ""))
                self._defaults.setdefault(child.get("name", ""), value)
            else:
                self.expand(child, depth)
                if child.tag == "path":
                    self._folders.append(self._folders[0] / child.get("value", ""))
                found.append(child)
        node[:] = found

    def _substituted(self, text: str) -> str:
        """A text with every `$name` replaced by the default of that name."""
        if "$" not in text:
            return text

        def value(match: re.Match[str]) -> str:
            word = match[1]
            known = next((word[:n] for n in range(len(word), 0, -1) if word[:n] in self._defaults), None)
            found = f"${word}" if known is None else self._defaults[known] + word[len(known) :]
            self._characters += len(found)
            if self._characters > _MOST_CHARACTERS:
                raise FileFormatError(
                    f"{self._scene}: more than {_MOST_CHARACTERS} characters come from defaults; write them out"
                )
            return found

        return re.sub(r"\$([\w.-]{1,64})", value, text)

    def _included(self, name: str, depth: int) -> list[ET.Element]:
        self._files += 1
        if depth > _MOST_INCLUDES:
            raise FileFormatError(
                f"{self._scene}: more than {_MOST_INCLUDES} nested includes, {name} last; remove the cycle"
            )
        if self._files > _MOST_FILES:
            raise FileFormatError(
                f"{self._scene}: more than {_MOST_FILES} included files, {name} last; include fewer"
            )
        path = next((folder / name for folder in self._folders if exists(folder / name)), Path(name))
        text = small_files.read_text(path, advice=f"{self._scene} includes it")
        self._bytes += len(text)
        if self._bytes > _MOST_BYTES:
            raise FileFormatError(
                f"{self._scene}: included files of more than {_MOST_BYTES >> 20} MB; include less"
            )
        root = _parse(text, path)
        self.expand(root, depth)
        if root.tag == "scene":
            return list(root)
        root.attrib.pop("version", None)
        return [root]


def exists(path: Path) -> bool:
    """Whether there is something at a path, whatever text that is."""
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that is too long, or no name
        return False


def _parse(text: str, path: Path) -> ET.Element:
    try:
        tree = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise FileFormatError(f"{path}: {error}; expected a Mitsuba scene, XML or JSON") from error
    _require_shallow(tree, str(path))
    return tree


def _require_shallow(content: Any, origin: str) -> None:
    """Raise FileFormatError where recursion would not end well."""
    level = [content]
    for _ in range(_MOST_LEVELS):
        level = [child for node in level for child in _children(node)]
        if not level:
            return
    raise FileFormatError(
        f"{origin}: nested more than {_MOST_LEVELS} deep; expected a Mitsuba scene, XML or JSON"
    )


def _children(node: Any) -> Iterable[Any]:
    if isinstance(node, dict):
        return node.values()
    return node if isinstance(node, list | ET.Element) else ()
