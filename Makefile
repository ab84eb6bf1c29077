# Every command a person or the build server needs. Each target sets up what it lacks.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# Errors alone: warnings are about the package index and this machine, not about Gridpose. No byte code, which Python
# writes itself for the modules that are imported.
PIP    := $(BIN)/python -m pip install -qq --no-compile --disable-pip-version-check
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Every start of a process would compile all sources anew: seconds each, and the tests start hundreds.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup setup-dev demo serve test test-all test-shapes check check-clients bench soak figures screenshots lock openapi examples clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 15

$(BIN)/.setup: requirements.txt pyproject.toml app/client/pyproject.toml
	$(PYTHON) -m venv $(VENV)
	@echo "installing packages into $(VENV)"
	$(PIP) --require-hashes -r requirements.txt
	$(PIP) --no-deps --no-build-isolation -e . ./app/client  # the latter has the command, which finds the former
	@touch $@

# Another version may have the same packages and other kernels. By content: files of an unpacked archive are as old as
# the version. Code that is compiled already is not compiled again, but to load all of it takes seconds.
KERNELS := $(BIN)/.kernels-$(shell find core -name '*.py' | LC_ALL=C sort | xargs cat | cksum | cut -d ' ' -f 1)

$(KERNELS): $(BIN)/.setup
	$(BIN)/python -m app.jobs.warm_up  # compiles the kernels, so that nobody waits for them later
	@rm -f $(BIN)/.kernels-*
	@touch $@

$(BIN)/.setup-dev: $(BIN)/.setup requirements-dev.txt
	$(PIP) --require-hashes -r requirements-dev.txt
	@touch $@

setup: $(BIN)/.setup $(KERNELS)  ## make .venv from the hashed requirements.txt

setup-dev: $(BIN)/.setup-dev $(KERNELS)  ## the same, with what tests and checks need

demo: setup  ## a rendered robot session through the service, against its truth
	$(BIN)/gridpose demo

serve: setup  ## run the service on this machine (data in ./gridpose-data)
	$(BIN)/gridpose serve --data-dir gridpose-data

test: setup-dev  ## every behaviour on small samples, in minutes
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow and not soak"

test-all: setup-dev test-shapes  ## the same at full size, long system tests, shapes of arrays
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not soak" --durations=25

test-shapes: setup-dev  ## core with shapes and types of arrays checked at run time
	GRIDPOSE_TEST_SHAPES=1 $(BIN)/python -m pytest -n auto --dist worksteal -m shapes tests/core tests/docs

check: setup-dev  ## format, lint, types, layers, words, sizes, openapi.json
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/faces.py
	$(BIN)/python .ci/vocabulary.py
	$(BIN)/python .ci/sizes.py
	$(BIN)/python -m app.cli.openapi --check

openapi: setup-dev  ## write openapi.json from the code
	$(BIN)/python -m app.cli.openapi

examples: setup-dev  ## record the examples of openapi.json; then `make openapi`
	$(BIN)/python -m tests.support.contract

check-clients: setup-dev  ## lint the contract, generate and try clients in 3 languages
	$(BIN)/python -m tests.clients

bench: setup-dev  ## measure; prints the table and writes benchmarks/RESULTS.md
	$(BIN)/python -m benchmarks

soak: setup-dev  ## long crash and fuzz runs, and the fault programme with its table
	$(BIN)/python -m pytest -m soak -p no:cacheprovider tests

figures: setup-dev  ## draw the figures of docs/ anew
	$(BIN)/python docs/figures/draw_architecture.py
	$(BIN)/python docs/figures/draw_detection.py
	$(BIN)/python docs/figures/draw_frames.py
	$(BIN)/python docs/figures/draw_reports.py
	$(BIN)/python docs/figures/draw_statements.py
	$(BIN)/python docs/figures/draw_targets.py
	$(BIN)/python docs/figures/draw_uncertainty.py

screenshots: setup-dev  ## take the screenshots of docs/dashboard.md, all pages in build/
	$(BIN)/python docs/figures/draw_dashboard.py

lock: setup-dev  ## renew the hashed requirements
	$(PIP) uv
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --extra build --extra postgres --extra s3 pyproject.toml -o requirements.txt
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --extra build --extra postgres --extra s3 --extra dev -c requirements.txt pyproject.toml -o requirements-dev.txt

clean:  ## remove .venv and caches
	rm -rf $(VENV) build/clients .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
