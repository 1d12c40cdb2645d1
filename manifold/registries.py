"""Registries of everything that a user chooses by name, such as formats, export targets and mappings.

A registry maps names to objects. It stores import paths and imports an object at its first use, so that help texts
can list names quickly. Other packages add entries through entry points; see `Registry`.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import ItemsView, Iterable, Iterator, Mapping, MutableMapping, ValuesView
from importlib import import_module
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from manifold.core.errors import EXTENSIONS, UnknownNameError
from manifold.core.names import names_like, printable

T = TypeVar("T")
_ALL_NAMED = 16  # names up to which a message lists all


class EntryPointWarning(UserWarning):
    """Warns that an entry of another package cannot be used and is left out."""


class _Place(NamedTuple):
    """The place of an entry that is not imported yet: a module, or `module:attribute`."""

    where: str

    def load(self) -> Any:
        module, _, attribute = self.where.partition(":")
        loaded = import_module(module)
        return getattr(loaded, attribute) if attribute else loaded


class Registry(MutableMapping[str, T]):
    """A dictionary from names to objects, in the order of the help texts; an unknown name raises UsageError.

    Entries of other packages come last. An entry that cannot be loaded is left out, with a warning that names its
    package.

    Args:
        what: word for one entry in messages, such as `format`.
        entries: objects by name.
        places: import paths by name, `module` or `module:attribute`.
        group: group of entry points through which other packages add entries; empty if they cannot.
        attributes: names of attributes that an entry of another package must have.
    """

    def __init__(
        self, what: str, entries: Iterable[tuple[str, T]] = (), *, places: Mapping[str, str] = MappingProxyType({}),
        group: str = "", attributes: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        self.what, self._group, self._attributes = what, group, attributes
        self._entries: dict[str, Any] = dict(entries)
        self._entries |= {name: _Place(where) for name, where in places.items()}
        self._packages: dict[str, str] | None = None if group else {}

    @property
    def packages(self) -> dict[str, str]:
        """Return the package of every entry that another package adds, by the entry's name; the result is cached."""
        if self._packages is None:
            packages = {}
            for name, where, package in _entry_points(self._group):
                if name in self._entries:
                    self._warn(name, package, "another entry has this name")
                else:
                    self._entries[name], packages[name] = _Place(where), package
                    EXTENSIONS[where.partition(":")[0].partition(".")[0]] = package
            self._packages = packages
        return self._packages

    def leave_out(self, name: str, error: BaseException) -> None:
        """Remove an entry of another package, and warn with the error that its import raised."""
        del self._entries[name]
        self._warn(name, self.packages.pop(name), f"{type(error).__name__}: {error}")

    def __getitem__(self, name: str) -> T:
        if name in self and isinstance(self._entries[name], _Place):
            self._load(name)
        if name not in self:
            known = f"expected one of {', '.join(self)}"
            if len(self) > _ALL_NAMED:
                known = names_like(self, name, f"the {self.what}s are")
            raise UnknownNameError(f"no {self.what} is called '{name}'; {known}")
        return self._entries[name]

    def __setitem__(self, name: str, entry: T) -> None:
        self._whole[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._whole[name]

    def __contains__(self, name: object) -> bool:
        return name in self._whole

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._whole))

    def __len__(self) -> int:
        return len(self._whole)

    def __str__(self) -> str:
        *names, last = self
        return f"{', '.join(names)} or {last}" if names else last

    def values(self) -> ValuesView[T]:
        """Return all entries, after leaving out those that cannot be loaded."""
        self._load_added()
        return super().values()

    def items(self) -> ItemsView[str, T]:
        """Return all names and entries, after leaving out those that cannot be loaded."""
        self._load_added()
        return super().items()

    @property
    def _whole(self) -> dict[str, Any]:
        """Return all entries, those of other packages among them."""
        _ = self.packages
        return self._entries

    def _load_added(self) -> None:
        for name in list(self.packages):
            if isinstance(self._entries[name], _Place):
                self._load(name)

    def _load(self, name: str) -> None:
        """Load an entry; leave it out if it is another package's, and cannot be loaded."""
        place = self._entries[name]
        if name not in self.packages:
            self._entries[name] = place.load()
            return
        try:
            entry = place.load()
            if missing := [name for name in self._attributes if not hasattr(entry, name)]:
                raise AttributeError(f"{place.where} has no {', '.join(missing)}")
        except (Exception, SystemExit) as error:  # whatever another package does when it is imported
            self.leave_out(name, error)
        else:
            self._entries[name] = entry

    def _warn(self, name: str, package: str, reason: str) -> None:
        text = f"the {self.what} '{name}' of the package {package} is left out ({reason})"
        warnings.warn(printable(" ".join(text.split())), EntryPointWarning, stacklevel=2)


