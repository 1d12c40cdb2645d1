"""The output folder of a budget: inputs and files of other origin are never replaced."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

from manifold.errors import UsageError
from manifold.io_rgl import material_name
from manifold.system import atomic


def require_makeable(folder: Path) -> None:
    """Raise UsageError where a folder neither is there nor can be made; nothing is made."""
    try:
        nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if _is_there(path))
    except OSError as error:  # a name that is too long, a folder that may not be searched
        raise _cannot_make(folder, os.strerror(error.errno or 0)) from error
    if not nearest.is_dir():
        raise _cannot_make(folder, f"{nearest} is no folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise _cannot_make(folder, f"{nearest} is not writable")


def require_apart(folder: Path, read: Iterable[str]) -> None:
    """Raise UsageError where a file that is read lies in the folder, by its name or by what its name links to."""
    folder = folder.resolve()
    for name in read:
        path = Path(name)
        if path.is_file() and folder in (path.resolve().parent, path.parent.resolve()):
            raise UsageError(f"{name}: could be overwritten; name another --output than the scene's folder")


def asset_names(files: Mapping[str, Path], is_rgb: bool) -> dict[str, str]:
    """Unique file name of each material in the folder, by key."""
    kind = "rgb" if is_rgb else "spec"
    names: dict[str, str] = {}
    for key, path in files.items():
        base, k = material_name(path), 2
        while f"{base}_{kind}.bsdf" in names.values():
            base, k = f"{material_name(path)}_{k}", k + 1
        names[key] = f"{base}_{kind}.bsdf"
    return names


class OutputFolder:
    """Where the files of one scene go.

    A list beside the scene, `NAME.budget.json`, says which files are the budget's own: these a later one replaces.
    """

    def __init__(self, path: Path, scene: str, assets: Iterable[str]) -> None:
        """Take the folder, and the names of what may be written there.

        Raises:
            UsageError: one of them is there and no earlier budget of the same scene wrote it.
        """
        self.path, self.scene = path, path / scene
        self._list = path / f"{scene}.budget.json"
        self._own = _listed(self._list)
        for name in (scene, self._list.name, *assets):
            if os.path.lexists(path / name) and name not in self._own:
                raise UsageError(
                    f"{path / name}: exists, and was not written by an earlier budget of this scene; "
                    "name another --output, or move it away"
                )

    def prepare(self, assets: Iterable[str]) -> None:
        """Make the folder and list what will be written. Raises: UsageError."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _cannot_make(self.path, os.strerror(error.errno or 0)) from error
        kept = {name for name in self._own if os.path.lexists(self.path / name)}
        files = sorted({*kept, self.scene.name, self._list.name, *assets})
        atomic.write_text(self._list, json.dumps({"files": files}, indent=1) + "\n")

    def copy(self, source: Path, name: str) -> Path:
        """Copy a file into the folder; its path there. Raises: as `atomic.replacing`."""
        target = self.path / name
        if target.is_symlink():  # which would be followed
            target.unlink()
        with atomic.replacing(target) as partial:
            shutil.copyfile(source, partial)
        return target


def _listed(path: Path) -> set[str]:
    """The names in a list that `prepare` wrote, none where there is no such list."""
    try:
        files = json.loads(path.read_text(encoding="utf-8"))["files"]
        return {name for name in files if isinstance(name, str)} if path.name in files else set()
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()


def _is_there(path: Path) -> bool:
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _cannot_make(folder: Path, reason: str) -> UsageError:
    return UsageError(f"{folder}: cannot make this folder ({reason}); name another one")
