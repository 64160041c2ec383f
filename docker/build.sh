#!/bin/sh
# Makes what the image holds in FOLDER: the service in a virtual environment of its own, with its kernels compiled
# for the CPU that NUMBA_CPU_NAME and NUMBA_CPU_FEATURES name. The Dockerfile runs this, and so does
# docker/try_image.py where there is no Docker. Wheels only: no compiler, and nothing that the lock does not name.
# usage: docker/build.sh FOLDER
set -eu
: "${NUMBA_CPU_NAME:?}" "${NUMBA_CPU_FEATURES?}"
cd "$(dirname "$0")/.."
folder=$1
# Found before FOLDER has a python3: FOLDER/bin may come first in PATH, and that one has no pip.
python=$(command -v "${PYTHON:-python3}")
"$python" -m venv --without-pip "$folder"
pip() { ${PIP:-$python -m pip} --quiet --disable-pip-version-check --no-cache-dir --python "$folder/bin/python" "$@"; }
pip install --no-compile --require-hashes --only-binary :all: -r docker/requirements.lock
pip install --no-compile --no-deps --no-build-isolation .
pip uninstall --yes hatchling pathspec pluggy trove-classifiers
# What never runs here: the libraries' own tests (a sixth of all), headers, stubs for type checkers.
find "$folder" -type d -name tests -path '*/site-packages/*' -prune -exec rm -rf {} +
find "$folder" -type f \( -name '*.pyi' -o -name '*.h' -o -name '*.a' -o -name '*.px[di]' -o -name '*.pyx' \) -delete
# Symbol tables: 38 MB. What wheels have bundled was rearranged when it was, and is not touched again.
if command -v strip >/dev/null; then
    find "$folder" -type f -name '*.so' ! -path '*.libs/*' ! -path '*/cv2/*' -exec strip --strip-unneeded {} +
fi
"$folder/bin/mfcmt" warmup
"$folder/bin/python" docker/bytecode.py "$folder"
