"""Reads Mitsuba scenes, and replaces their measured materials and film.

A scene is an XML file, or a dictionary of plain values as `mi.load_dict` takes it (in files: JSON), where `to_world`
may be a matrix of four rows. Its materials are the BSDFs of the types `measured` and `manifold`, at any depth and
in included files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from manifold.core import disk
from manifold.core.errors import FileFormatError, MissingFileError, UsageError
from manifold.render import backend, measured_plugin
from manifold.render.backend import Backend
from manifold.render.plugin_names import holds_none, require_plugins, types_of

KINDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "measured": ("filename",),
        "manifold": ("model", "library", "latent", "like", "reflectance", "srgb", "tolerance"),
    }
)
"""Plugin names of measured materials, and their properties."""

_PATHS = ("filename", "model", "library", "reflectance")  # properties that name files
_LARGEST_FILM = 1 << 16
_FILM_SIZE = (768, 576)  # Mitsuba's own default


@dataclass(frozen=True)
class SceneMaterial:
    """A measured material of a scene.

    Attributes:
        key: identifies it in the scene; the same file or prediction used twice is one material.
        kind: `measured` or `manifold`.
        properties: properties of the plugin, with absolute paths.
    """

    key: str
    kind: str
    properties: Mapping[str, str]


class SceneDocument:
    """A parsed Mitsuba scene whose plugins are not loaded yet, with its measured materials, each listed once."""

    def __init__(self, state: Any, origin: str) -> None:
        """Take Mitsuba's `ParserState`; see `read`."""
        self._state, self.origin = state, origin
        self._keys: dict[int, str] = {}  # keys of the nodes that are measured materials
        found: dict[str, SceneMaterial] = {}
        for k, node in enumerate(state.nodes):
            if node.props.plugin_name() in KINDS:
                material = _material(node.props, origin)
                self._keys[k] = material.key
                found[material.key] = material
        self.materials = tuple(found.values())
        if not self.materials:
            raise UsageError(
                f"{origin}: no measured materials; expected BSDFs of the type measured or manifold in the scene"
            )
        if not any(node.type.name == "Sensor" for node in state.nodes):
            raise UsageError(f"{origin}: no sensor; expected a camera in the scene")

    @classmethod
    def read(cls, scene: Path | Mapping[str, Any]) -> SceneDocument:
        """Read a scene from an XML file, a JSON file, or a dictionary of plain values; file names are made absolute."""
        mi = backend.mitsuba("rgb", Backend("scalar"))
        config = mi.parser.ParserConfig(mi.variant())
        folder, origin = (scene.parent, str(scene)) if isinstance(scene, Path) else (Path(), "the scene")
        if isinstance(scene, Path) and not scene.is_file():
            raise MissingFileError(f"{scene}: no such file; name a Mitsuba scene, .xml or .json")
        if isinstance(scene, Path) and scene.suffix.lower() != ".json":
            state, further = _parse_xml(mi, config, scene)
            require_plugins((node.props.plugin_name() for node in state.nodes), origin)
            folders = [folder, *further]
        else:
            content = _with_transforms(mi, _dictionary(scene, origin))
            state = _accepted(lambda: mi.parser.parse_dict(config, content), origin)
            folders = [folder, Path()]
        for node in state.nodes:
            for name in set(_PATHS) & set(node.props.keys()):
                if isinstance(node.props[name], str):
                    node.props[name] = _absolute(node.props[name], folders)
        return cls(state, origin)

    @property
    def film_size(self) -> tuple[int, int]:
        """Width and height in pixels of the first sensor's film."""
        film: dict[str, Any] = next(
            (node.props for node in self._state.nodes if node.type.name == "Film"), {}
        )
        width, height = film.get("width", _FILM_SIZE[0]), film.get("height", _FILM_SIZE[1])
        if not all(isinstance(n, int) and 1 <= n <= _LARGEST_FILM for n in (width, height)):
            raise UsageError(
                f"{self.origin}: size of the film: found {width} x {height}, expected at least 1 x 1 pixels and at "
                f"most {_LARGEST_FILM} x {_LARGEST_FILM}"
            )
        return width, height

    def load(self, mi: Any, bsdfs: Mapping[str, Mapping[str, Any]], film: Mapping[str, Any]) -> Any:
        """Load the scene in the current variant, with BSDFs by key in place of its materials, and another film."""
        config = mi.parser.ParserConfig(mi.variant())

        def instantiate() -> Any:
            state = self._with(mi, bsdfs)
            index = _append(mi, state, film)
            for node in state.nodes:
                if node.type.name == "Sensor":
                    for name, child in _children(mi, node.props):
                        if state.nodes[child].type.name == "Film":
                            del node.props[name]
                    node.props["film"] = mi.Properties.ResolvedReference(index)
            mi.parser.transform_all(config, state)
            _load_measured(mi, state)
            return mi.parser.instantiate(config, state)

        return _accepted(instantiate, self.origin)

    def write(self, path: Path, bsdfs: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the scene as XML, with BSDFs by key in place of its materials."""
        mi = backend.mitsuba("rgb", Backend("scalar"))
        state = self._with(mi, bsdfs)
        for node in state.nodes:
            if node.props.plugin_name() == "manifold":  # a dictionary does not call it a BSDF
                node.type = mi.ObjectType.BSDF
        disk.write_text(path, _accepted(lambda: mi.parser.write_string(state), self.origin))

    def _with(self, mi: Any, bsdfs: Mapping[str, Mapping[str, Any]]) -> Any:
        """Return a copy of the state with other BSDFs under the same identifiers."""
        state = mi.parser.ParserState(self._state)
        for k, key in self._keys.items():
            if key in bsdfs:
                replacement = state.nodes[_append(mi, state, bsdfs[key])]
                replacement.props.set_id(state.nodes[k].props.id())
                state.nodes[k] = replacement
        return state


def _material(props: Any, origin: str) -> SceneMaterial:
    """Return a material from its plugin's properties, and refuse one that Mitsuba would ignore."""
    kind = props.plugin_name()
    own = {name: str(props[name]) for name in sorted(props.keys())}
    for name in own:
        if name.startswith("latent_"):
            raise UsageError(
                f"{origin}: a manifold BSDF with textures of latents; expected one latent, as 'x,y'"
            )
        if name not in KINDS[kind]:
            raise UsageError(
                f"{origin}: a {kind} BSDF has a property '{name}', expected {', '.join(KINDS[kind])} only; leave it out"
            )
    return SceneMaterial(f"{kind} {own}", kind, own)


def _append(mi: Any, state: Any, content: Mapping[str, Any]) -> int:
    """Add a plugin, with the plugins within it, to a state; return the index of its node."""
    added = mi.parser.parse_dict(mi.parser.ParserConfig(mi.variant()), dict(content))
    first = len(state.nodes)
    for node in added.nodes:
        node.props.set_id("")  # names of properties, which need not be unique in a scene
        for name, child in _children(mi, node.props):
            node.props[name] = mi.Properties.ResolvedReference(first + child)
        state.nodes.append(node)
    return first


def _load_measured(mi: Any, state: Any) -> None:
    """Load the `measured` plugins of a state, so that they fold no azimuths; see `measured_plugin`."""
    loaded: dict[int, Any] = {}
    for node in state.nodes:
        for name, child in _children(mi, node.props):
            props = state.nodes[child].props
            if props.plugin_name() == "measured":
                if child not in loaded:
                    content = {"type": "measured", "filename": props["filename"]}
                    loaded[child] = measured_plugin.load_bsdf(mi, content)
                node.props[name] = loaded[child]


def _children(mi: Any, props: Any) -> list[tuple[str, int]]:
    """Return names and indices of the nodes that a node's properties refer to."""
    values = [(name, props[name]) for name in props.keys()]  # noqa: SIM118 - a class of Mitsuba, not a mapping
    return [(n, v.index()) for n, v in values if isinstance(v, mi.Properties.ResolvedReference)]


def _accepted(work: Any, origin: str) -> Any:
    """Run a function of Mitsuba; an error that it raises becomes a UsageError."""
    try:
        return work()
    except Exception as error:  # Mitsuba raises bare RuntimeErrors, and plugins their own
        reason = " ".join(str(error).split())[-200:]
        raise UsageError(f"{origin}: Mitsuba refuses the scene ({reason}); correct the scene file") from error


def _parse_xml(mi: Any, config: Any, scene: Path) -> tuple[Any, list[Path]]:
    """Return Mitsuba's state of a file, without loading any plugin, and the folders in which it looks for others."""
    resolver = mi.file_resolver()
    before = list(resolver)
    try:
        state = _accepted(lambda: mi.parser.parse_file(config, str(scene)), str(scene))
        return state, [Path(str(folder)) for folder in resolver]
    finally:  # those of <path> would stay
        resolver.clear()
        for folder in before:
            resolver.append(folder)


def _dictionary(scene: Path | Mapping[str, Any], origin: str) -> dict[str, Any]:
    """Return the plain values of a scene whose plugins may be loaded."""
    content = disk.read_json(scene, "a Mitsuba scene, .xml or .json") if isinstance(scene, Path) else scene
    if not isinstance(content, Mapping) or content.get("type") != "scene":
        raise FileFormatError(
            f"{origin}: not a scene, expected a dictionary with the type 'scene', as for `mi.load_dict`"
        )
    if holds_none(content):  # ends Mitsuba's process
        raise FileFormatError(f"{origin}: null in the scene, expected a value; remove that entry")
    require_plugins(types_of(content), origin)
    return dict(content)


def _absolute(value: str, folders: Sequence[Path]) -> str:
    """Return the absolute path of a file that a scene names, or the value itself if there is no such file."""
    paths = (folder / value for folder in folders)
    return next((str(path.absolute()) for path in paths if path.exists()), value)


def _with_transforms(mi: Any, content: Any) -> Any:
    if not isinstance(content, dict):
        return content
    return {
        key: mi.ScalarTransform4f(value)
        if key == "to_world" and isinstance(value, list)
        else _with_transforms(mi, value)
        for key, value in content.items()
    }
