"""Make what the package brings along: the built-in library, its model, and calibrations of completions.

    python tools/built_in.py                  # writes manifold/data
    python tools/built_in.py --check          # exit status 1 if what is there is not what the present code makes
    python tools/built_in.py --check --some   # a material, the model and a calibration: seconds instead of a minute

The library is made of the 20 RGB files of `manifold/library/rgl_rgb.tsv`, in the folder that MANIFOLD_RGL_DIR names, by
default `../shared/rgl/real` beside the checkout. They are not in the repository: `manifold fetch --rgb` downloads them.
Without them, `--check` compares the checksums of the library, and makes the model and the calibrations again. `--some`
compares all checksums, and makes the first material, the model, and the calibration of the MA-T12 again; the tests find
the other calibrations by their keys.

Numbers are computed as on a Haswell processor, with one thread, so that processors of x86-64 agree on them. `--check`
compares numbers, not bytes: other versions of NumPy and SciPy round differently.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import platform
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from other_machines import environment

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = REPOSITORY / "manifold" / "data"
LIBRARY, MODEL, ABOUT = "built_in.zip", "built_in.h5", "built_in.json"
TOLERANCE = 0.2  # mean CIEDE2000 of the ball
MOST_BYTES = 1_000_000  # of all that is shipped
CORE = "Haswell"
AGREEMENT = 1e-3  # relative difference of numbers that is put down to rounding
SOURCE = {
    "source": "RGL material database, https://rgl.epfl.ch/materials: 20 RGB files, compacted within 0.2 CIEDE2000",
    "licence": "CC0 1.0 (public domain)",
    "citation": "Jonathan Dupuy and Wenzel Jakob. An Adaptive Parameterization for Efficient Material Acquisition and "
    "Rendering. ACM Transactions on Graphics 37 (6), 2018. https://doi.org/10.1145/3272127.3275059",
}


def rgl_files() -> list[Path]:
    """Return the files of the table, checked by their checksums; none if the folder is not there."""
    named = os.environ.get("MANIFOLD_RGL_DIR")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "rgl" / "real"
    if not folder.is_dir():
        return []
    files = [folder / f"{name}_rgb.bsdf" for name in checksums()]
    for path, expected in zip(files, checksums().values(), strict=True):
        if not path.is_file() or sha256(path) != expected:
            sys.exit(
                f"{path}: missing, or not the file of rgl_rgb.tsv; run `manifold fetch --rgb -o {folder}`"
            )
    return files


def checksums() -> dict[str, str]:
    """Return the checksums of the RGL files, by material."""
    with (REPOSITORY / "manifold" / "library" / "rgl_rgb.tsv").open(encoding="utf-8") as lines:
        return {row["material"]: row["sha256"] for row in csv.DictReader(lines, delimiter="\t")}


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def make_library(files: list[Path], folder: Path) -> None:
    """Import and compact the files."""
    from manifold.library.importing import import_files

    result = import_files(folder, files, tolerance=TOLERANCE)
    if result.failed:
        sys.exit("\n".join(result.failed.values()))


def make_model(folder: Path, model: Path) -> None:
    """Embed the library of a folder; the model names the built-in one."""
    from manifold.core import shipped
    from manifold.library.store import Library
    from manifold.model.manifold import Manifold

    fitted = Manifold.fit(Library(folder))
    fitted.library.path = shipped.BUILT_IN
    fitted.save(model)


def observations(folder: Path) -> Iterator[object]:
    """Yield readings of the instruments whose calibrations are shipped; only their directions count."""
    from manifold.analytic import virtual_instruments as instruments
    from manifold.analytic.diffuse import RoughDiffuse
    from manifold.core.records import Bands
    from manifold.estimate.attributes import readings_of_colour
    from manifold.formats import registry

    grey, rgb = np.array([50.0, 0.0, 0.0]), Bands(None)
    yield instruments.ma_t12_readings(RoughDiffuse(np.array(0.5), 0.0, rgb), "MA-T12")
    yield readings_of_colour(grey, {}, rgb)
    yield readings_of_colour(grey, {60.0: 50.0}, rgb)
    table = folder / "mini-diff.astm"
    instruments.write_mini_diff(
        table, RoughDiffuse(np.array(0.5), 0.0, instruments.MINI_DIFF_BANDS), "in plane"
    )
    lines = table.read_text().splitlines()
    heads = [line for line in lines if not line[0].isdigit() and not line.startswith("NUM_POINTS")]
    rows = [line for line in lines if line[0].isdigit() and abs(np.sin(float(line.split(",")[3]))) < 1e-3]
    table.write_text("\n".join([f"NUM_POINTS {len(rows)}", *heads, *rows]) + "\n")
    yield registry.read_readings(table)


def calibrate(folder: Path, temporary: Path, *, some: bool) -> None:
    """Put the calibrations, or the first of them, into the cache of a library, and nothing else."""
    from manifold.estimate import coat, evidence, expected
    from manifold.estimate.atoms import LibraryAtoms
    from manifold.library.store import Library

    library = Library(folder)
    shutil.rmtree(folder / "cache")
    atoms = LibraryAtoms.of_library(library)
    for readings in islice(observations(temporary), 1 if some else None):
        expected.calibrate(atoms, evidence.for_library(readings, library.bands), library)
    if not some:
        coat.expected_errors(atoms, (60.0,), library)


def write_zip(folder: Path, target: Path) -> None:
    """Write a library as a zip file that depends on nothing but its content."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                entry = zipfile.ZipInfo(path.relative_to(folder).as_posix(), (1980, 1, 1, 0, 0, 0))
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(entry, path.read_bytes())


