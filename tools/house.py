"""Count what a reader of the code meets.

    python tools/house.py [REVISION ...]      # by default the working tree
    python tools/house.py --check             # prints circles of imports only, and fails if there is one
    python tools/house.py --importers         # lists modules that one other module imports, with their lines

Prints per folder: lines of code (no blank lines, comments or docstrings), functions, classes, code lines in the body of
a function, and the share of functions that one place refers to. Below are circles of imports: groups of modules that
reach each other by imports at the top of modules and for annotations (`TYPE_CHECKING`), and by these and imports within
functions.

A function has one caller where its name occurs once outside its own body. That share leaves out names that several
functions have, methods between double underscores, and functions with decorators, which frameworks call.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import sys
import tarfile
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("manifold", "cli")
_TEXTLESS = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
    tokenize.ENCODING,
}  # fmt: skip
_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Folder:
    """Counts of a folder; `bodies` are code lines of each function, `callers` whether each has one caller."""

    lines: int = 0
    classes: int = 0
    bodies: list[int] = field(default_factory=list)
    callers: list[bool] = field(default_factory=list)

    def row(self, name: str) -> str:
        """A line of the table."""
        mean = sum(self.bodies) / max(len(self.bodies), 1)
        share = sum(self.callers) / max(len(self.callers), 1)
        return f"{name:32} {self.lines:7} {len(self.bodies):9} {self.classes:7} {mean:9.1f} {share:10.0%}"


def sources(revision: str | None) -> dict[str, str]:
    """The Python files of the packages by path, of a revision or of the working tree."""
    if revision is None:
        paths = (path for package in PACKAGES for path in (REPOSITORY / package).rglob("*.py"))
        return {str(path.relative_to(REPOSITORY)): path.read_text(encoding="utf-8") for path in paths}
    archive = subprocess.run(
        ["git", "archive", revision, *PACKAGES], cwd=REPOSITORY, check=True, capture_output=True
    ).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        files = [member for member in tar if member.isfile() and member.name.endswith(".py")]
        return {member.name: tar.extractfile(member).read().decode() for member in files}  # type: ignore[union-attr]


def code_lines(source: str, tree: ast.Module) -> set[int]:
    """Numbers of the lines that hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _TEXTLESS:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        for statement in getattr(node, "body", []) if not isinstance(node, ast.Lambda | ast.IfExp) else []:
            if isinstance(statement, ast.Expr) and isinstance(getattr(statement.value, "value", None), str):
                lines.difference_update(range(statement.lineno, (statement.end_lineno or 0) + 1))
    return lines


def references(tree: ast.AST) -> Iterator[str]:
    """Names that are used, by themselves or after a dot; imports do not count."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def table(files: dict[str, str]) -> dict[str, Folder]:
    """Counts by folder, and their sum."""
    trees = {path: ast.parse(source) for path, source in files.items()}
    used = Counter(name for tree in trees.values() for name in references(tree))
    defined = Counter(
        node.name for tree in trees.values() for node in ast.walk(tree) if isinstance(node, _Function)
    )
    folders: dict[str, Folder] = defaultdict(Folder)
    for path, tree in trees.items():
        lines = code_lines(files[path], tree)
        for folder in (folders[str(Path(path).parent)], folders["all"]):
            folder.lines += len(lines)
            folder.classes += sum(isinstance(node, ast.ClassDef) for node in ast.walk(tree))
            for node in ast.walk(tree):
                if not isinstance(node, _Function):
                    continue
                body = range(node.body[0].lineno, (node.end_lineno or 0) + 1)
                folder.bodies.append(len(lines.intersection(body)))
                is_called_by_us = not node.decorator_list and not node.name.startswith("__")
                if is_called_by_us and defined[node.name] == 1:
                    own = sum(name == node.name for name in references(node))
                    folder.callers.append(used[node.name] - own == 1)
    return dict(sorted(folders.items(), key=lambda item: (item[0] == "all", item[0])))


def imports(files: dict[str, str], *, in_functions: bool) -> dict[str, set[str]]:
    """Modules that each module imports, of the packages themselves."""
    modules = {path.removesuffix(".py").removesuffix("/__init__").replace("/", "."): path for path in files}
    edges: dict[str, set[str]] = {}
    for module, path in modules.items():
        edges[module] = set()
        waiting: list[ast.AST] = [ast.parse(files[path])]
        while waiting:
            node = waiting.pop()
            if isinstance(node, ast.ImportFrom):
                source = node.module or ""
                if node.level:
                    package = module if path.endswith("/__init__.py") else module.rpartition(".")[0]
                    above = package.split(".")[: package.count(".") + 2 - node.level]
                    source = ".".join([*above, *filter(None, [source])])
                names = [f"{source}.{alias.name}" for alias in node.names]
                edges[module].update(name if name in modules else source for name in names)
            elif isinstance(node, ast.Import):
                edges[module].update(alias.name for alias in node.names)
            elif in_functions or not isinstance(node, _Function):
                waiting.extend(ast.iter_child_nodes(node))
        edges[module] = {name for name in edges[module] if name in modules and name != module}
    return edges


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of several modules each of which reaches all others of its group, the largest first."""

    def reached(start: str) -> set[str]:
        done, waiting = set[str](), list(edges[start])
        while waiting:
            module = waiting.pop()
            if module not in done:
                done.add(module)
                waiting.extend(edges[module])
        return done

    reach = {module: reached(module) for module in edges}
    groups = {
        frozenset(other for other in reach[module] if module in reach[other])
        for module in edges
        if module in reach[module]
    }
    return sorted((sorted(group) for group in groups), key=lambda group: (-len(group), group))


def print_circles(files: dict[str, str]) -> int:
    """Print circles of imports, and return their number."""
    count = 0
    for title, in_functions in (("by modules and annotations", False), ("by functions as well", True)):
        groups = circles(imports(files, in_functions=in_functions))
        print(f"circles of imports, {title}: {len(groups)}, of {sum(map(len, groups))} modules")
        for group in groups:
            print("   " + " ".join(group))
        count += len(groups)
    return count


def print_single_importers(files: dict[str, str]) -> None:
    """Print modules that one other module imports, in the same folder, the shortest first."""
    importers: dict[str, set[str]] = defaultdict(set)
    for module, imported in imports(files, in_functions=True).items():
        for other in imported:
            importers[other].add(module)
    rows = []
    for path, source in files.items():
        module = path.removesuffix(".py").replace("/", ".")
        folder = module.rpartition(".")[0]
        named = {name for name in importers[module] if name != folder}  # __init__ offers it
        if len(named) == 1:
            (importer,) = named
            if importer.startswith(f"{folder}."):
                rows.append((len(code_lines(source, ast.parse(source))), module, importer))
    for lines, module, importer in sorted(rows):
        print(f"{lines:5} {module:45} {importer}")


def main() -> None:
    """Print the tables of all revisions, or check the working tree."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("revisions", nargs="*", metavar="REVISION")
    parser.add_argument("--check", action="store_true", help="fail on circular imports")
    parser.add_argument("--importers", action="store_true", help="list modules with one importer")
    given = parser.parse_args()
    if given.check:
        sys.exit(print_circles(sources(None)) > 0)
    if given.importers:
        print_single_importers(sources(None))
        return
    for revision in given.revisions or [None]:
        files = sources(revision)
        print(f"{revision or 'working tree'}")
        print(
            f"{'folder':32} {'lines':>7} {'functions':>9} {'classes':>7} {'mean body':>9} {'one caller':>10}"
        )
        for name, folder in table(files).items():
            print(folder.row(name))
        print_circles(files)
        print()


if __name__ == "__main__":
    main()
