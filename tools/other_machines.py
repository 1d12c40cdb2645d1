"""Run the tests as other processors round: with the BLAS kernels of other core types, one thread and two, five seeds.

    python tools/other_machines.py                          # all core types that this processor can run
    python tools/other_machines.py --cores Prescott --threads 1 -- tests/gp -x
    python tools/other_machines.py --environment Prescott   # prints variables, which `make test CORE=Prescott` sets

A run is a core type with a number of threads, and with the next of the seeds of hypothesis. OpenBLAS takes the kernels
of the core type that OPENBLAS_CORETYPE names. A core type without AVX2 also has NumPy without its vector loops and the
C library without its FMA functions, whose exponentials, logarithms and sines round differently. Core types that have
the kernels of an earlier one are not run; those whose instructions this processor lacks are named.
"""

from __future__ import annotations

import argparse
import itertools
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

CORES = ("Haswell", "Zen", "SkylakeX", "Sandybridge", "Nehalem", "Prescott")
WITHOUT_AVX2 = ("Sandybridge", "Nehalem", "Prescott")
TESTS = ("-m", "not slow", "-n", "auto")
_KERNELS = """
import numpy, scipy.linalg, threadpoolctl
numpy.linalg.cholesky(numpy.eye(200)), scipy.linalg.cho_factor(numpy.eye(200))
print(*sorted({library["architecture"] for library in threadpoolctl.threadpool_info() if "architecture" in library}))
"""


def environment(core: str) -> dict[str, str]:
    """Return the variables with which libraries compute as on a core type."""
    variables = {"OPENBLAS_CORETYPE": core}
    if core in WITHOUT_AVX2:
        vector_loops = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
        variables["NPY_DISABLE_CPU_FEATURES"] = ",".join(vector_loops)
        variables["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-AVX2,-FMA"
    return variables


def kernels_of(core: str) -> str:
    """Return the kernels that OpenBLAS takes for a core type, or nothing if this processor cannot run them."""
    command = [sys.executable, "-c", _KERNELS]
    variables = os.environ | environment(core)
    return subprocess.run(command, env=variables, capture_output=True, text=True).stdout.strip()


def cores_to_run(cores: list[str]) -> list[str]:
    """Return the core types with kernels of their own that this processor can run; print why others are left out."""
    core_of: dict[str, str] = {}
    for core in cores:
        kernels = kernels_of(core)
        if not kernels:
            print(f"{core}: not run, this processor lacks its instructions")
        elif kernels in core_of:
            print(f"{core}: not run, its kernels are those of {core_of[kernels]} ({kernels})")
        else:
            core_of[kernels] = core
    return list(core_of.values())


def run(core: str, threads: int, seed: int, tests: list[str], log: Path) -> list[str]:
    """Run the tests and return the lines of pytest's summary: those that failed, and the counts."""
    variables = os.environ | environment(core)
    variables |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "MANIFOLD_NUM_THREADS"), str(threads))
    command = [sys.executable, "-m", "pytest", "-q", f"--hypothesis-seed={seed}", *tests]
    with log.open("w") as file:
        subprocess.run(command, env=variables, stdout=file, stderr=subprocess.STDOUT)
    lines = log.read_text().splitlines()
    return [line for line in lines if line.startswith(("FAILED ", "ERROR "))] + (lines[-1:] or ["no output"])


def main() -> None:
    """Print the counts of every run, and the tests that failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cores", nargs="+", default=list(CORES))
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument(
        "--logs", type=Path, help="folder for the output of pytest [default: a temporary one]"
    )
    parser.add_argument(
        "tests", nargs="*", default=list(TESTS), help="for pytest, behind -- [default: all but slow ones]"
    )
    parser.add_argument(
        "--environment", metavar="CORE", help="print the variables of a core type, and run nothing"
    )
    asked = parser.parse_args()
    if asked.environment:
        if platform.machine() in ("x86_64", "AMD64"):
            print(*(f"{name}={value}" for name, value in environment(asked.environment).items()), sep="\n")
        return
    logs = asked.logs or Path(tempfile.mkdtemp(prefix="other_machines_"))
    logs.mkdir(parents=True, exist_ok=True)
    print(f"Output of pytest: {logs}", flush=True)
    has_failed = False
    runs = itertools.product(cores_to_run(asked.cores), asked.threads)
    for (core, threads), seed in zip(runs, itertools.cycle(asked.seeds), strict=False):
        *failed, counts = run(core, threads, seed, asked.tests, logs / f"{core}-{threads}-{seed}.log")
        print(f"{core}, threads {threads}, seed {seed}: {counts}", *failed, sep="\n  ", flush=True)
        has_failed |= bool(failed) or " passed" not in counts
    sys.exit(has_failed)


if __name__ == "__main__":
    main()
