#!/bin/sh
# What the image holds, made in FOLDER: the service in a virtual environment of its own, its kernels compiled
# for the CPU that NUMBA_CPU_NAME and NUMBA_CPU_FEATURES name. The Dockerfile runs this, and so does
# docker/try_image.py where there is no Docker. Wheels only: no compiler, and nothing that the lock does not name.
# usage: docker/build.sh FOLDER
set -eu
: "${NUMBA_CPU_NAME:?}" "${NUMBA_CPU_FEATURES?}"
cd "$(dirname "$0")/.."
folder=$1
python=${PYTHON:-python3}
"$python" -m venv --without-pip "$folder"
pip() { ${PIP:-$python -m pip} --quiet --disable-pip-version-check --no-cache-dir --python "$folder/bin/python" "$@"; }
pip install --no-compile --require-hashes --only-binary :all: -r docker/requirements.lock
pip install --no-compile --no-deps --no-build-isolation .
pip uninstall --yes hatchling pathspec pluggy trove-classifiers
# The libraries' own tests are a sixth of all and never run here.
find "$folder" -type d -name tests -path '*/site-packages/*' -prune -exec rm -rf {} +
# Good whatever a copy does to times; what lies in a read-only tree is not checked again.
"$folder/bin/python" -m compileall -q -j 0 --invalidation-mode unchecked-hash "$folder/lib"
"$folder/bin/mfcmt" warmup