def _entry_points(group: str) -> list[tuple[str, str, str]]:
    """Return the name, the place and the package of every entry point in a group, sorted by name."""
    if not any(map(_announces_entries, sys.path)):
        return []
    from importlib.metadata import entry_points  # takes a third of a help's time

    points = entry_points(group=group)
    return sorted(
        (point.name, point.value.partition("[")[0].strip(), point.dist.name if point.dist else "unknown")
        for point in points
    )


def _announces_entries(folder: str) -> bool:
    """Return whether a package that is installed in a folder has entry points for this one."""
    try:
        names = os.listdir(folder or ".")
    except OSError:
        return False
    for name in names:
        if name.endswith(".dist-info"):
            try:
                with open(os.path.join(folder, name, "entry_points.txt"), "rb") as stream:
                    if b"[brdf_manifold." in stream.read():
                        return True
            except OSError:
                continue
    return False


_FORMATS, _EXPORTS, _CONVERT = (
    "manifold.formats.",
    "manifold.fit.exports.",
    "manifold.convert.targets:",
)

FORMATS: Registry[Any] = Registry(
    "format",
    places={
        "spectrophotometer workbook (.xlsx)": _FORMATS + "ma_t12",
        "MBSDF (.mbsdf)": _FORMATS + "mbsdf",
        "MERL": _FORMATS + "merl",
        "RT-300S workbook (.xls)": _FORMATS + "rt300s",
        "Ansys Speos text": _FORMATS + "speos",
        "FRED table": _FORMATS + "fred",
        "OpenMATERIAL 3D (.xompt)": _FORMATS + "openmaterial",
        "BiRD (.brdf, JSON)": _FORMATS + "bird",
        "CxF3": _FORMATS + "cxf",
        "pab-opto text": _FORMATS + "pab_opto",
        "LightTools BSDF text": _FORMATS + "lighttools",
        "Zemax BSDF text": _FORMATS + "zemax",
        "ASTM table": _FORMATS + "astm",
        "UTIA": _FORMATS + "utia",
        "CSV table": _FORMATS + "csv_table",
    },
    group="brdf_manifold.formats",
    attributes=("sniff", "read"),
)
"""Formats that can be read, in the order in which they are tried: first formats that a magic number identifies.

An entry is a module; see `manifold.formats.registry`.
"""

FIT_SUFFIX = ".fit.json"
"""How names of files of fits end."""

EXPORT_SUFFIXES = {
    "gltf": ".glb",
    "openpbr": ".mtlx",
    "standard-surface": ".mtlx",
    "usd": ".usda",
    "usd-materialx": ".usda",
    "blender": ".py",
    "blender-json": ".json",
    "unreal": ".json",
    "unity": ".json",
}
TARGETS: Registry[Any] = Registry(
    "target",
    places={
        "gltf": _EXPORTS + "glb:GLTF",
        "openpbr": _EXPORTS + "materialx:OPENPBR",
        "standard-surface": _EXPORTS + "materialx:STANDARD_SURFACE",
        "usd": _EXPORTS + "usd:USD",
        "usd-materialx": _EXPORTS + "usd:USD_MATERIALX",
        "blender": _EXPORTS + "blender:BLENDER",
        "blender-json": _EXPORTS + "blender:BLENDER_JSON",
        "unreal": _EXPORTS + "unreal:UNREAL",
        "unity": _EXPORTS + "unity:UNITY",
    },
    group="brdf_manifold.targets",
    attributes=(
        "name", "suffix", "title", "entries", "parameters", "brdf", "content", "base_colour", "coat", "sheen", "film",
        "curve", "hued", "textures", "beside", "implementations", "colour_space", "caveat", "brdfs", "defaults",
    ),
)  # fmt: skip
"""Targets of `manifold export`, each a `manifold.fit.exports.targets.Target`."""

