"""Run benchmarks and keep their figures in benchmarks/results/*.json, from which the documents are filled in.

    python benchmarks/run_all.py [NAMES...] [--data FOLDER] [--files FOLDER] [--neural FILE]
    python benchmarks/run_all.py --list

NAMES are results of `evidence.RESULTS`, by default all. FOLDER of --data holds what is there of

    rgl          the 20 measured RGB files: `manifold fetch --rgb -o FOLDER/rgl`
    neural.zip   published neural fits to them (Sztrajman et al. 2021)
    ma-t12       the six workbooks of docs/explanation/data.md
    spectral     car paints of Cornell University as pbrt-v2 ships them, and PTFE after Germer 2017

What needs data that are not given is left out. Then `python docs/figures.py` fills the documents in.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from evidence import FOLDER, REPOSITORY, RESULTS, data_hash, minutes, record, stamp, table
from neural_fits import read_neural_fits, write_fits

HERE = Path(__file__).resolve().parent
MEASURED = {"FILES": "rgl", "NEURAL": "neural.zip", "WORKBOOKS": "ma-t12", "SPECTRAL": "spectral"}
"""Names of the data in a command, and where --data has them."""
MADE_OF = {
    "LIBRARY": "FILES", "MODEL": "FILES", "NEURAL_LIBRARY": "NEURAL", "WORKBOOK_FOLDER": "WORKBOOKS",
    "SURFACES": "WORKBOOKS",
}  # fmt: skip
"""What is made of other data for the commands that name it."""
SURFACES = ("PEN_PW_EB_PB_2", "PAR_PW_CN_MC_2", "PAR_PW_GE_MC_2")
"""Workbooks whose surfaces a page shows: one with flakes, two without."""
CHART = REPOSITORY / "docs" / "images" / "chart-real.png"
"""The picture that the run of `chart` draws beside its figures."""


class Places:
    """The data that commands name; libraries, models and the corpus are made when a command first needs them."""

    def __init__(self, given: dict[str, Path], folder: Path) -> None:
        self._given, self._folder = given, folder
        self._manifold = [sys.executable, "-m", "manifold"]

    def missing(self, words: list[str]) -> list[str]:
        """Which data a command needs and nobody gave."""
        needed = {MADE_OF.get(word, word) for word in words}
        return [word for word in MEASURED if word in needed and word not in self._given]

    def words(self, word: str) -> list[str]:
        """The paths that a word of a command stands for, or the word."""
        if word == "WORKBOOKS":
            return [str(path) for path in sorted(self._given[word].glob("*.xlsx"))]
        if word == "WORKBOOK_FOLDER":
            return [str(self._given["WORKBOOKS"].resolve())]
        if word == "SURFACES":
            return [str(self._surface(name)) for name in SURFACES]
        if word == "CHART":
            return [str(CHART)]
        if word in self._given:
            return [str(self._given[word].resolve())]
        files = {
            "LIBRARY": "library.zarr", "MODEL": "model.h5", "CORPUS": "corpus", "CORPUS_LIBRARY": "corpus.zarr",
            "NEURAL_LIBRARY": "neural.zarr",
        }  # fmt: skip
        if word not in files:
            return [word]
        path = self._folder / files[word]
        if not path.exists() and word == "CORPUS":
            self._run("corpus", str(path))
        elif not path.exists() and word == "CORPUS_LIBRARY":
            self._run("corpus", "corpus-rgb", "--rgb")
            self._run("import", "corpus-rgb", "-L", str(path))
        elif not path.exists() and word == "NEURAL_LIBRARY":
            fits = self._folder / "neural"
            write_fits(fits, read_neural_fits(self._given["NEURAL"]))
            self._run("import", str(fits), "-L", str(path))
        elif not path.exists():
            self._run("import", str(self._given["FILES"].resolve()))
            self._run("embed")
        return [str(path)]

    def _surface(self, name: str) -> Path:
        """The surface of a workbook."""
        path = self._folder / f"{name}_surface"
        if not path.exists():
            self.words("LIBRARY")
            workbook = (self._given["WORKBOOKS"] / f"{name}.xlsx").resolve()
            self._run("surface", str(workbook), "-o", str(path))
        return path

    def hashes(self, words: list[str]) -> dict[str, str]:
        """Hashes of the measured data of a command."""
        named = {MADE_OF.get(word, word) for word in words} & set(self._given)
        return {word: data_hash([self._given[word]]) for word in sorted(named)}

    def _run(self, *words: str) -> None:
        subprocess.run([*self._manifold, *words], cwd=self._folder, check=True)


def measure(name: str, places: Places, folder: Path) -> str | None:
    """Run a benchmark and keep its result; return None, or why the result is not kept."""
    program, *words = RESULTS[name].command.split()
    is_command = program == "manifold"
    command = [sys.executable, "-m", "manifold"] if is_command else [sys.executable, str(HERE / program)]
    resolved = [path for word in words for path in places.words(word)]
    target = folder / f"{name}.json"
    code, before = RESULTS[name].code_hash, resource.getrusage(resource.RUSAGE_CHILDREN)
    status = subprocess.run([*command, *resolved, "--json", str(target)], check=False).returncode
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    # `manifold stability` leaves with 1 if a mode is wrong, which is a finding. Benchmarks do so if they fail midway.
    if status not in ((0, 1) if is_command else (0,)):
        return f"exit status {status}"
    if not target.exists():
        return "it wrote no result"
    if RESULTS[name].code_hash != code:
        return "its code changed during the run"
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    data, kept = places.hashes(words), FOLDER / target.name
    if kept.exists() and record(name)["data"] != data:
        print("   its data differ from those of the kept result", flush=True)
    stamp(name, target, data, seconds)
    shutil.move(target, kept)
    print(f"   {seconds / 60.0:.1f} processor minutes", flush=True)
    return None


def main() -> None:
    """Run them one after the other; leave with 1 if one of them failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAMES")
    parser.add_argument("--data", type=Path, help="folder with all of it")
    parser.add_argument("--files", type=Path, help="folder of measured .bsdf files")
    parser.add_argument("--neural", type=Path, help="published neural fits, a folder or a zip file")
    parser.add_argument("--list", action="store_true", help="print how the kept results were made, and stop")
    asked = parser.parse_args()
    if asked.list:
        print(table())
        return
    if unknown := set(asked.names) - set(RESULTS):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; expected some of {', '.join(RESULTS)}")
    given = {"FILES": asked.files, "NEURAL": asked.neural}
    given = {word: path for word, path in given.items() if path is not None}
    if asked.data is not None:
        there = {word: asked.data / name for word, name in MEASURED.items()}
        given = {word: path for word, path in there.items() if path.exists()} | given
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        places = Places(given, Path(folder))
        FOLDER.mkdir(exist_ok=True)
        for name in asked.names or RESULTS:
            program, *words = RESULTS[name].command.split()
            if missing := places.missing(words):
                print(f"== {name}: left out, needs {missing[0]}", flush=True)
                continue
            if program == "make":
                print(f"== {name}: left out, run `{RESULTS[name].command}`", flush=True)
                continue
            took = minutes(name)
            expected = "" if took is None else f", about {took:.1f} processor minutes"
            print(f"== {name}{expected}", flush=True)
            if reason := measure(name, places, Path(folder)):
                print(f"   not kept: {reason}", flush=True)
                failed.append(name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
