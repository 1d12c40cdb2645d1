# Everything sets itself up: a Debian machine with Python 3.11 or newer is enough.
BIN := .venv/bin
OUT ?= demo
# Tests are shared out among processes, file by file, long files first; SHARED= runs them one after the other.
# BLAS and compiled loops have one thread in each: where every core has a process, more threads only turn idly.
# CORE=Prescott computes as a processor of that core type does.
SHARED ?= -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder
SEED ?= 0
MINUTES ?= 10
# Installed without bytecode: unless Python may write it, every process that a test starts compiles all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-machines test-slow test-lowest check built-in attack bench evidence golden engines docs clean help

help:
	@echo "make demo        run all main steps on the built-in corpus, into $(OUT)/"
	@echo "make test        run the tests, all but the slow ones; CORE=Prescott: as a processor of that type computes"
	@echo "make test-slow   run the slow ones, and make all of the built-in library again to compare it"
	@echo "make test-machines run the tests as processors of other core types compute, with one thread and two: hours"
	@echo "make test-lowest run the tests with the oldest versions that pyproject.toml admits, in .venv-lowest"
	@echo "make check       ruff, mypy, import-linter, circular imports, spelling, formulas, built-in library"
	@echo "make built-in    make the built-in library, its map and calibrations again, from the files in MANIFOLD_RGL_DIR"
	@echo "make attack      changed files, models, libraries, scenes, fits, servers: SEED=0 MINUTES=10"
	@echo "make docs        the documentation site, into docs/_build/html; warnings are errors"
	@echo "make bench       speed as ratios, into benchmarks/results/"
	@echo "make evidence    the headline table of README, from the built-in library; DATA=FOLDER: all measured figures of the"
	@echo "                 documents, from the data in a folder"
	@echo "make engines     exports as Cycles, MaterialX, three.js and Adobe's OpenPBR draw them, into benchmarks/results/engines.json:"
	@echo "                 OPENPBR_BSDF=FOLDER names a checkout of github.com/adobe/openpbr-bsdf"
	@echo "make golden      which numbers of commands and calls moved since they were kept: KEEP=1 keeps them, ONLY=words"

# What the compiled loops are built from: a change installs the package again, which builds them.
LOOPS := setup.py $(wildcard cpp/*)

.venv/ready: pyproject.toml tools/setup.sh $(LOOPS)
	tools/setup.sh

.venv/readydev: pyproject.toml tools/setup.sh $(LOOPS)
	tools/setup.sh dev
	@touch .venv/ready

.venv/readydocs: pyproject.toml tools/setup.sh $(LOOPS)
	tools/setup.sh docs

demo: .venv/ready
	$(BIN)/manifold demo $(OUT)

test: .venv/readydev
	env $(if $(CORE),$$($(BIN)/python tools/other_machines.py --environment $(CORE))) OPENBLAS_NUM_THREADS=1 MANIFOLD_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" $(SHARED)

test-machines: .venv/readydev
	$(BIN)/python tools/other_machines.py -- -m "not slow" $(SHARED)

test-slow: .venv/readydev
	$(BIN)/python -m pytest -m slow
	$(BIN)/python tools/built_in.py --check

test-lowest: .venv/readydev
	$(BIN)/python -m venv .venv-lowest
	$(BIN)/python tools/lowest.py > .venv-lowest/lowest.txt
	.venv-lowest/bin/pip install --quiet --constraint .venv-lowest/lowest.txt --editable ".[dev]"
	OPENBLAS_NUM_THREADS=1 MANIFOLD_NUM_THREADS=1 .venv-lowest/bin/python -m pytest -m "not slow" $(SHARED)

check: .venv/readydev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/house.py --check
	$(BIN)/codespell *.md docs manifold cli tools benchmarks
	$(BIN)/python tools/prose.py
	$(BIN)/python tools/built_in.py --check --some

built-in: .venv/readydev
	$(BIN)/python tools/built_in.py

attack: .venv/readydev
	$(BIN)/python tools/attack --seed $(SEED) --minutes $(MINUTES) --flips 20000 --kills 200

bench: .venv/readydev
	$(BIN)/python benchmarks/run_all.py

DATA ?=

evidence: .venv/readydev
	$(BIN)/python benchmarks/run_all.py $(if $(DATA),--data $(DATA),built_in_readings built_in_held_out)
	$(if $(DATA),$(BIN)/python docs/figures.py,$(BIN)/python benchmarks/headline.py)

# One thread a process: two processes share the steps.
golden: .venv/readydev
	OPENBLAS_NUM_THREADS=1 MANIFOLD_NUM_THREADS=1 $(BIN)/python tools/golden $(if $(ONLY),--only "$(ONLY)") $(if $(KEEP),--keep)

.venv-engines/ready: tools/setup.sh
	tools/setup.sh engines

# A checkout of github.com/adobe/openpbr-bsdf, whose headers are compiled; it is not part of this repository.
OPENPBR_BSDF ?=

engines: .venv/readydev .venv-engines/ready
	OPENPBR_BSDF="$(OPENPBR_BSDF)" $(BIN)/python tools/engines

docs: .venv/readydocs
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs docs/_build/html

clean:
	rm -rf .venv .venv-lowest build dist *.egg-info
