# Everything starts here: `make serve`, `make test`. Each target sets up what it needs: the packages that serving needs
# (requirements.lock), the reader of video files that `mfcmt track` needs (.ci/video.lock), and for tests and lint those
# of development besides (requirements-dev.lock).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SERVING := $(VENV)/.serving
DEVELOPMENT := $(VENV)/.development
VIDEO := $(VENV)/.video
NPM := $(addsuffix /node_modules/.package-lock.json,tests/service/generated tests/service/jsclient tests/service/jsclient/apps)
PEERS := .venv-peers/.installed
BRIDGES := .venv-bridges/.installed
CLUSTERS := .venv-clusters/.installed
DATA ?= $(or $(MFCMT_OTB_ROOT),../shared/data/otb)
PUBLISHED ?= $(wildcard $(dir $(DATA:/=))published)
PROTOCOL ?= ope,tre,sre
# Tests start hundreds of processes. Where Python is told to keep no bytecode, theirs is kept in .venv, not in the sources.
BYTECODE := $(if $(PYTHONDONTWRITEBYTECODE),env -u PYTHONDONTWRITEBYTECODE PYTHONPYCACHEPREFIX="$(CURDIR)/$(VENV)/bytecode")
# The tests of a file share its servers, so they run in one process. TESTS="-n 0" runs all in this one.
PYTEST := $(BYTECODE) $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder
LOCK := uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate -q -U

.PHONY: help setup warmup serve demo npm test test-fast test-docker fresh lint lock bench peers bridges clusters bench-peers eval reproduce guide clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

$(SERVING): requirements.lock pyproject.toml
	@sh .ci/venv "$(PYTHON)" "$(VENV)"
	@$(BIN)/python .ci/install.py requirements.lock
	@touch $@

$(DEVELOPMENT): requirements-dev.lock $(SERVING)
	@$(BIN)/python .ci/install.py requirements-dev.lock
	@touch $@

setup: $(DEVELOPMENT)  ## make .venv with all that development needs, from the lock files

$(VIDEO): .ci/video.lock $(SERVING)
	@$(BIN)/python .ci/install.py .ci/video.lock
	@touch $@

warmup: $(SERVING)  ## compile the kernels for this CPU (half a minute once, then nothing)
	@$(BIN)/mfcmt warmup

serve: $(VIDEO) warmup  ## run the tracking service on http://127.0.0.1:8000
	@$(BIN)/mfcmt serve

demo: $(VIDEO) warmup  ## open the page in the browser, with the sample clip running
	@$(BIN)/mfcmt demo

%/node_modules/.package-lock.json: %/package-lock.json
	@echo "npm ci in $*"
	@cd $* && npm ci --no-audit --no-fund --ignore-scripts --loglevel=error && touch node_modules/.package-lock.json || \
		echo "npm did not install them: the tests that need the packages of $* are skipped"

npm: $(NPM)  ## install the npm packages that tests need, from their lock files

test: $(DEVELOPMENT) $(NPM) warmup  ## run the tests, a process on each core; TESTS="tests/core -k geometry" for some
	$(PYTEST) $(TESTS)

test-fast: $(DEVELOPMENT) warmup  ## run the quick tests of every module, two to three minutes
	$(PYTEST) -p no:schemathesis -m "not slow and not docker" $(TESTS)

test-docker: $(DEVELOPMENT) warmup  ## build the image and run it; needs root, buildah, podman, runc, debootstrap
	$(BIN)/python -m pytest -m docker tests/docker

fresh:  ## run both commands in a new minimal Debian (SUITE=trixie); as root, needs debootstrap
	.ci/fresh $(SUITE)

lint: $(DEVELOPMENT)  ## ruff and mypy, and whether what is made from the protocol is fresh
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m tests.docs.protocol --check

bench: warmup  ## milliseconds a frame, stage by stage
	$(BIN)/mfcmt bench

$(PEERS): .ci/peers.lock pyproject.toml
	@sh .ci/venv "$(PYTHON)" .venv-peers
	@.venv-peers/bin/python .ci/install.py .ci/peers.lock
	@touch $@

peers: $(PEERS)  ## an environment of its own with OpenCV's contrib trackers and dlib

$(BRIDGES): .ci/bridges.lock pyproject.toml
	@sh .ci/venv "$(PYTHON)" .venv-bridges
	@.venv-bridges/bin/python .ci/install.py .ci/bridges.lock
	@touch $@

bridges: $(BRIDGES)  ## an environment of its own with the real clients and servers of docs/integrations.md, for tests

$(CLUSTERS): .ci/clusters.lock pyproject.toml
	@sh .ci/venv "$(PYTHON)" .venv-clusters
	@.venv-clusters/bin/python .ci/install.py .ci/clusters.lock
	@touch $@

clusters: $(CLUSTERS)  ## an environment of its own with Ray and Dask, for the tests of `mfcmt track --backend`

bench-peers: $(PEERS)  ## OpenCV's and dlib's trackers on the same frames in the same run
	.venv-peers/bin/mfcmt warmup
	.venv-peers/bin/mfcmt bench --peers

eval: warmup  ## score the tracker on OTB
	$(BIN)/mfcmt eval

reproduce: warmup $(PEERS)  ## the paper's section IV on DATA=folder (PUBLISHED=boxes, PROTOCOL=ope): docs/evaluation
	.venv-peers/bin/mfcmt eval --data "$(DATA)" --protocol $(PROTOCOL) --trackers opencv-csrt opencv-kcf opencv-mosse dlib
	$(BIN)/mfcmt eval --data "$(DATA)" --protocol $(PROTOCOL) --reproduce docs/evaluation $(if $(PUBLISHED),--published "$(PUBLISHED)")

guide: $(DEVELOPMENT)  ## write the tables of docs, and the types of mfcmt.d.ts, that come from the code
	$(BIN)/python -m tests.docs.tables
	$(BIN)/python -m tests.docs.protocol

lock:  ## refresh the lock files (needs uv)
	$(LOCK) pyproject.toml --extra dev -o requirements-dev.lock
	$(LOCK) pyproject.toml --extra service --extra otel --extra cluster --group editable -c requirements-dev.lock -o requirements.lock
	$(LOCK) pyproject.toml docker/build.in --extra service --extra otel --extra cluster -c requirements-dev.lock -o docker/requirements.lock
	$(LOCK) .ci/video.in -c requirements-dev.lock -o .ci/video.lock
	$(LOCK) .ci/peers.in -o .ci/peers.lock
	$(LOCK) .ci/bridges.in -o .ci/bridges.lock
	$(LOCK) pyproject.toml --extra ray --extra dask --extra video --group editable -c requirements-dev.lock -o .ci/clusters.lock

clean:  ## remove what the targets made
	rm -rf $(VENV) .venv-peers .venv-bridges .venv-clusters .mypy_cache .pytest_cache .ruff_cache .hypothesis results
	find mfcmt_core service tests -name __pycache__ -type d -prune -exec rm -rf {} +
