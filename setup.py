"""Build the compiled loops of `cpp/`; everything else is in `pyproject.toml`.

From Python 3.12 on they use the stable ABI: one wheel per platform serves all later versions.
"""

from __future__ import annotations

import os
import platform
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import nanobind
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, ExecError, PlatformError

BINDING = Path(nanobind.include_dir()).parent
HAS_STABLE_ABI = (
    sys.version_info >= (3, 12)
    and platform.python_implementation() == "CPython"
    and not sysconfig.get_config_var("Py_GIL_DISABLED")
)
FLAGS = {
    # No errno, no traps, and multiplications fused with additions where processors can. Python's own flags may let
    # integers wrap around, which keeps loops from being vectorised.
    "unix": ["-std=c++17", "-O3", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast",
             "-fno-strict-aliasing", "-fno-wrapv", "-g0"],
    "msvc": ["/std:c++17", "/O2", "/EHsc", "/fp:contract"],
}  # fmt: skip


class BuildLoops(build_ext):
    """`build_ext` that says in one line what is missing."""

    def build_extensions(self) -> None:
        """Compile with the flags of the compiler at hand."""
        own = [extension.sources for extension in self.extensions]
        for extension in self.extensions:
            extension.extra_compile_args = FLAGS["msvc" if self.compiler.compiler_type == "msvc" else "unix"]
            # Setuptools refuses absolute paths where it lists the files of the sources.
            extension.sources = [*extension.sources, str(BINDING / "src" / "nb_combined.cpp")]
        compile_all = self.compiler.compile

        def compile_each(sources: list[str], **options: Any) -> list[str]:
            """Compile the sources at once: setuptools does so only with extensions."""
            with ThreadPoolExecutor(os.cpu_count()) as threads:
                made = threads.map(lambda source: compile_all([source], **options), sources)
                return [path for paths in made for path in paths]

        self.compiler.compile = compile_each
        try:
            super().build_extensions()
        except (CCompilerError, ExecError, PlatformError) as error:
            sys.exit(
                f"manifold: its loops could not be compiled ({error}); install a C++17 compiler and Python's headers "
                "(Debian: apt install g++ python3-dev), or install a wheel"
            )
        finally:
            for extension, sources in zip(self.extensions, own, strict=True):
                extension.sources = sources


setup(
    ext_modules=[
        Extension(
            "manifold.core._compiled",
            sorted(str(path) for path in Path("cpp").glob("*.cpp")),
            include_dirs=[nanobind.include_dir(), str(BINDING / "ext" / "robin_map" / "include")],
            depends=sorted(str(path) for path in Path("cpp").glob("*.hpp")),
            define_macros=[("NDEBUG", None), *([("Py_LIMITED_API", "0x030C0000")] if HAS_STABLE_ABI else [])],
            py_limited_api=HAS_STABLE_ABI,
            language="c++",
        )
    ],
    cmdclass={"build_ext": BuildLoops},
    options={"bdist_wheel": {"py_limited_api": "cp312"}} if HAS_STABLE_ABI else {},
)
