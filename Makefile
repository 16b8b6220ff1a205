# Two commands on a fresh clone, with nothing but Python 3.11 or later: make demo, make test.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# One thread each: two BLAS or OpenMP threads can be many times slower on a small machine.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export OMP_WAIT_POLICY ?= passive

.PHONY: demo test test-types test-slow test-all test-real test-lowest test-newest calibration fuzz lint format docs docs-site bench clean

demo: $(VENV)/.core
	$(BIN)/torchid demo --out demo

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not real and not calibration"

# The same with types checked in every test of them, not in one of four.
test-types: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not real and not calibration" --all-types

# Those that take longer; no types are checked in them.
test-slow: $(VENV)/.dev
	JAXTYPING_DISABLE=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "(slow or real) and not calibration"

test-all: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not calibration"

test-real: $(VENV)/.dev
	$(BIN)/python -m pytest -m real

# The same with other versions of what torchid needs: the lowest that pyproject.toml allows, and the
# newest that there are, each in an environment of its own. TORCH=torch==2.13.0 takes that torch;
# TESTS=tests/log a part of the tests.
test-lowest test-newest: test-%: build/%/.made
	build/$*/bin/python -m pytest -n 2 --dist worksteal -m "not slow and not real and not calibration" $(TESTS)

build/lowest/.made build/newest/.made: build/%/.made: pyproject.toml
	$(PYTHON) -m venv build/$*
	$(PYTHON) -m tests.versions $* $(TORCH) > build/$*/constraints.txt
	build/$*/bin/python -m pip install --quiet -c build/$*/constraints.txt -e '.[dev]'
	@touch $@

# Damaged files for every reader; what fails is kept in tests/robustness/corpus.
fuzz: $(VENV)/.dev
	$(BIN)/python -m tests.robustness.fuzz --minutes $(or $(MINUTES),60) --seed $(or $(SEED),0)

calibration: $(VENV)/.dev
	JAXTYPING_DISABLE=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m calibration

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.dev
	$(BIN)/torchid effects --out docs
	$(BIN)/python docs/draw_concepts.py

docs-site: $(VENV)/.dev
	$(BIN)/python -m sphinx -b html -E -W --keep-going -q -c docs . build/site

# Torchid beside its peers, a minute or two; what became a fifth slower than benchmarks/ratios.json is printed.
bench: $(VENV)/.dev
	$(BIN)/python benchmarks/ratios.py --compile

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "torchid needs Python 3.11 or later; $(PYTHON) is $$($(PYTHON) --version). Try: make PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.core: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	@touch $@

$(VENV)/.dev: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev]'
	@touch $@ $(VENV)/.core

clean:
	rm -rf build demo .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
