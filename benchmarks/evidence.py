"""The results behind the figures of the documents: their commands, the code they depend on, and their dates.

`RESULTS` is the list; `run_all.py` runs it. Each `results/NAME.json` has an entry `_made`: command, version, commit,
hash of the code, hash of the data, date, processor and processor seconds. Docstrings, comments, layout and the wording
of sentences do not change the hash of the code. Where it is None, the result is older than this record.
"""

from __future__ import annotations

import ast
import hashlib
import json
import platform
import re
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from manifold import __version__

REPOSITORY = Path(__file__).resolve().parents[1]
FOLDER = REPOSITORY / "benchmarks" / "results"
MADE = "_made"

_GPLVM = (
    "gplvm.py", "gp/likelihood.py", "dls.py", "gpr.py", "gp/kernels.py", "gp/encoding.py", "pairs.py",
)  # fmt: skip
_BLEND = ("model/blend_fitting.py", "model/blend_space.py", "model/blending.py", "model/colour_paths.py")
_COMPLETE = (
    "estimate/atoms.py", "estimate/mixtures.py", "estimate/residual.py", "estimate/evidence.py", "estimate/solving.py",
    "estimate/completion.py", "estimate/coat.py", "estimate/gloss.py",
)  # fmt: skip
_PICTURES = ("estimate/evidence.py", "estimate/solving.py", "estimate/pixel_mixtures.py")
_LIGHTS = ("colour/panel.py", "colour/difference.py")


@dataclass(frozen=True)
class Result:
    """A result: the command that writes it, and the modules of `manifold` that decide its figures.

    Words in capitals in the command stand for data, see `run_all.py`.
    """

    command: str
    modules: tuple[str, ...]

    @property
    def sources(self) -> list[Path]:
        """The files that are hashed: the benchmark and the modules."""
        program = REPOSITORY / "benchmarks" / self.command.split()[0]
        own = [program] if program.is_file() else []
        for module in self.modules:
            path = REPOSITORY / "manifold" / module
            own += sorted(path.rglob("*.py")) if path.is_dir() else [path]
        return own

    @property
    def code_hash(self) -> str:
        """SHA-256 of what `bare` keeps of the sources, shortened."""
        digest = hashlib.sha256()
        for path in self.sources:
            digest.update(bare(path.read_text(encoding="utf-8")).encode())
        return digest.hexdigest()[:16]


HELD_OUT = (
    "nearest", "published", "pca_6_cube_root", "gplvm_2", "gplvm_6",
    "blend_2", "blend_3", "nonnegative",
)  # fmt: skip
CHARTED = (
    "nearest", "published", "blend_2", "nonnegative", "nonnegative_angles_2_2",
    "blend_2_angles_2_2",
)  # fmt: skip

