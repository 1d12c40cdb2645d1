"""Weights of neural fits of BRDFs: Keras HDF5 files of small dense networks, in folders or zip files.

The public repository of Sztrajman et al. (asztr/Neural-BRDF) holds one file per material, in zip files in `data/`.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath

import h5py
import numpy as np

from manifold import disk
from manifold.errors import FileFormatError, MissingFileError
from manifold.records import Array

_INPUTS, _OUTPUTS = 6, 3
_MOST_BYTES = 16 << 20  # of one network; the published ones have some tens of kilobytes
_REMEDY = "give files, folders or zip files of the public repository asztr/Neural-BRDF"


@dataclass(frozen=True, eq=False)
class NeuralWeights:
    """The network of one material.

    Attributes:
        name: of the material; where several have the same name, that of their archive is added.
        is_rgl: whether it was fitted to a file of the RGL database, as names that end in `_rgb` say.
        layers: kernel (n, m) and bias (m,) of every dense layer, first to last; 6 inputs, 3 outputs.
    """

    name: str
    is_rgl: bool
    layers: tuple[tuple[Array, Array], ...]


def read_neural_weights(path: Path | str) -> list[NeuralWeights]:
    """All networks in an `.h5` file, a zip file, or a folder of both, subfolders included, by name.

    Raises:
        UsageError: there is no such file or folder.
        FileFormatError: nothing of the kind is in it, or a file is damaged or holds another network.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"{path}: no such file or folder; {_REMEDY}")
    found = [(where, stem, _read_layers(data, f"{where}: {stem}.h5")) for where, stem, data in _files(path)]
    if not found:
        raise FileFormatError(f"{path}: no .h5 file in it, expected weights of neural fits; {_REMEDY}")
    names = Counter(stem.removesuffix("_rgb") for _, stem, _ in found)
    networks = []
    for where, stem, layers in found:
        name = stem.removesuffix("_rgb")
        if names[name] > 1:
            name = f"{name}_{where.stem.removesuffix('_nbrdf')}"
        networks.append(NeuralWeights(name, stem.endswith("_rgb"), layers))
    return sorted(networks, key=lambda network: network.name)


def _files(path: Path) -> Iterator[tuple[Path, str, bytes]]:
    """Folder or zip file, stem, and content of every `.h5` file."""
    if path.is_dir():
        for inner in sorted(path.rglob("*")):
            if inner.suffix in (".h5", ".zip") and inner.is_file():
                yield from _files(inner)
    elif path.suffix == ".h5":
        yield path.parent, path.stem, disk.read_bytes(path, advice=_REMEDY, most=_MOST_BYTES)
    else:
        try:
            with zipfile.ZipFile(path) as archive:
                for member in archive.namelist():
                    inside = PurePosixPath(member)
                    if inside.suffix == ".h5" and "__MACOSX" not in inside.parts:
                        if archive.getinfo(member).file_size > _MOST_BYTES:
                            raise zipfile.BadZipFile(f"{member} is larger than {_MOST_BYTES} bytes")
                        yield path, inside.stem, archive.read(member)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
            raise FileFormatError(
                f"{path}: not a readable zip file ({error}), expected weights of neural fits; {_REMEDY}"
            ) from error


def _read_layers(data: bytes, where: str) -> tuple[tuple[Array, Array], ...]:
    """Kernels and biases of the dense layers, in the order of their numbers."""
    try:
        with h5py.File(io.BytesIO(data)) as file:
            arrays: dict[str, Array] = {}
            file.visititems(lambda name, item: _keep(arrays, name, item, len(data)))
    except (OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError) as error:
        raise FileFormatError(
            f"{where}: not a readable HDF5 file ({str(error).partition(chr(10))[0]}); download it again"
        ) from error
    kernels = sorted((name for name in arrays if re.search(r"kernel(:0)?$", name)), key=_numbers)
    layers = tuple((arrays[k], arrays.get(k.replace("kernel", "bias"), np.zeros(0))) for k in kernels)
    sizes = [_INPUTS, *(kernel.shape[-1] for kernel, _ in layers)]
    expected = list(pairwise(sizes))
    if (
        not layers
        or sizes[-1] != _OUTPUTS
        or [kernel.shape for kernel, _ in layers] != expected
        or [bias.shape for _, bias in layers] != [(m,) for m in sizes[1:]]
    ):
        shapes = ", ".join(f"{'x'.join(map(str, k.shape))} + {b.size}" for k, b in layers) or "none"
        raise FileFormatError(
            f"{where}: found dense layers {shapes}, expected a chain from {_INPUTS} inputs to {_OUTPUTS} outputs "
            f"such as 6x21 + 21, 21x21 + 21, 21x3 + 3; {_REMEDY}"
        )
    if not all(np.all(np.isfinite(a)) for layer in layers for a in layer):
        raise FileFormatError(f"{where}: weights that are not finite, expected numbers; download it again")
    return layers


def _keep(arrays: dict[str, Array], name: str, item: object, most: int) -> None:
    """Remember a dataset of numbers, unless it lies in other files or announces more than its own file holds."""
    if isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
        if item.external is not None or item.is_virtual:
            raise ValueError(f"dataset '{name}' lies in other files")
        if item.nbytes > most:
            raise ValueError(f"dataset '{name}' declares {item.nbytes} bytes, more than the file has")
        arrays[name] = np.asarray(item[...], dtype=np.float64)


def _numbers(name: str) -> list[int]:
    """The numbers in a name: `dense_10` comes after `dense_9`."""
    return [int(number) for number in re.findall(r"\d+", name)]
