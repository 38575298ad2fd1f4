# Every target makes .venv and installs what it needs first; that takes a few minutes, once.
PYTHON ?= python3.11
VENV   ?= .venv
BIN    := $(VENV)/bin
INSTALLED := $(VENV)/.installed

.PHONY: help demo test test-long coverage lint bench docs clean

help:  ## Say what the targets do
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/'

demo: $(INSTALLED)  ## Drive the occluded crossing, print the episodes, write runs/demo/report.html
	$(BIN)/aeb demo

test: $(INSTALLED)  ## Run all tests
	$(BIN)/python -m pytest

test-long: $(INSTALLED)  ## Run the tests that take long: many more random cases
	$(BIN)/python -m pytest -m long

coverage: $(INSTALLED)  ## Run all tests and show which lines and branches they miss
	$(BIN)/python -m pytest --cov --cov-report=term-missing

lint: $(INSTALLED)  ## Check style, types and the bundled knowledge bases
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/sfol check rules/
	$(BIN)/sfol fmt --check rules/
	$(BIN)/sfol lint rules/
	$(BIN)/sfol test rules/

bench: $(INSTALLED)  ## Measure the speed of every stage, in some fifteen minutes; prints JSON
	$(BIN)/sfol bench rules/aeb.yaml --json
	$(BIN)/python -m vsr.bench
	$(BIN)/aeb bench

docs: $(VENV)/.docs  ## Build the documentation into docs/_build
	$(BIN)/sphinx-build -W -b html docs docs/_build

clean:  ## Remove what the other targets made
	rm -rf $(VENV) runs docs/_build

$(INSTALLED): pyproject.toml constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
	  { echo "Python 3.11 is needed (pybullet has no wheel for newer ones): make PYTHON=/path/to/python3.11"; exit 1; }
	@echo "Installing into $(VENV); this takes a few minutes, once."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[aeb,pyreason,dev]'
	@touch $@

$(VENV)/.docs: $(INSTALLED)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	@touch $@