def make(files: list[Path], temporary: Path, *, some: bool = False) -> Path:
    """Make all in a folder: from the files, or, without them, or for `some`, from the materials that are shipped."""
    folder, out = temporary / "library.zarr", temporary / "data"
    out.mkdir()
    if files and not some:
        make_library(files, folder)
    else:
        with zipfile.ZipFile(DATA / LIBRARY) as archive:
            archive.extractall(folder)
    make_model(folder, out / MODEL)
    calibrate(folder, temporary, some=some)
    write_zip(folder, out / LIBRARY)
    sums = {name: sha256(out / name) for name in (LIBRARY, MODEL)}
    about = SOURCE | {"sha256": sums, "materials": checksums()}
    (out / ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    size = sum(path.stat().st_size for path in out.iterdir())
    if size > MOST_BYTES:
        sys.exit(f"{size} bytes, expected at most {MOST_BYTES}")
    return out


def problems(made: Path, imported_again: Path, *, some: bool) -> list[str]:
    """Return the differences between the shipped files and newly made ones, and wrong checksums.

    Materials are compared with those of the library that was imported again.
    """
    from manifold.library import store
    from manifold.library.store import Library
    from manifold.model.model_file import read_model

    store.user_cache_path = lambda name: made / "user" / name  # calibrations of the user's cache do not count
    about = json.loads((DATA / ABOUT).read_text(encoding="utf-8"))
    found = [
        f"{name}: its checksum is not that of {ABOUT}"
        for name, expected in about["sha256"].items()
        if sha256(DATA / name) != expected
    ]
    shipped, again = Library(DATA / LIBRARY), Library(made / LIBRARY)
    other = Library(imported_again)
    imported = {name: shipped.attributes(name).sha256 for name in shipped.names}
    if not imported == about["materials"] == checksums():
        found.append(f"{LIBRARY}: its materials are not those of rgl_rgb.tsv")
    for name in other.names if some else shipped.names:
        pair = [np.cbrt(library.read(name).spectra.astype(float)) for library in (shipped, other)]
        found += differ(f"{LIBRARY}: {name}", *pair)
    held = [{info.filename for info in zipfile.ZipFile(at / LIBRARY).infolist()} for at in (DATA, made)]
    keys = [
        {name.split("/")[1] for name in names if name.startswith("cache/") and name.count("/") > 1}
        for names in held
    ]
    if not (keys[1] and keys[1] <= keys[0] if some else keys[0] == keys[1]):
        found.append(f"{LIBRARY}: calibrations of other keys")
    for key in sorted(keys[0] & keys[1]):
        pair = [library.cache_get(key) for library in (shipped, again)]
        for name in pair[0] or {}:
            found += differ(f"{LIBRARY}: calibration {key[:8]}, {name}", *(arrays[name] for arrays in pair))
    arrays = [read_model(at / MODEL).arrays for at in (DATA, made)]
    for name in arrays[0] | arrays[1]:
        found += differ(f"{MODEL}: {name}", *(each.get(name, np.empty(0)) for each in arrays))
    return found


def differ(what: str, one: np.ndarray, other: np.ndarray) -> list[str]:
    if one.shape != other.shape:
        return [f"{what} has shape {one.shape}, made again {other.shape}"]
    difference = float(np.linalg.norm(one - other) / (np.linalg.norm(one) or 1.0))
    return [] if difference <= AGREEMENT else [f"{what} differs by {difference:.2g}"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    parser.add_argument("--some", action="store_true", help="compare a part, with --check")
    asked = parser.parse_args()
    if asked.some and not asked.check:
        parser.error("--some goes with --check")
    wanted = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MANIFOLD_NUM_THREADS"), "1")
    wanted |= environment(CORE) if platform.machine() in ("x86_64", "AMD64") else {}
    if not wanted.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | wanted)
    files = rgl_files()
    if not files and not asked.check:
        sys.exit("the RGL files are not here: name their folder by MANIFOLD_RGL_DIR")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        made = make(files, folder, some=asked.some)
        if not asked.check:
            shutil.copytree(made, DATA, dirs_exist_ok=True)
            print(
                *(
                    f"{path.stat().st_size:8} {path.relative_to(REPOSITORY)}"
                    for path in sorted(DATA.iterdir())
                ),
                sep="\n",
            )
            return
        if not files:
            print(
                "built-in library: the RGL files are not here (MANIFOLD_RGL_DIR): only its checksums were compared"
            )
        imported = made / LIBRARY
        if asked.some and files:
            imported = folder / "one.zarr"
            make_library(files[:1], imported)
        found = problems(made, imported, some=asked.some)
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
