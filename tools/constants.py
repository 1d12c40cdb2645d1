"""Measure how far figures move if a constant of the code has another value.

    python tools/constants.py [NAME ...] [--json FILE]      # NAME: a module or a constant, `model.walks`, `_SHARE`
    python tools/constants.py --census                      # numbers of constants by folder and class

Each number that a module of `SUBJECTS` names at its top is multiplied and divided by 1.5: all numbers of a tuple or
array together, the distance from 1 of a share between one half and 1, and whole numbers are rounded away from the old
value. The figures of `constants_figures.py` whose code reads the constant are measured again, in a copy of this
process, so that everything that the constant does not change is prepared once.

Prints one row per constant: the largest change of the numbers of each figure that reads it, in per cent, and that of
their geometric mean at both values. `fails` means that the program refuses one of the values. The end of the table
lists the constants that no figure reads: rare inputs, printed text and pictures use them. The table omits sizes of
blocks, limits of input sizes, and facts of formats (`EXEMPT`). All of it takes about 40 minutes of processor time.
"""

from __future__ import annotations

import argparse
import ast
import collections
import importlib
import json
import os
import pickle
import pkgutil
import re
import signal
import sys
import threading
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "MANIFOLD_NUM_THREADS"):
    os.environ[variable] = "1"  # one thread, whose calls are seen, and copies of the process are safe

import numpy as np  # noqa: E402

REPOSITORY = Path(__file__).resolve().parents[1]
SUBJECTS = (
    "estimate", "model", "surface", "fit",
    "colour.saturation", "formats.doubts", "formats.light_side", "formats.values",
)  # fmt: skip
FACTORS = (1.5, 1.0 / 1.5)
EXEMPT = (
    "BLOCK", "BLOCK_ROWS", "AT_ONCE", "MOST_KEPT", "VERSION", "BYTES", "DIGEST", "MOST_PIXELS", "MOST_TOGETHER",
    "MOST_SIZE", "MOST_MATERIALS", "MIN_PAIRS", "MAX_PAIRS",
)  # fmt: skip
# `LIMIT` finds the names of constants that limit a size or control output. `WHOLE_LIMIT` finds names that have this
# meaning only for whole numbers. `FACT` finds comments that name a format, an instrument or a standard.
WHOLE_LIMIT = re.compile(r"(^|_)(MOST|LARGEST|LONGEST|WIDEST)(_|$)")
LIMIT = re.compile(
    r"(^|_)(BLOCKS?|ROWS|BYTES|VERSION|SHOWN|SNIFFED|AT_ONCE|SIZE|WIDTH|HEIGHT|PIXELS|SAMPLES|"
    r"NODES|AZIMUTHS|POINTS|INCHES|MARGIN|COLUMNS|LINES|TAGS?|TOGETHER|SEARCHED|NM|INCIDENCES_DEG|EVALUATIONS|ITERATIONS|"
    r"MAX_ITER|ROUNDS|STEPS|MAGIC|DTYPES|CHANNELS|PRIMARIES|WHITE_\w+|OF_BYTES)(_|$)"
)
FACT = re.compile(
    r"bytes|letters|characters|source:|ITU|ICC|CIE|ASTM|Mitsuba's|schema|tags|in a message|a picture of", re.I
)
SAME = 1e-6  # relative change of a figure that is put down to rounding
SECONDS = 120  # after which a measurement counts as failed


# -- constants --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Constant:
    """A number, or numbers, that a module names at its top."""

    module: str
    name: str
    line: int

    def __str__(self) -> str:
        return f"{self.module.removeprefix('manifold.')}.{self.name}"

    @property
    def value(self) -> Any:
        """Its present value."""
        return getattr(sys.modules[self.module], self.name)


@cache
def tree(module: str) -> ast.Module:
    """Return the code of a module."""
    return ast.parse(Path(sys.modules[module].__file__ or "").read_text(encoding="utf-8"))


def modules() -> list[str]:
    """Import the subjects' modules, and return the names of all modules of the package that are there."""
    for subject in SUBJECTS:
        package = importlib.import_module(f"manifold.{subject}")
        for found in pkgutil.walk_packages(getattr(package, "__path__", ()), f"{package.__name__}."):
            importlib.import_module(found.name)
    return sorted(
        name
        for name, module in sys.modules.items()
        if name.split(".")[0] == "manifold" and str(getattr(module, "__file__", "")).endswith(".py")
    )


