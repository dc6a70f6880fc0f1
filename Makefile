# Everything a person types. `make demo` and `make test` need Python from 3.11 on with its venv module, and nothing
# else; 3.11 is taken where it is found, for it is the last that PyBullet has a wheel for.
VENV := .venv
BIN := $(VENV)/bin
first_python = $(shell for name in python3.11 python3 python python3.14 python3.13 python3.12; do \
  $$name -c "import sys; sys.exit(not sys.version_info[:2] $(1))" 2>/dev/null && echo $$name && break; done)
PYTHON ?= $(or $(call first_python,== (3, 11)),$(call first_python,> (3, 11)))

# One process for the tests that start processes themselves, the others for the rest (tests/conftest.py).
IN_PARALLEL := -n auto --maxprocesses 4 --no-loadscope-reorder
# Half a minute of what does without PyBullet: the physics in MuJoCo, decoding, records, and a run to its end.
WITHOUT_BULLET := tests/protocol tests/worker/engines tests/coordinator/storage tests/system/test_without_bullet.py \
  $(wildcard $(addprefix tests/worker/test_,$(addsuffix .py,decoder evaluator physical_episode platform start)))
# A minute of what needs neither processes nor long simulations.
QUICK := tests/protocol tests/coordinator/scheduler tests/coordinator/storage tests/coordinator/recorder \
  tests/tools/local tests/tools/security tests/worker/test_decoder.py tests/worker/test_priors.py tests/test_repository.py

# Processes that test share the processors: threads of numpy in each would wait for those of the others.
test test-quick test-mujoco test-slow test-docs: export OMP_NUM_THREADS := 1
test test-quick test-mujoco test-slow test-docs: export OPENBLAS_NUM_THREADS := 1

# Without bytecode each of the processes that tests and the demo start would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-quick test-mujoco test-slow test-docs test-gpu check docs fuzz chaos simulate bench grasp-bench lock clean
help:
	@echo "make demo    the main job: fill an archive of grasps and draw them (runs/demo, ENGINE=mujoco)"
	@echo "make test    the test suite; make test-slow: more scenarios, some take minutes"
	@echo "make test-quick   a part of it that takes a minute and a half"
	@echo "make test-docs   every command of README.md and docs/, also those that take long"
	@echo "make test-mujoco   quick tests of what works without PyBullet; CI runs them in a later Python too (.ci/later)"
	@echo "make test-gpu    tests of the engine mujoco-warp, on warp's CPU device or that of QDGRASP_DEVICE (.venv-gpu)"
	@echo "make check   formatter, linter, types, imports between rooms, conventions of names and sizes"
	@echo "make docs    the documentation as a site: pages, API reference, gallery (.site/html/index.html)"
	@echo "make fuzz    a million changed messages: each is refused, or good still (MESSAGES=, SEED=)"
	@echo "make simulate   5000 histories of machines and links that fail, and what must always hold in them (HISTORIES=, FIRST=)"
	@echo "make chaos   ten runs whose processes are killed and stopped all the time, and scenarios (SEED=, EVALUATIONS=)"
	@echo "make bench   what evaluations, the search and a start cost on this machine"
	@echo "make grasp-bench   the runs of the frozen benchmark that are missing, and its table (docs/results.md)"
	@echo "make lock    write the lock files that images are built from (deploy/container)"
	@echo "make clean   remove the environment, the site and the caches of the tools"

demo: $(VENV)/.installed
	@$(BIN)/python -m docs.demo $(addprefix --engine ,$(ENGINE))

test: $(VENV)/.ready
	$(BIN)/python -m pytest $(IN_PARALLEL) -m "not slow"

test-quick: $(VENV)/.ready
	$(BIN)/python -m pytest $(IN_PARALLEL) -m "not slow" $(QUICK)

test-mujoco: $(VENV)/.ready
	$(BIN)/python -m pytest $(IN_PARALLEL) -m "not slow" $(WITHOUT_BULLET)

test-slow: $(VENV)/.ready
	$(BIN)/python -m pytest -m slow

test-docs: $(VENV)/.ready $(VENV)/.docs
	$(BIN)/python -m pytest tests/docs tests/examples

comma := ,
# In an environment of its own, which is large.
test-gpu:
	@$(MAKE) --no-print-directory VENV=.venv-gpu .venv-gpu/.gpu
	.venv-gpu/bin/python -m pytest tests/worker/engines

check: $(VENV)/.ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.conventions

docs: $(VENV)/.docs
	@$(BIN)/python docs/website/build.py --out .site

fuzz: $(VENV)/.ready
	@$(BIN)/python -m tests.fuzz --messages $(or $(MESSAGES),1000000) --seed $(or $(SEED),0)

chaos: $(VENV)/.ready
	@$(BIN)/python -m tests.chaos --out runs/chaos $(addprefix --seed ,$(SEED)) $(addprefix --evaluations ,$(EVALUATIONS))
	$(if $(SEED),,$(BIN)/python -m pytest tests/chaos)

simulate: $(VENV)/.ready
	@$(BIN)/python -m tests.simulation $(addprefix --histories ,$(HISTORIES)) $(addprefix --first ,$(FIRST))
	@$(if $(FIRST),,$(BIN)/python -m tests.simulation --mutations)

bench: $(VENV)/.ready
	@$(BIN)/python -m benchmarks

grasp-bench: $(VENV)/.ready
	@$(BIN)/python -m benchmarks.grasp_bench run

# Versions that are locked stay unless they must change; UPGRADE=--upgrade takes the latest.
LOCK = $(BIN)/uv pip compile --quiet --generate-hashes --only-binary :all: --python-version 3.11 --python-platform linux \
  --custom-compile-command "make lock" $(UPGRADE)
lock: $(VENV)/.ready
	$(LOCK) pyproject.toml --extra all --output-file deploy/container/requirements.txt
	$(LOCK) deploy/container/worker.in --constraints deploy/container/requirements.txt \
	  --output-file deploy/container/worker.txt
	$(LOCK) deploy/container/build.in --output-file deploy/container/build.txt

clean:
	rm -rf $(VENV) .venv-gpu .site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

define install
	@echo "Installing into $(VENV) (once; a minute or two) ..." >&2
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '$(1)' || { \
	  echo "The packages could not be installed: see pip's message above; it needs the network or a mirror." >&2; exit 2; }
	@touch $@
endef

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(call install,.)

$(VENV)/.ready: pyproject.toml | $(BIN)/python
	$(call install,.[dev])
	@touch $(VENV)/.installed

$(VENV)/.gpu: pyproject.toml | $(BIN)/python
	$(call install,.[dev$(comma)gpu])

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(call install,.[docs])
	@touch $(VENV)/.installed

$(BIN)/python:
	@test -n "$(PYTHON)" || { \
	  echo "qdgrasp needs Python 3.11 or later, and found none as python3.11, python3 or python;" \
	    "name it: make PYTHON=/path/to/python3.11 ..." >&2; exit 2; }
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info[:2] > (3, 11))" || \
	  echo "PyBullet has no wheel for $$($(PYTHON) --version): MuJoCo alone is there," \
	    "until '$(BIN)/pip install pybullet' has built it with a C++ compiler." >&2
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "$(PYTHON) could not make an environment in $(VENV); on Debian: apt install python3-venv" >&2; exit 2; }