RESULTS = {
    "letter": Result("bench_letter.py FILES", (*_GPLVM, "model/fitting.py")),
    "fair": Result("bench_fair.py FILES --every 2", (*_GPLVM, *_BLEND, *_LIGHTS)),
    "fair_corpus": Result("bench_fair.py CORPUS --every 10", (*_GPLVM, *_BLEND, *_LIGHTS)),
    "between": Result("bench_between.py FILES", (*_GPLVM, *_BLEND, *_LIGHTS, "analytic")),
    "spectral": Result(
        "bench_spectral.py LIBRARY SPECTRAL", (*_COMPLETE, *_LIGHTS, "../benchmarks/completion_baselines.py")
    ),
    "counts": Result(
        "bench_counts.py LIBRARY",
        (*_COMPLETE, *_LIGHTS, "estimate/suggestions.py", "evaluate/readings.py", "fit/principled.py",
         "../benchmarks/completion_baselines.py"),
    ),
    "sequence": Result("bench_sequence.py LIBRARY", (*_COMPLETE, *_LIGHTS, "estimate/suggestions.py")),
    "noise": Result("bench_noise.py LIBRARY", (*_COMPLETE, *_LIGHTS)),
    "met": Result("bench_met.py LIBRARY WORKBOOKS", (*_COMPLETE, *_LIGHTS)),
    "published": Result("bench_published.py FILES", (*_GPLVM, *_BLEND, *_LIGHTS)),
    "held_out": Result(
        "bench_nonnegative.py FILES --numbers 8 12 24 --anchors principled NEURAL --methods "
        + " ".join(HELD_OUT), (*_GPLVM, *_BLEND, *_LIGHTS, "model/reconstruction.py", "evaluate/baselines.py"),
    ),
    "chart": Result(
        "manifold chart --library LIBRARY -o CHART " + " ".join(f"--only {key}" for key in CHARTED),
        (*_GPLVM, *_BLEND, *_LIGHTS, "model/reconstruction.py", "evaluate/baselines.py", "evaluate/chart.py"),
    ),
    "readings": Result("bench_readings.py LIBRARY", (*_COMPLETE, *_LIGHTS, "estimate/expected.py")),
    "lights": Result("bench_lights.py FILES", (*_LIGHTS, "model/reconstruction.py", "fit/principled.py")),
    "fit": Result("bench_fit.py --files FILES --appearance-only", ("fit/principled.py", "fit/gauss_newton.py")),
    "exports": Result("bench_exports.py --files FILES --targets gltf,openpbr", ("fit/exports",)),
    "shader": Result("bench_shader.py FILES", ("shader", *_LIGHTS)),
    "shader_time": Result("bench_shader.py FILES --time", ("shader",)),
    "expected_error": Result("bench_expected_error.py LIBRARY", (*_BLEND, "model/expected_error.py")),
    "interior": Result("bench_interior.py LIBRARY", _BLEND),
    "walks": Result("bench_walks.py LIBRARY", ("model/walks.py",)),
    "page": Result("bench_page.py MODEL", ("page",)),
    "page_surfaces": Result("bench_page_surfaces.py MODEL SURFACES", ("page", "surface")),
    "compact": Result("bench_compact.py FILES", ("library/compacting.py", "library/compact.py")),
    "inspection": Result("bench_inspection.py --files FILES", ("brdf/consistency.py", "info.py")),
    "photo": Result("bench_photo.py FILES", (*_PICTURES, "estimate/pixels.py")),
    "together": Result("bench_photo.py FILES --lights studio --together", (*_PICTURES, *_COMPLETE)),
    "lamps": Result(
        "bench_lamps.py --files FILES --library LIBRARY --lights sun --every 2",
        ("estimate/lamps.py", "estimate/light_probe.py", "estimate/outlines.py", *_PICTURES),
    ),
    "surface": Result("bench_surface.py WORKBOOK_FOLDER LIBRARY", ("surface",)),
    "stability": Result("manifold stability", ("evaluate/stability", *_GPLVM, *_BLEND)),
    "goniometer": Result("bench_goniometer.py", ("brdf/goniometer.py",)),
    "render": Result("bench_render.py", ("render", "model/prediction.py")),
    "evaluation": Result("bench_evaluation.py", ("brdf/measured.py",)),
    "fluorescent": Result("fluorescent_light.py", ("colour/illuminants.py",)),
    "scale": Result("bench_scale.py --sizes 50,150,500,1500,5000", ("model/landmarks.py", "model/blend_fitting.py")),
    "cluster": Result("bench_cluster.py", ("cluster.py", "work.py", "batch.py")),
    "gplvm": Result("bench_gplvm.py", _GPLVM),
    "prediction": Result("bench_prediction.py", ("model/prediction.py",)),
    "commands": Result("bench_commands.py FILES", ()),
    "engines": Result("make engines", ("fit/exports",)),
}  # fmt: skip
"""Every result by name."""


def bare(source: str) -> str:
    """A module's syntax tree as text, without docstrings and the wording of sentences."""
    return str(_plain(ast.parse(source)))


def _plain(node: object) -> object:
    """A node as nested lists, in the same way under every version of Python."""
    if isinstance(node, list):
        return [_plain(each) for each in node]
    if not isinstance(node, ast.AST) or _is_sentence(node):
        return "sentence" if isinstance(node, ast.AST) else repr(node)
    fields = [(name, value) for name, value in ast.iter_fields(node) if name not in ("ctx", "kind")]
    if not isinstance(node, ast.Constant):  # newer versions of Python have more fields, empty here
        fields = [(name, value) for name, value in fields if value not in (None, [])]
    return [type(node).__name__, *([name, _plain(_code(value))] for name, value in fields)]


def _code(value: object) -> object:
    """Statements without expressions that are constants: docstrings of modules, classes, functions and attributes."""
    if not isinstance(value, list):
        return value
    return [
        each for each in value if not (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant))
    ]


def _is_sentence(node: ast.AST) -> bool:
    """Whether a node is a text with blanks, such as a message: its wording decides no figure."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    texts = [part.value for part in parts if isinstance(part, ast.Constant)]
    return any(isinstance(text, str) and " " in text.strip() for text in texts)


def data_hash(paths: Iterable[Path]) -> str:
    """SHA-256 of the names and contents of files, or of those in folders, shortened."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
            digest.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


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
