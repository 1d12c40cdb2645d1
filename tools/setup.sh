#!/bin/sh
# Make the virtual environment .venv and install manifold into it.
#
#   tools/setup.sh          what running the program needs, all extras included
#   tools/setup.sh dev      what its tests and checks need as well
#   tools/setup.sh engines  Blender's module, MaterialX's renderer, and GLM for Adobe's OpenPBR; what `make engines` needs
#   tools/setup.sh docs     what the documentation site needs as well: Sphinx, and KaTeX, which converts formulas
#
# PYTHON names the interpreter (3.11 or newer); by default the first suitable one on the PATH.
# g++ compiles the loops of cpp/, and libllvm19 lets Mitsuba run its fast variants: without it everything works, slower.
# Both are installed where they are missing and apt may be used. The tests of pages need Debian's chromium, which `dev` installs likewise; those of
# shaders in other languages need glslang-tools and spirv-cross; those of glTF files by other programs need three.js and Khronos' validator, which `dev` installs into .venv where npm is there.
set -eu
cd "$(dirname "$0")/.."
extra=${1:-}

find_python() {
    for name in ${PYTHON:-python3 python3.13 python3.12 python3.11 python}; do
        if command -v "$name" >/dev/null 2>&1 &&
            "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$name"
            return
        fi
    done
    echo "setup: no Python 3.11 or newer found (looked for ${PYTHON:-python3, python3.11 to 3.13}); install one, or set PYTHON" >&2
    exit 1
}

as_root() {
    if [ "$(id -u)" = 0 ]; then
        env DEBIAN_FRONTEND=noninteractive "$@"
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        sudo -n env DEBIAN_FRONTEND=noninteractive "$@"
    else
        return 1
    fi
}

apt_install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    as_root apt-get install -y -qq "$@" >/dev/null 2>&1 && return
    as_root apt-get update -qq >/dev/null 2>&1 && as_root apt-get install -y -qq "$@" >/dev/null 2>&1
}

has_llvm() {
    ldconfig -p 2>/dev/null | grep -Eq 'libLLVM(-|\.so\.)(1[7-9]|[2-9][0-9])'
}

if [ "$extra" = engines ]; then # Blender's module is for one version of Python
    command -v xvfb-run >/dev/null 2>&1 ||
        apt_install xvfb libgl1 libgl1-mesa-dri libsm6 libxi6 libxfixes3 libxkbcommon0 libxxf86vm1 ||
        echo "setup: xvfb is missing and could not be installed; MaterialX's renderer needs an X server" >&2
    [ -f /usr/include/glm/glm.hpp ] || apt_install libglm-dev ||
        echo "setup: libglm-dev is missing and could not be installed; Adobe's OpenPBR needs it" >&2
    [ -x .venv-engines/bin/python ] || "${PYTHON:-python3.11}" -m venv .venv-engines
    .venv-engines/bin/python -m pip install --quiet --disable-pip-version-check --no-compile \
        "bpy==5.0.1" "materialx>=1.39.5,<1.40"
    touch .venv-engines/ready
    exit
fi

python=$(find_python)
if [ ! -x .venv/bin/python ] || ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    rm -rf .venv
    # Debian ships venv apart from Python itself.
    if ! "$python" -m venv .venv >/dev/null 2>&1; then
        rm -rf .venv
        version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
        apt_install "python$version-venv" || apt_install python3-venv || true
        "$python" -m venv .venv || {
            echo "setup: $python cannot make a virtual environment; install Debian's python3-venv" >&2
            exit 1
        }
    fi
fi

# The compiled loops: a compiler, and the headers of Debian's own Python.
can_compile() {
    command -v "${CXX:-c++}" >/dev/null 2>&1 &&
        [ -f "$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h" ]
}

if ! can_compile; then
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    apt_install g++ "python$version-dev" || apt_install g++ python3-dev ||
        echo "setup: a C++ compiler or Python's headers are missing and could not be installed; install g++ and python3-dev" >&2
fi

# What others than pip install, while pip downloads and compiles: each mostly waits.
install_others() {
    if ! has_llvm; then
        apt_install libllvm19 || echo "setup: libllvm19 is missing and could not be installed; Mitsuba will run its slower scalar variants" >&2
    fi

    if [ "$extra" = dev ] && ! command -v chromium >/dev/null 2>&1; then
        apt_install chromium || echo "setup: chromium is missing and could not be installed; tests of pages are skipped" >&2
    fi

    if [ "$extra" = dev ] && ! { command -v glslangValidator && command -v spirv-cross; } >/dev/null 2>&1; then
        apt_install glslang-tools spirv-cross ||
            echo "setup: glslang-tools and spirv-cross are missing and could not be installed; tests of translated shaders are skipped" >&2
    fi

    if [ "$extra" = dev ] && command -v npm >/dev/null 2>&1 && [ ! -d .venv/node_modules/three ]; then
        npm install --silent --no-fund --no-audit --prefix .venv three@0 gltf-validator >/dev/null 2>&1 ||
            echo "setup: three and gltf-validator could not be installed; tests of glTF files by them are skipped" >&2
    fi

    if [ "$extra" = docs ] && [ ! -d .venv/node_modules/katex ]; then
        command -v npm >/dev/null 2>&1 || apt_install npm || true
        npm install --silent --no-fund --no-audit --prefix .venv katex@0.16 >/dev/null 2>&1 ||
            echo "setup: KaTeX could not be installed; install Node.js with npm (Debian: apt install npm)" >&2
    fi
}

trap wait EXIT # for them, also if pip fails
install_others &

target=".[${extra:-all}]"
# Python compiles what is imported when it is first imported: half of the installation's time would go to what never is.
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --editable "$target"
wait
touch ".venv/ready$extra"
