# make demo    reconstruct, score and draw a built-in sequence, into demo-output/
# make test    every test
# make results every experiment of the paper, into experiments-output/ and docs/results.md (DATA=folder of data sets)
# make bench   targets, speed and memory, measured again, into docs/benchmarks.md
# make lint    format, rules and types
# make clean   remove the environment and every output
#
# Each makes .venv first if it is not there, with a Python of 3.11 or later; PYTHON=... chooses another one.

PYTHON ?= $(shell for python in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$python; break; fi; done)
VENV := .venv
BIN := $(VENV)/bin

.PHONY: help demo test results bench lint format clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: $(VENV)/installed
	$(BIN)/nrsfm demo --out demo-output --overwrite

test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist loadfile

DATA ?= $(or $(NRSFM_DATA),$(wildcard ../shared/data))
results: $(VENV)/installed
	$(BIN)/nrsfm experiment all $(if $(DATA),--data $(DATA)) --page docs/results.md

bench: $(VENV)/installed-dev
	$(BIN)/python -m benchmarks

lint: $(VENV)/installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/installed-dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) build dist demo-output experiments-output bench-output src/nrsfm.egg-info
	rm -rf .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find src tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps say what the environment holds, so that nothing is installed twice; a changed pyproject.toml undoes them.
$(VENV)/made:
	@if [ -z "$(PYTHON)" ] || ! $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
		echo "nrsfm needs Python 3.11 or later, and '$(or $(PYTHON),python3)' is not one (make PYTHON=/path/to/python ...)" >&2; \
		exit 1; \
	fi
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/installed: $(VENV)/made pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/installed-dev: $(VENV)/made pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@ $(VENV)/installed
