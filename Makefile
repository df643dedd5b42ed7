# Everything happens in .venv; the only thing needed beforehand is Python 3.11 or newer.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
.DEFAULT_GOAL := help
.PHONY: help demo test test-slow check docs clean

help:            ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

$(VENV)/run.stamp: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("longreach needs Python 3.11 or newer; this is " + sys.version.split()[0]) if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[server]'
	touch $@

$(VENV)/dev.stamp: pyproject.toml $(VENV)/run.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test,dev]'
	touch $@

$(VENV)/docs.stamp: pyproject.toml $(VENV)/run.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

# What is compiled already, for these sources and this processor, is not compiled again.
demo: $(VENV)/run.stamp  ## simulated machine, server and panel; prints the address
	$(BIN)/longreach compile
	$(BIN)/longreach demo

# One thread each: workers that share the cores wait for each other's BLAS threads.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1

# Compiled first, by two processes and once: else every worker compiles the same at the same time.
# Files by name: sorted by number of tests, xdist's default, files of one long test would come last, on one core.
test: $(VENV)/dev.stamp  ## all tests but the slow ones: on all cores, then those in real time one by one
	$(BIN)/longreach compile
	$(ONE_THREAD) $(BIN)/python -m pytest -m "not slow and not real_time" -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder --durations 20
	$(BIN)/python -m pytest -m "real_time and not slow" --durations 20 tests/loop tests/system

test-slow: $(VENV)/dev.stamp  ## compose, long drills
	$(BIN)/python -m pytest -m slow

PRODUCT := longreach server web diagnosis sim_plc machine recording protocol

check: $(VENV)/dev.stamp  ## format, lint, types, import contracts, language, spelling
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/basedpyright --threads 2
	$(BIN)/lint-imports
	$(BIN)/python tools/language.py
	$(BIN)/codespell README.md CHANGELOG.md CONTRIBUTING.md docs $(PRODUCT) benchmarks examples tools

docs: $(VENV)/docs.stamp  ## the documentation as a site: build/site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --clean

clean:           ## forget the environment
	rm -rf $(VENV)