def assigned(statement: ast.stmt) -> tuple[list[str], ast.expr] | None:
    """Return the names that a statement at the top of a module sets, and the expression."""
    if isinstance(statement, ast.AnnAssign) and statement.value and isinstance(statement.target, ast.Name):
        return [statement.target.id], statement.value
    if isinstance(statement, ast.Assign):
        targets = statement.targets[0]
        parts = targets.elts if isinstance(targets, ast.Tuple) else [targets]
        names = [part.id for part in parts if isinstance(part, ast.Name)]
        return (names, statement.value) if names else None
    return None


def constants() -> list[Constant]:
    """Return the constants of the subjects: names in capitals whose value is a number, or consists of numbers."""
    found = []
    for module in modules():
        if f"{module}.".startswith(tuple(f"manifold.{subject}." for subject in SUBJECTS)):
            for statement in tree(module).body:
                names, expression = assigned(statement) or ([], None)
                written = expression is not None and any(
                    isinstance(node, ast.Constant) and type(node.value) in (int, float)
                    for node in ast.walk(expression)
                )
                found += [
                    Constant(module, name, statement.lineno)
                    for name in names
                    if written
                    and not name.endswith(EXEMPT)
                    and name.isupper()
                    and changed(getattr(sys.modules[module], name), 1.5) is not None
                ]
    return found


def changed(value: Any, factor: float) -> Any:
    """Return a value times a factor; None if it holds no number."""
    if isinstance(value, bool | str) or value is None:
        return None
    if isinstance(value, int):
        return int(np.ceil(value * factor) if factor > 1.0 else np.floor(value * factor))
    if isinstance(value, float):
        return 1.0 - (1.0 - value) / factor if 0.5 < value < 1.0 else value * factor
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return value * factor
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        parts = [changed(part, factor) for part in value]
        return None if any(part is None for part in parts) or not parts else type(value)(parts)
    if isinstance(value, slice) and isinstance(value.step, int):
        return slice(value.start, value.stop, changed(value.step, factor))
    if isinstance(value, dict):
        parts = {key: changed(part, factor) for key, part in value.items()}
        return None if any(part is None for part in parts.values()) else parts
    return None


