# Every command a person or the build server needs. Each target sets up what it lacks.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help setup setup-dev demo serve test check bench soak pictures lock openapi clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(BIN)/.setup: requirements.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	$(BIN)/python -m app.jobs.warm_up  # compiles the kernels, so that nobody waits for them later
	@touch $@

$(BIN)/.setup-dev: $(BIN)/.setup requirements-dev.txt
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements-dev.txt
	@touch $@

setup: $(BIN)/.setup  ## make .venv from the hashed requirements.txt

setup-dev: $(BIN)/.setup-dev  ## the same, with what tests and checks need

demo: setup  ## a rendered robot session through the real service, compared with its truth
	$(BIN)/gridpose demo

serve: setup  ## run the service on this machine (data in ./gridpose-data)
	$(BIN)/gridpose serve --data-dir gridpose-data

test: setup-dev  ## every test but the soak runs
	$(BIN)/python -m pytest -n auto -m "not soak"

check: setup-dev  ## format, lint, types, layers, and the committed openapi.json
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m app.cli.openapi --check

openapi: setup-dev  ## write openapi.json from the code
	$(BIN)/python -m app.cli.openapi

bench: setup-dev  ## measure; prints the table and writes benchmarks/RESULTS.md
	$(BIN)/python -m benchmarks

soak: setup-dev  ## long crash and fuzz runs
	$(BIN)/python -m pytest -m soak -p no:cacheprovider tests

pictures: setup-dev  ## draw the pictures of docs/ anew
	$(BIN)/python docs/pictures/draw_detection.py
	$(BIN)/python docs/pictures/draw_frames.py
	$(BIN)/python docs/pictures/draw_targets.py

lock: setup-dev  ## renew the hashed requirements
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --extra build --extra postgres pyproject.toml -o requirements.txt
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --extra build --extra postgres --extra dev -c requirements.txt pyproject.toml -o requirements-dev.txt

clean:  ## remove .venv and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
