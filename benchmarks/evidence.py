"""The results behind the figures of the documents: their commands, the code they depend on, and their dates.

`RESULTS` is the list; `run_all.py` runs it. Each `results/NAME.json` has an entry `_made`: command, version, commit,
hash of the code, hash of the data, date, processor and processor seconds. The code is the benchmark, every module that
it imports or that a registry names, directly or through others, the files of the package beside these modules, the
built-in library, `cpp/` and `setup.py`. Docstrings, comments, layout, the wording of messages and the places of
modules do not change the hash. Where it is None, the result is older than this record.
"""

from __future__ import annotations

import ast
import hashlib
import json
import platform
import re
import subprocess
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from manifold import __version__

REPOSITORY = Path(__file__).resolve().parents[1]
FOLDER = REPOSITORY / "benchmarks" / "results"
MADE = "_made"


@dataclass(frozen=True)
class Result:
    """A result: the command that writes it; for commands of `manifold`, the modules that do their work.

    Words in capitals in the command stand for data, see `run_all.py`.
    """

    command: str
    modules: tuple[str, ...] = ()

    @property
    def sources(self) -> list[Path]:
        """Return the files of the code, without those of `cpp/`."""
        program = REPOSITORY / "benchmarks" / self.command.split()[0]
        starts = [program] if program.is_file() else []
        for module in self.modules:
            path = REPOSITORY / module
            starts += sorted(path.rglob("*.py")) if path.is_dir() else [path]
        return closure(starts)

    @property
    def files_beside(self) -> list[Path]:
        """Return the files without code in the folders of the sources that belong to the package, or to its tools."""
        package = REPOSITORY / "manifold"
        folders = {path.parent for path in self.sources} - {REPOSITORY / "benchmarks", REPOSITORY / "tools"}
        folders |= {package / "colour" / "ior", package / "data"}
        return sorted(p for folder in folders for p in folder.glob("*.*") if p.suffix not in WITHOUT_FIGURES)

    @property
    def code_hash(self) -> str:
        """Return the SHA-256 of what `bare` keeps of the sources and of `cpp/`, shortened."""
        texts = [_bare_file(path, path.stat().st_mtime_ns) for path in self.sources]
        texts += [path.read_text(encoding="utf-8") for path in sorted((REPOSITORY / "cpp").glob("*.[ch]pp"))]
        texts += [_bare_file(path, path.stat().st_mtime_ns) for path in REPOSITORY.glob("setup.py")]
        texts += [
            f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in self.files_beside
        ]
        return hashlib.sha256("".join(sorted(texts)).encode()).hexdigest()[:16]


WITHOUT_FIGURES = (".py", ".pyi", ".pyc", ".so", ".pyd", ".css", ".typed")
"""Suffixes of files whose content decides no figure, or that are hashed as code."""


@cache
def _bare_file(path: Path, changed_ns: int) -> str:
    """Return `bare` of a file as of its last change."""
    return bare(path.read_text(encoding="utf-8"))