def census() -> dict[str, collections.Counter[str]]:
    """Return numbers of constants that hold numbers, by folder of the package and class.

    Exempt are limits of sizes, numbers of samples and iterations, and facts; shared are names that other modules
    import. The others decide, with a comment or docstring, or without.
    """
    root = REPOSITORY / "manifold"
    code = {path: path.read_text(encoding="utf-8") for path in sorted(root.rglob("*.py"))}
    imported = {
        alias.name
        for text in code.values()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for path, text in code.items():
        body, lines = ast.parse(text).body, text.splitlines()
        for k, statement in enumerate(body):
            names, expression = assigned(statement) or ([], None)
            types = {
                type(node.value)
                for node in (() if expression is None else ast.walk(expression))
                if isinstance(node, ast.Constant) and type(node.value) in (int, float)
            }
            if not types:
                continue
            own = lines[statement.lineno - 1 : statement.end_lineno]
            following = body[k + 1] if k + 1 < len(body) else None
            said = " ".join(re.findall(r"#.*", "\n".join([*own, lines[statement.lineno - 2]])))
            if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
                said += str(following.value.value)
            for name in filter(str.isupper, names):
                is_limit = LIMIT.search(name) or (float not in types and WHOLE_LIMIT.search(name))
                kind = (
                    "exempt" if is_limit or FACT.search(said)
                    else "shared" if name in imported
                    else "with a sentence" if said
                    else "without one"
                )  # fmt: skip
                counts[path.relative_to(root).parts[0]][kind] += 1
    return dict(counts)


def print_census() -> None:
    """Print a table of the census."""
    kinds = ("exempt", "shared", "with a sentence", "without one")
    counts = census()
    total = sum(counts.values(), collections.Counter[str]())
    print(f"{'':14}", *(f"{kind:>16}" for kind in kinds))
    for folder, of in [*sorted(counts.items()), ("all", total)]:
        print(f"{folder:14}", *(f"{of[kind]:16}" for kind in kinds))


class Patch:
    """The names in modules that hold a constant, or are computed from it, and the functions whose defaults follow.

    Attributes:
        names: those in each module, by its name.
        functions: codes of functions of which it is a default, or whose default follows from it.
    """

    def __init__(self, constant: Constant, everywhere: Sequence[str]) -> None:
        self.names: dict[str, set[str]] = {constant.module: {constant.name}}
        self.functions: set[types.CodeType] = set()
        self._steps: list[Callable[[], None]] = []
        self._follow(constant, everywhere)

    def _follow(self, constant: Constant, everywhere: Sequence[str]) -> None:
        waiting = [(constant.module, constant.name)]
        while waiting:
            module, name = waiting.pop()
            for other in everywhere:
                is_own = other == module
                found = self._computed(name, other) if is_own else self._imported(module, name, other)
                held = self.names.setdefault(other, set())
                waiting += [(other, alias) for alias in found - held]
                held |= found
            self._defaults(name, module)

    def _imported(self, module: str, name: str, other: str) -> set[str]:
        """Names by which another module imports a name, copied when this is applied."""
        aliases = set()
        package = other if hasattr(sys.modules[other], "__path__") else other.rpartition(".")[0]
        for node in tree(other).body:
            if isinstance(node, ast.ImportFrom):
                source = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
                if source == module:
                    aliases |= {each.asname or each.name for each in node.names if each.name == name}
        for alias in aliases:
            self._steps.append(partial(copy_name, module, name, other, alias))
        return aliases

    def _computed(self, name: str, module: str) -> set[str]:
        """Names that a module computes from a name at its top, computed again when this is applied."""
        found = set()
        for statement in tree(module).body:
            names, expression = assigned(statement) or ([], None)
            if expression is not None and name not in names and reads(expression, name):
                code = compile(ast.Module([statement], []), module, "exec")
                self._steps.append(lambda code=code: exec(code, vars(sys.modules[module])))
                found.update(names)
        return found

    def _defaults(self, name: str, module: str) -> None:
        """Note functions that have a name among their defaults, which are computed again when this is applied."""
        for node in ast.walk(tree(module)):
            if isinstance(node, ast.FunctionDef):
                given = [*node.args.defaults, *(each for each in node.args.kw_defaults if each is not None)]
                if any(reads(each, name) for each in given):
                    for function in functions_of(module, node.name, node.lineno):
                        self.functions.add(function.__code__)
                        self._steps.append(lambda f=function, n=node: set_defaults(f, n.args, module))

    def apply(self, constant: Constant, value: Any) -> None:
        """Set the value, and all that follows from it."""
        setattr(sys.modules[constant.module], constant.name, value)
        for step in self._steps:
            step()

    def is_read_by(self, ran: Ran) -> bool:
        """Return whether functions that ran read one of the names."""
        return not self.functions.isdisjoint(ran.functions) or any(
            (module, name) in ran.names for module, names in self.names.items() for name in names
        )


def copy_name(module: str, name: str, other: str, alias: str) -> None:
    """Import a name of a module into another again."""
    setattr(sys.modules[other], alias, getattr(sys.modules[module], name))


def reads(expression: ast.expr, name: str) -> bool:
    """Return whether an expression has a name in it."""
    return any(isinstance(node, ast.Name) and node.id == name for node in ast.walk(expression))


def functions_of(module: str, name: str, line: int) -> Iterator[types.FunctionType]:
    """Yield the functions and methods of a module that are defined at a line."""
    inside = vars(sys.modules[module])
    for owner in [inside, *(vars(each) for each in inside.values() if isinstance(each, type))]:
        function = owner.get(name)
        function = getattr(function, "__func__", function)
        function = getattr(function, "__wrapped__", function)
        if isinstance(function, types.FunctionType) and function.__module__ == module:
            yield function


def set_defaults(function: types.FunctionType, arguments: ast.arguments, module: str) -> None:
    """Compute a function's defaults again."""

    def value(expression: ast.expr) -> Any:
        return eval(compile(ast.Expression(expression), module, "eval"), vars(sys.modules[module]))

    if arguments.defaults:
        function.__defaults__ = tuple(value(each) for each in arguments.defaults)
    named = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    function.__kwdefaults__ = {key.arg: value(each) for key, each in named if each is not None} or None  # type: ignore[assignment]


@dataclass(frozen=True)
class Ran:
    """Functions of the package that ran, and the names of modules, as pairs, that they may have read."""

    functions: set[types.CodeType]
    names: set[tuple[str, str]]

    @classmethod
    def of(cls, functions: set[types.CodeType]) -> Ran:
        """Collect the names."""
        files = {getattr(module, "__file__", None): name for name, module in sys.modules.items()}
        names = set()
        for code in functions:
            module = files.get(code.co_filename, "manifold")
            names.update((module, name) for name in code.co_names)
            inside = (vars(sys.modules[module]).get(name) for name in code.co_names)
            modules_read = [each.__name__ for each in inside if isinstance(each, types.ModuleType)]
            names.update((other, name) for other in modules_read for name in code.co_names)
        return cls(functions, names)


# -- figures ----------------------------------------------------------------------------------------------------------


@dataclass
class Figure:
    """Numbers that are measured for the constants of some modules, `subjects`.

    `prepare` makes the argument of `measure`; it is called again for constants that it reads.
    """

    name: str
    subjects: str
    prepare: Callable[[], Any]
    measure: Callable[[Any], dict[str, float]]
    prepared: Any = None
    base: dict[str, float] = field(default_factory=dict)
    ran: tuple[Ran, ...] = ()
    seconds: float = 0.0

    def run(self) -> None:
        """Measure with the code as it is, and note the functions that run and the processor time."""
        start = os.times().user
        made, before = traced(self.prepare)
        self.prepared = made
        self.base, after = traced(lambda: self.measure(made))
        self.ran = before, after
        self.seconds = os.times().user - start

    def reads(self, constant: Constant, patch: Patch) -> bool:
        """Return whether the figure is to be measured at another value of a constant."""
        return self.serves(constant) and any(map(patch.is_read_by, self.ran))

    def serves(self, constant: Constant) -> bool:
        """Return whether the figure is meant for the constants of a module."""
        return any(f"{constant}.".startswith(f"{subject}.") for subject in self.subjects.split())

    def again(self, patch: Patch) -> dict[str, float]:
        """Measure after a patch."""
        return self.measure(self.prepare() if patch.is_read_by(self.ran[0]) else self.prepared)


def traced(function: Callable[[], Any]) -> tuple[Any, Ran]:
    """Call a function; return its result, and the functions of the package that ran."""
    functions: set[types.CodeType] = set()
    root = str(REPOSITORY / "manifold")

    def note(frame: types.FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(root):
            functions.add(frame.f_code)

    forget_cached()
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        result = function()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    return result, Ran.of(functions)


def forget_cached() -> None:
    """Empty the caches of functions of the subjects."""
    for name in list(sys.modules):
        if name.startswith(tuple(f"manifold.{subject}" for subject in SUBJECTS)):
            for value in vars(sys.modules[name]).values():
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


def figures() -> list[Figure]:
    """Return what is measured, of the built-in library, its materials left out, and simulated observations of them."""
    sys.path[:0] = [str(REPOSITORY / name) for name in ("benchmarks", "tests", "tests/surface")]
    from constants_figures import all_figures

    return [Figure(*each) for each in all_figures()]


# -- measurements -----------------------------------------------------------------------------------------------------


def moved(figure: Figure, found: dict[str, float]) -> list[float]:
    """Return the largest relative change of a figure's numbers, and that of their geometric mean.

    Changes of zeros count as they are, and are left out of the mean.
    """
    before, after = (np.array([numbers[key] for key in figure.base]) for numbers in (figure.base, found))
    change = np.abs(after - before) / np.where(before == 0.0, 1.0, np.abs(before))
    ratios = after[before * after > 0.0] / before[before * after > 0.0]
    mean = float(np.expm1(np.mean(np.log(ratios)))) if len(ratios) else 0.0
    largest = float(np.max(np.where(np.isfinite(change), change, np.inf)))
    return [largest, mean] if largest > SAME else [0.0, 0.0]


def in_copy(measure: Callable[[], Any]) -> Any:
    """Call a function in a copy of this process, and return its result; an error or a timeout is the word for it."""
    inlet, outlet = os.pipe()
    child = os.fork()
    if not child:
        os.close(inlet)
        signal.alarm(SECONDS)
        try:
            result = measure()
        except BaseException as error:
            result = f"{type(error).__name__}: {error}"
        with os.fdopen(outlet, "wb") as stream:
            pickle.dump(result, stream)
        os._exit(0)
    os.close(outlet)
    with os.fdopen(inlet, "rb") as stream:
        content = stream.read()
    os.waitpid(child, 0)
    return pickle.loads(content) if content else f"no result within {SECONDS} s"


def measure_constant(
    constant: Constant, patch: Patch, figures: Sequence[Figure], until: float
) -> dict[str, list[list[float] | str]]:
    """Return how far each figure that reads a constant moves at its other values, or the refusal.

    After a change of `until`, relative, nothing further is measured.
    """
    found: dict[str, list[list[float] | str]] = {}
    for figure in figures:
        for factor in FACTORS if figure.reads(constant, patch) else ():

            def measure(figure: Figure = figure, factor: float = factor) -> list[float]:
                forget_cached()
                patch.apply(constant, changed(constant.value, factor))
                return moved(figure, figure.again(patch))

            change = in_copy(measure)
            found.setdefault(figure.name, []).append(change)
            if not isinstance(change, str) and change[0] >= until:
                return found
    return found


def chosen(found: list[Constant], names: Sequence[str]) -> list[Constant]:
    """Return the constants that names of modules or constants mean; all without names."""
    return [
        one
        for one in found
        if not names or any(str(one) == n or str(one).startswith(f"{n}.") or one.name == n for n in names)
    ]


def row(constant: Constant, changes: dict[str, list[list[float] | str]]) -> str:
    """Return a line of the table."""
    cells = []
    for name, both in changes.items():
        numbers = [each for each in both if not isinstance(each, str)]
        means = "/".join(f"{100.0 * mean:.2g}" for _, mean in numbers)
        cells.append(f"{name} {100.0 * max(numbers)[0]:.2g} ({means})" if numbers else f"{name} fails")
        if 0 < len(numbers) < len(both):
            cells[-1] += " fails"
    text = str(constant.value).replace("\n", " ")
    return f"{constant!s:45} {text if len(text) < 24 else text[:21] + '...':24} {', '.join(cells)}"


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument(
        "--json", type=Path, help="write the changes, constant by constant; those that are there are kept"
    )
    parser.add_argument(
        "--until", type=float, default=np.inf, metavar="PERCENT",
        help="measure nothing further of a constant that moved a figure by this much: half the time",
    )  # fmt: skip
    parser.add_argument("--list", action="store_true", help="list the constants, and measure nothing")
    parser.add_argument(
        "--census", action="store_true", help="count constants by folder and class, and measure nothing"
    )
    given = parser.parse_args()
    if given.census:
        print_census()
        return
    found = chosen(constants(), given.names)
    if given.list:
        print(*(f"{one!s:45} {one.value}" for one in found), sep="\n")
        return
    table: dict[str, dict[str, list[list[float] | str]]] = {}
    if given.json and given.json.exists():
        table = json.loads(given.json.read_text(encoding="utf-8"))
    found = [constant for constant in found if str(constant) not in table]
    everywhere = modules()
    measured = [figure for figure in figures() if any(map(figure.serves, found))]
    for figure in measured:
        figure.run()
        print(f"{figure.name}: {figure.seconds:.1f} s, {len(figure.base)} numbers", flush=True)
    measured.sort(key=lambda figure: figure.seconds)
    for constant in found:
        patch = Patch(constant, everywhere)
        changes = table[str(constant)] = measure_constant(constant, patch, measured, given.until / 100.0)
        if changes:
            print(row(constant, table[str(constant)]), flush=True)
        if given.json:
            given.json.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    print("read by no figure:", *(name for name, changes in table.items() if not changes))


if __name__ == "__main__":
    main()
