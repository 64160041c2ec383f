# Everything starts here: `make serve`, `make test`. Each target sets up what it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PEERS := .venv-peers/.installed
DATA ?= $(or $(MFCMT_OTB_ROOT),../shared/data/otb)
PUBLISHED ?= $(wildcard $(dir $(DATA:/=))published)
PROTOCOL ?= ope,tre,sre

.PHONY: help setup warmup serve demo test lint lock bench peers bench-peers eval reproduce guide clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

$(STAMP): requirements.lock pyproject.toml
	@sh .ci/venv "$(PYTHON)" "$(VENV)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

setup: $(STAMP)  ## make .venv from the lock file

warmup: $(STAMP)  ## compile the kernels for this CPU (about a minute once, then nothing)
	@$(BIN)/mfcmt warmup

serve: warmup  ## run the tracking service on http://127.0.0.1:8000
	$(BIN)/mfcmt serve

demo: warmup  ## open the page in the browser, with the sample clip running
	$(BIN)/mfcmt demo

test: warmup  ## run the tests
	$(BIN)/python -m pytest

lint: $(STAMP)  ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: warmup  ## milliseconds a frame, stage by stage
	$(BIN)/mfcmt bench

$(PEERS): .ci/peers.lock $(STAMP)
	@sh .ci/venv "$(PYTHON)" .venv-peers
	.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r .ci/peers.lock
	.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

peers: $(PEERS)  ## an environment of its own with OpenCV's contrib trackers and dlib

bench-peers: $(PEERS)  ## OpenCV's and dlib's trackers on the same frames in the same run
	.venv-peers/bin/mfcmt warmup
	.venv-peers/bin/mfcmt bench --peers

eval: warmup  ## score the tracker on OTB
	$(BIN)/mfcmt eval

reproduce: warmup $(PEERS)  ## the paper's section IV on DATA=folder (PUBLISHED=boxes, PROTOCOL=ope): docs/evaluation
	.venv-peers/bin/mfcmt eval --data "$(DATA)" --protocol $(PROTOCOL) --trackers opencv-csrt opencv-kcf opencv-mosse dlib
	$(BIN)/mfcmt eval --data "$(DATA)" --protocol $(PROTOCOL) --reproduce docs/evaluation $(if $(PUBLISHED),--published "$(PUBLISHED)")

guide: $(STAMP)  ## write the tables of docs/operations.md that come from the code
	$(BIN)/python -m tests.docs.tables

lock:  ## refresh the lock files (needs uv)
	uv pip compile pyproject.toml --all-extras --universal --python-version 3.11 --generate-hashes --no-header --no-annotate -q -U -o requirements.lock
	uv pip compile pyproject.toml docker/build.in --extra service --extra otel --universal --python-version 3.11 --generate-hashes --no-header --no-annotate -q -U -c requirements.lock -o docker/requirements.lock
	uv pip compile .ci/peers.in --universal --python-version 3.11 --generate-hashes --no-header --no-annotate -q -U -o .ci/peers.lock

clean:  ## remove what the targets made
	rm -rf $(VENV) .venv-peers .mypy_cache .pytest_cache .ruff_cache .hypothesis results
	find mfcmt_core service tests -name __pycache__ -type d -prune -exec rm -rf {} +
