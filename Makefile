# Everything a person types. `make demo` and `make test` need nothing but Python 3.11 and its venv module.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test test-slow check bench clean
demo: $(READY)
	$(BIN)/python -m qdgrasp_coordinator.demo

test: $(READY)
	$(BIN)/pytest -m "not slow" --ignore=tests/benchmarks

test-slow: $(READY)
	$(BIN)/pytest -m slow --ignore=tests/benchmarks

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(READY)
	$(BIN)/python -m tests.benchmarks

$(READY): pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "qdgrasp needs Python 3.11, found none as '$(PYTHON)'; name it: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
