# Two commands on a fresh clone, with nothing but Python 3.11 or later: make demo, make test.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# One thread each: two BLAS or OpenMP threads can be many times slower on a small machine.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export OMP_WAIT_POLICY ?= passive
# Tests begin many processes: each would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE

PYTEST := $(BIN)/python -m pytest
TWO := -n 2 --dist loadscope --no-loadscope-reorder
QUICK := -m "not slow and not nightly and not real"
# `make test` is two processes, each of which reads and runs half of the tests, so that nothing is
# made twice. In the first half annotations are checked where shapes are the subject.
SHAPES := design dynamics effects robot statistics
HALF := $(addprefix tests/,$(SHAPES) excitation export extraction feasibility identification log parallel simulation \
  simulators torchid_study/equal_torque/test_sample.py torchid_study/wrenches wrenches \
  test_types_are_checked.py)
PACKAGES := torchid torchid_study torchid_bench
SHELL := bash
.SHELLFLAGS := -o pipefail -c

.PHONY: demo test test-one test-two test-slow nightly zoo controls golden durations coverage lint format docs notebooks docs-site fuzz test-lowest test-newest bench clean

demo: $(VENV)/.core
	$(BIN)/torchid demo --out demo

# The quick round: five minutes on two slow cores.
test: $(VENV)/.dev
	@$(MAKE) --no-print-directory --jobs 2 test-one test-two

test-one: $(VENV)/.dev
	@TORCHID_TYPES="$(addprefix torchid.,$(SHAPES))" $(PYTEST) $(QUICK) $(HALF) | sed -u 's/^/1 | /'

test-two: $(VENV)/.dev
	@$(PYTEST) $(QUICK) $(addprefix --ignore=,$(HALF)) | sed -u 's/^/2 | /'

# What only longer tests cover: real logs, MuJoCo plants, README and tutorial.
test-slow: $(VENV)/.dev
	$(PYTEST) $(TWO) -m "(slow or real) and not nightly"

# All that takes longer: types in every quick test, rates over hundreds of runs. Property
# tests draw from a seed of the day, which pytest prints; SEED=20261126 repeats that night's. At the
# end stands which answers, of the zoo too, break a rule of what is said of them.
nightly: SEED ?= $(shell date +%Y%m%d)
nightly: $(VENV)/.dev
	TORCHID_TYPES="torchid torchid_study torchid_bench.withheld" $(PYTEST) $(TWO) $(QUICK) --hypothesis-seed=$(SEED)
	TORCHID_SEED=$(SEED) $(PYTEST) $(TWO) -m nightly --hypothesis-seed=$(SEED)
	$(MAKE) --no-print-directory zoo
	$(BIN)/python -m tests.golden.sentences -v
	$(MAKE) --no-print-directory controls

# Public logs of real arms, with the commands that their owners would type and what is known of them:
# half an hour of CPU, and one line where the logs are absent. What is in build/zoo is not run again; an
# answer that is surely wrong, a good log refused, and a crash are errors. ROWS=emps,kuka are some.
zoo: $(VENV)/.dev
	$(BIN)/python -m torchid_bench.benchmarks.zoo --jobs $(shell nproc) --page docs/zoo.md $(if $(ROWS),--rows $(ROWS))

# What is named of healthy arms of which nothing has changed: models of one log, asked of another, of the
# zoo's logs; some 40 minutes of CPU. What is in build/controls is not asked again; a new name, and a
# diagnosis that failed, are errors. ROWS=ur10e,emps are some arms.
controls: $(VENV)/.dev
	$(BIN)/python -m torchid_bench.benchmarks.controls --jobs $(shell nproc) --page docs/controls.md $(if $(ROWS),--rows $(ROWS))

# Answers to twelve small logs beside the stored ones: code that was only moved changes none of them.
golden: $(VENV)/.dev
	$(BIN)/python -m tests.golden.answers $(if $(WRITE),--write) $(NAMES)

# CPU seconds of each test, on an idle machine, into tests/durations.md: half an hour and more.
durations: $(VENV)/.dev
	rm -rf build/durations
	$(PYTEST) $(TWO) -p tests.durations
	$(BIN)/python -m tests.durations

coverage: $(VENV)/.dev
	$(PYTEST) $(TWO) $(QUICK) $(addprefix --cov=,$(PACKAGES)) --cov-branch --cov-report=term

# The same with other versions of what torchid needs: the lowest that pyproject.toml allows, and the
# newest that there are, each in an environment of its own. TORCH=torch==2.13.0 takes that torch;
# TESTS=tests/log a part of the tests.
test-lowest test-newest: test-%: build/%/.made
	build/$*/bin/python -m pytest $(TWO) $(QUICK) $(TESTS)

build/lowest/.made build/newest/.made: build/%/.made: pyproject.toml
	$(PYTHON) -m venv build/$*
	$(PYTHON) -m tests.versions $* $(TORCH) > build/$*/constraints.txt
	build/$*/bin/python -m pip install --quiet -c build/$*/constraints.txt -e '.[dev]'
	@touch $@

# Damaged files for every reader; what fails is kept in tests/robustness/corpus.
fuzz: $(VENV)/.dev
	$(BIN)/python -m tests.robustness.fuzz --minutes $(or $(MINUTES),60) --seed $(or $(SEED),0)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.rooms

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.dev
	$(BIN)/python docs/draw_effects.py
	$(BIN)/python docs/draw_concepts.py
	PYTHONPATH=. $(BIN)/python docs/draw_house.py

# Runs the notebooks and stores what they print and draw: minutes. NAMES="03 05" are some.
notebooks: $(VENV)/.dev
	$(BIN)/python -m tests.notebooks $(NAMES)

docs-site: $(VENV)/.dev
	$(BIN)/python -m sphinx -b html -E -W --keep-going -q -c docs . build/site

# Torchid beside its peers, a minute or two; what became a fifth slower than torchid_bench/benchmarks/ratios.json is printed.
bench: $(VENV)/.dev
	$(BIN)/python -m torchid_bench.benchmarks.ratios

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