def closure(starts: Iterable[Path]) -> list[Path]:
    """Return files, the modules that they import anywhere, and what these import, sorted."""
    found: set[Path] = set()
    waiting = list(starts)
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imported(path)
    return sorted(found)


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """Return the files of this repository that a file imports."""
    files: list[Path] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            own = ".".join(path.relative_to(REPOSITORY).parts[: -node.level]) if node.level else ""
            module = ".".join(filter(None, (own, node.module)))
            names = [module, *(f"{module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _PLACE.fullmatch(node.value):
            names = [node.value.partition(":")[0]]
        else:
            continue
        files += [file for name in names if (file := _file_of(name)) is not None]
    return tuple(files)


_PLACE = re.compile(r"manifold(\.\w+)+:\w+")
"""A place of an implementation in a registry."""


_BESIDE = ("benchmarks", "tools", "tests", "tests/surface")
"""Folders whose modules benchmarks import by their names."""


def _file_of(name: str) -> Path | None:
    """Return the file of a module of this repository, without its package; None for others."""
    own = name.replace("manifold.cli", "cli", 1) if name.startswith("manifold.cli") else name
    for folder in (REPOSITORY, *(REPOSITORY / beside for beside in _BESIDE)):
        path = folder.joinpath(*own.split("."))
        for file in (path.with_suffix(".py"), path / "__init__.pyi", path / "__init__.py"):
            if file.is_file():
                return file
    return None


HELD_OUT = (
    "nearest", "nearest_by_balls", "published", "pca_6_cube_root", "pca_8_cube_root", "gplvm_2", "gplvm_6",
    "blend_2", "blend_3", "nonnegative",
)  # fmt: skip
BUILT_IN = ("nearest", "nearest_by_balls", "published", "blend_2", "nonnegative")
CHARTED = (
    "nearest", "published", "blend_2", "nonnegative", "nonnegative_angles_2_2",
    "blend_2_angles_2_2",
)  # fmt: skip

RESULTS = {
    "letter": Result("bench_letter.py FILES"),
    "fair": Result("bench_fair.py FILES --every 2"),
    "fair_corpus": Result("bench_fair.py CORPUS --every 10"),
    "between": Result("bench_between.py FILES"),
    "layouts": Result("bench_layouts.py LIBRARY"),
    "layouts_corpus": Result("bench_layouts.py CORPUS_LIBRARY"),
    "layouts_neural": Result("bench_layouts.py NEURAL_LIBRARY"),
    "spectral": Result("bench_spectral.py LIBRARY SPECTRAL"),
    "counts": Result("bench_counts.py LIBRARY"),
    "sequence": Result("bench_sequence.py LIBRARY"),
    "noise": Result("bench_noise.py LIBRARY"),
    "met": Result("bench_met.py LIBRARY WORKBOOKS"),
    "published": Result("bench_published.py FILES"),
    "held_out": Result(
        "bench_nonnegative.py FILES --numbers 8 12 24 --anchors principled NEURAL --methods " + " ".join(HELD_OUT)
    ),
    "built_in_readings": Result("bench_readings.py built-in"),
    "built_in_held_out": Result(
        "bench_nonnegative.py built-in --anchors principled --methods " + " ".join(BUILT_IN)
    ),
    "chart": Result(
        "manifold chart --library LIBRARY -o CHART " + " ".join(f"--only {key}" for key in CHARTED),
        ("manifold/study/chart.py",),
    ),
    "readings": Result("bench_readings.py LIBRARY"),
    "completion_errors": Result("bench_completion_errors.py LIBRARY NEURAL --every 3 --tasks of_library"),
    "designs": Result("bench_designs.py NEURAL"),
    "lights": Result("bench_lights.py FILES"),
    "fit": Result("bench_fit.py --files FILES --appearance-only"),
    "exports": Result("bench_exports.py --files FILES --targets gltf,openpbr"),
    "shader": Result("bench_shader.py FILES"),
    "shader_time": Result("bench_shader.py FILES --time"),
    "expected_error": Result("bench_expected_error.py LIBRARY"),
    "interior": Result("bench_interior.py LIBRARY"),
    "interior_corpus": Result("bench_interior.py CORPUS_LIBRARY"),
    "interior_neural": Result("bench_interior.py NEURAL_LIBRARY"),
    "walks": Result("bench_walks.py LIBRARY"),
    "page": Result("bench_page.py MODEL"),
    "page_surfaces": Result("bench_page_surfaces.py MODEL SURFACES"),
    "compact": Result("bench_compact.py FILES"),
    "inspection": Result("bench_inspection.py --files FILES"),
    "photo": Result("bench_photo.py FILES"),
    "built_in_photo": Result("bench_photo.py built-in --lights studio"),
    "together": Result("bench_photo.py FILES --lights studio --together"),
    "pixels": Result("bench_pixels.py FILES --every 2"),
    "encodings": Result("bench_pixels.py FILES --encodings --every 4"),
    "lamps": Result("bench_lamps.py --files FILES --library LIBRARY --lights sun --every 2"),
    "surface": Result("bench_surface.py WORKBOOK_FOLDER LIBRARY"),
    "stability": Result("manifold stability", ("manifold/study/stability",)),
    "goniometer": Result("bench_goniometer.py"),
    "render": Result("bench_render.py"),
    "evaluation": Result("bench_evaluation.py"),
    "fluorescent": Result("fluorescent_light.py"),
    "scale": Result("bench_scale.py --sizes 50,150,500,1500,5000"),
    "cluster": Result("bench_cluster.py"),
    "gplvm": Result("bench_gplvm.py"),
    "prediction": Result("bench_prediction.py"),
    "commands": Result("bench_commands.py FILES", ("cli",)),
    "engines": Result("make engines", ("tools/engines",)),
}  # fmt: skip
"""Every result by name."""


def bare(source: str) -> str:
    """Return a module's syntax tree as text, without the places of imports, docstrings and the wording of messages."""
    return str(_plain(ast.parse(source)))


def _plain(node: object, in_message: bool = False) -> object:
    """A node as nested lists, in the same way under every version of Python."""
    if isinstance(node, list):
        return [_plain(each, in_message) for each in node]
    if not isinstance(node, ast.AST):
        return repr(node)
    if isinstance(node, ast.Import | ast.ImportFrom):
        return sorted(f"{alias.name.rpartition('.')[2]} {alias.asname}" for alias in node.names)
    in_message = in_message or _is_message(node)
    if in_message and _is_sentence(node):
        return "sentence"
    fields = [(name, value) for name, value in ast.iter_fields(node) if name not in ("ctx", "kind")]
    if not isinstance(node, ast.Constant):  # newer versions of Python have more fields, empty here
        fields = [(name, value) for name, value in fields if value not in (None, [])]
    return [type(node).__name__, *([name, _plain(_code(value), in_message)] for name, value in fields)]


def _code(value: object) -> object:
    """Statements without docstrings of modules, classes, functions and attributes."""
    if not isinstance(value, list):
        return value
    return [
        each for each in value if not (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant))
    ]


_SPOKEN = ("print", "warn", "sentence", "error", "exit", "add_argument", "ArgumentParser")


def _is_message(node: ast.AST) -> bool:
    """Whether a statement or call only says something."""
    if isinstance(node, ast.Raise):
        return True
    called = node.func if isinstance(node, ast.Call) else None
    return getattr(called, "attr", getattr(called, "id", None)) in _SPOKEN


def _is_sentence(node: ast.AST) -> bool:
    """Whether a node of a message is a text with blanks: its wording decides no figure."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    texts = [part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    return any(" " in text.strip() for text in texts)


DATA = (".bsdf", ".brdf", ".csv", ".h5", ".xlsx", ".zip")
"""Suffixes of the files in a folder of data that benchmarks read."""


def data_hash(paths: Iterable[Path]) -> str:
    """SHA-256 of the names and contents of files, of those in folders, or of the members of zip files, shortened."""
    sums = set()
    for path in paths:
        for file in (p for p in path.rglob("*") if p.suffix in DATA) if path.is_dir() else [path]:
            for name, content in _contents(file):
                sums.add(name + hashlib.sha256(content).hexdigest())
    return hashlib.sha256("".join(sorted(sums)).encode()).hexdigest()[:16]


def _contents(file: Path) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of a file, or of each member of a zip file."""
    if file.suffix != ".zip":
        yield file.name, file.read_bytes()
        return
    with zipfile.ZipFile(file) as packed:
        for member in packed.infolist():
            if Path(member.filename).suffix in DATA:
                yield Path(member.filename).name, packed.read(member)


def stamp(name: str, path: Path, data: dict[str, str], seconds: float | None) -> None:
    """Add to a result how it was made; data are hashes by the word that stands for them in the command."""
    content = json.loads(path.read_text(encoding="utf-8"))
    git = ["git", "-C", str(REPOSITORY), "rev-parse", "--short=10", "HEAD"]
    record_of_run = {
        "command": RESULTS[name].command, "version": __version__,
        "commit": subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip(),
        "code": RESULTS[name].code_hash, "data": data, "date": datetime.now(UTC).date().isoformat(),
        "processor": f"{platform.machine()}, {platform.python_implementation()} {platform.python_version()}",
        "processor_seconds": None if seconds is None else round(seconds),
    }  # fmt: skip
    path.write_text(json.dumps({MADE: record_of_run} | content, indent=1) + "\n", encoding="utf-8")


def record(name: str) -> dict[str, object]:
    """How a result was made."""
    return dict(json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))[MADE])


def minutes(name: str) -> float | None:
    """Minutes of a processor that a result took when it was last measured; None if they are not known."""
    if not (FOLDER / f"{name}.json").exists():
        return None
    seconds = record(name)["processor_seconds"]
    return None if seconds is None else float(str(seconds)) / 60.0


def is_current(name: str) -> bool:
    """Whether a result was measured with the present code."""
    return record(name)["code"] == RESULTS[name].code_hash


def table() -> str:
    """The results as a table of Markdown: command, minutes, date, commit, and whether the code has changed since."""
    rows = ["| result | command | minutes | measured | commit | code |", "|---|---|---|---|---|---|"]
    for path in sorted(FOLDER.glob("*.json")):
        how = record(path.stem)
        code = (
            "not recorded" if how["code"] is None else "as now" if is_current(path.stem) else "changed since"
        )
        command = re.sub(r"(--only \S+ ?|--methods .*)", "", str(how["command"])).strip()
        took = minutes(path.stem)
        shown = "" if took is None else f"{took:.1f}" if took < 1.0 else f"{took:.0f}"
        rows.append(f"| `{path.stem}` | `{command}` | {shown} | {how['date']} | `{how['commit']}` | {code} |")
    return "\n".join(rows)
