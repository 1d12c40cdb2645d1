"""How long the import of a library takes, as a multiple of `cp -r` of its files followed by `sync`.

    python benchmarks/bench_import.py [FOLDER] [--rounds 5] [--work DIR] [--json FILE]

Without a folder it makes 51 files of the size of the real ones (6.95 MB, random values). Both sides write to
the same disk, read warm files, and end with `sync`; they take turns, and the medians are compared. The import
is timed in a process of its own, once as the call of `import_files`, once with the start of Python and the
import of numpy and zarr. Every round keeps its 0.7 GB until the end.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from manifold.core.records import BsdfFile
from manifold.io_rgl import write_bsdf
from manifold.library.store import Library

FILES = 51
TARGET = 4.0
IMPORT = """
import sys, time
from manifold.library.importing import import_files
start = time.perf_counter()
import_files(sys.argv[1], [sys.argv[2]])
print(time.perf_counter() - start)
"""


def make_files(folder: Path) -> None:
    """Write 51 files with the fields and shapes of a real isotropic spectral file."""
    rng = np.random.default_rng(0)

    def values(*shape: int) -> np.ndarray:
        return rng.random(shape, dtype=np.float32) + np.float32(0.01)

    folder.mkdir()
    for number in range(FILES):
        file = BsdfFile(
            name=f"m{number:02d}",
            description="synthetic: random values of the size of a measured file",
            version=(3, 1),
            phi_i_rad=np.zeros(1, np.float32),
            theta_i_rad=np.linspace(0, np.pi / 2, 8, dtype=np.float32),
            wavelengths_nm=np.linspace(358.63, 1001.89, 195, dtype=np.float32),
            sigma=values(2, 128),
            ndf=values(2, 128),
            vndf=values(1, 8, 128, 128),
            luminance=values(1, 8, 32, 32),
            spectra=values(1, 8, 195, 32, 32),
            jacobian=True,
            valid=rng.integers(0, 256, 1024, dtype=np.uint8),
        )
        write_bsdf(folder / f"{file.name}_spec.bsdf", file)


def timed_s(arguments: list[str]) -> tuple[float, float, float]:
    """Seconds that a command takes, that the `sync` after it takes, and that it printed, if it did."""
    os.sync()
    time.sleep(0.5)  # The disk is idle.
    start = time.perf_counter()
    printed = subprocess.run(arguments, check=True, capture_output=True, text=True).stdout
    middle = time.perf_counter()
    os.sync()
    return middle - start, time.perf_counter() - middle, float(printed or "nan")


def drop_from_memory(folder: Path) -> None:
    """Free the page cache of what was written, so that every round finds the same memory to write to."""
    for path in folder.rglob("*"):
        if path.is_file():
            descriptor = os.open(path, os.O_RDONLY)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)


def stored_bytes(folder: Path) -> int:
    """Bytes that a folder takes on disk."""
    return sum(path.lstat().st_blocks * 512 for path in [folder, *folder.rglob("*")])


def measure(files: Path, work: Path, rounds: int) -> dict[str, object]:
    """Alternate copies and imports; seconds and their ratio."""
    seconds: dict[str, list[float]] = {"cp_sync": [], "import_sync": [], "import_sync_with_start": []}
    for number in range(rounds + 1):
        # A new folder each round and nothing deleted: for minutes, ext4 walks around each inode that was just
        # freed, and making a file takes 0.6 ms instead of 0.015.
        copy, library = work / f"copy{number}", work / f"library{number}.zarr"
        alone, sync, _ = timed_s(["cp", "-r", str(files), str(copy)])
        seconds["cp_sync"].append(alone + sync)
        drop_from_memory(copy)
        alone, sync, inside = timed_s([sys.executable, "-c", IMPORT, str(library), str(files)])
        seconds["import_sync"].append(inside + sync)
        seconds["import_sync_with_start"].append(alone + sync)
        drop_from_memory(library)
    medians = {
        key: statistics.median(values[1:]) for key, values in seconds.items()
    }  # The first round warms up.
    opened = Library.open(library)
    start = time.perf_counter()
    for name in opened.names:
        opened.read(name)
    read_s = time.perf_counter() - start
    return {
        "files": len(opened),
        "source_bytes": sum(path.stat().st_size for path in files.rglob("*.bsdf")),
        "library_bytes_on_disk": stored_bytes(library),
        "seconds": medians,
        "read_s_per_material": read_s / len(opened),
        "ratio": medians["import_sync"] / medians["cp_sync"],
        "ratio_with_start": medians["import_sync_with_start"] / medians["cp_sync"],
        "ratio_each_round": [
            i / c for i, c in zip(seconds["import_sync"][1:], seconds["cp_sync"][1:], strict=True)
        ],
        "target": TARGET,
    }


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, help="folder of .bsdf files (default: 51 made ones)")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--work", type=Path, help="folder on the disk to measure (default: a temporary one)")
    parser.add_argument("--json", type=Path, help="write the result here")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.work) as work:
        files = arguments.folder
        if files is None:
            files = Path(work) / "files"
            make_files(files)
        result = measure(files, Path(work), arguments.rounds)
    print(json.dumps(result, indent=2))
    print(
        f"import + sync takes {result['ratio']:.2f} times as long as cp -r + sync (target: {TARGET:g} at most), "
        f"{result['ratio_with_start']:.2f} times with the start of Python"
    )
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