CONVERTED_SUFFIXES = {
    "rgl": (".bsdf",),
    "merl": (".binary",),
    "utia": (".bin",),
    "mbsdf": (".mbsdf",),
    "lighttools": (),
    "zemax": (),
    "fred": (),
    "speos": (".brdf",),
    "speos-anisotropic": (".anisotropicbsdf",),
    "openmaterial": (".xompt",),
    "bird": (".json",),
    "astm": (".astm",),
    "csv": (".csv",),
}
CONVERTED: Registry[Any] = Registry(
    "format", places={name: _CONVERT + name.upper().replace("-", "_") for name in CONVERTED_SUFFIXES}
)
"""Formats that `manifold convert` writes, each a `manifold.convert.targets.WrittenFormat`."""

OPTIMIZERS: Registry[Any] = Registry(
    "optimizer",
    places={"dls": "manifold.gplvm:minimise_by_dls", "l-bfgs": "manifold.gplvm:minimise_by_lbfgs"},
    group="brdf_manifold.methods",
    attributes=("__call__",),
)
"""Optimisers of the latents for `manifold embed`, each a function of a `gplvm.Run` and the starting latents."""

MAPPINGS: Registry[Any] = Registry(
    "mapping",
    places={
        "identity": "manifold.core.mapping:IDENTITY",
        "cube-root": "manifold.core.mapping:CUBE_ROOT",
        "log": "manifold.core.mapping:LOG",
        "log-relative": "manifold.core.mapping:LOG_RELATIVE",
    },
    group="brdf_manifold.mappings",
    attributes=("name", "forward", "inverse", "slope"),
)
"""Mappings of BRDF values with their default parameters, each a `manifold.core.mapping.ValueMapping`."""

NAMED_GRIDS: Registry[Any] = Registry(
    "grid", places={"default": "manifold.core.pairs:DEFAULT", "hikichi": "manifold.core.pairs:HIKICHI"}
)
"""Grids of direction pairs."""

KERNELS: Registry[Any] = Registry(
    "kernel",
    places={
        "se": "manifold.gp.kernels:SquaredExponential",
        "matern32": "manifold.gp.kernels:Matern32",
        "matern52": "manifold.gp.kernels:Matern52",
    },
    group="brdf_manifold.kernels",
    # The last two are inherited from `Kernel`.
    attributes=("family", "steepest", "radial", "training", "gradient"),
)
"""Classes of covariance functions, each a `manifold.gp.kernels.Kernel`."""

FITTERS: Registry[type] = Registry(
    "method",
    places={
        "gauss-newton": "manifold.fit.gauss_newton:GaussNewton",
        "adam": "manifold.fit.adam_and_swarm:AdamOptions",
        "swarm": "manifold.fit.adam_and_swarm:SwarmOptions",
    },
)
"""Optimisers of `manifold fit`, each a class that holds its hyperparameters."""

INSTRUMENTS: Registry[Any] = Registry(
    "instrument",
    places={
        "ma-t12": "manifold.analytic.virtual_instruments:MA_T12",
        "mini-diff": "manifold.analytic.virtual_instruments:MINI_DIFF",
    },
)
"""Instruments that `manifold corpus` simulates."""

EXAMPLES: Registry[Any] = Registry(
    "example",
    places={
        name: f"manifold.study.budget.example_scenes:{name.upper()}" for name in ("felt", "paint", "chrome")
    },
)
"""Example scenes of `manifold budget`."""


def _in_words(suffixes: Mapping[str, str | tuple[str, ...]]) -> str:
    """Return every suffix with the names that have it: `.glb (gltf), .mtlx (openpbr, standard-surface)`."""
    names: dict[str, list[str]] = {}
    for name, own in suffixes.items():
        for suffix in (own,) if isinstance(own, str) else own:
            names.setdefault(suffix, []).append(name)
    return ", ".join(f"{suffix} ({', '.join(of)})" for suffix, of in names.items())


EXPORTS_IN_WORDS, CONVERTED_IN_WORDS = _in_words(EXPORT_SUFFIXES), _in_words(CONVERTED_SUFFIXES)
"""Texts that list file suffixes with their export targets, and with their formats of `manifold convert`."""
