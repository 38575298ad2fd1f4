# Every target makes .venv and installs what it needs first; that takes a few minutes, once.
PYTHON ?= python3.11
VENV   ?= .venv
BIN    := $(VENV)/bin
INSTALLED := $(VENV)/.installed
PIP    := $(BIN)/pip install --quiet --disable-pip-version-check
UV     := $(BIN)/uv pip install --quiet
MINUTES ?= 5
READERS ?= knowledge_base clause formula facts log
CORE_TESTS := tests/sfol tests/laws tests/test_imports.py -n 2 --passed-at-least 700

.PHONY: help demo test test-core test-lowest test-long fuzz coverage lint bench docs clean

help:  ## Say what the targets do
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/'

demo: $(INSTALLED)  ## Drive the occluded crossing, print the episodes, write runs/demo/report.html
	$(BIN)/aeb demo

test: $(INSTALLED)  ## Run all tests, in a process for each core
	$(BIN)/python -m pytest -n auto

test-core: $(addprefix test-core-,3.12 3.13) test-lowest  ## Test the core alone: on newer Pythons, with the lowest versions

# A Python is looked for on the path and among pyenv's; one that is not there is named and left out.
test-core-%: $(INSTALLED)
	@python=$$(for each in python$* $${PYENV_ROOT:-$$HOME/.pyenv}/versions/$*.*/bin/python; do \
	    $$each -c '' 2>/dev/null && echo $$each; done | tail -1); \
	if [ -z "$$python" ]; then echo "There is no Python $* here: the core is not tested on it."; exit 0; fi; \
	echo "The core alone on $$($$python --version):" && \
	$(BIN)/uv venv --quiet --clear --python $$python $(VENV)/core-$* && \
	$(UV) --python $(VENV)/core-$* --constraint constraints.txt --editable '.[core-tests]' && \
	$(VENV)/core-$*/bin/python -m pytest $(CORE_TESTS)

test-lowest: $(INSTALLED)
	@echo "The core alone, with the lowest versions that pyproject.toml allows:"
	@$(BIN)/uv venv --quiet --clear --python $(BIN)/python $(VENV)/core-lowest
	@$(UV) --python $(VENV)/core-lowest --resolution lowest-direct --editable '.[core-tests]'
	@$(VENV)/core-lowest/bin/python -m pytest $(CORE_TESTS)

test-long: $(INSTALLED)  ## Run the tests that take long: many more random cases
	$(BIN)/python -m pytest -m long

fuzz: $(INSTALLED)  ## Look for inputs that crash a reader: MINUTES=5 for each of READERS
	$(UV) --python $(VENV) --constraint constraints.txt --editable '.[fuzz]'
	@for reader in $(READERS); do \
	    echo "$$reader:" && $(BIN)/python -m tests.fuzz $$reader runs/fuzz $(MINUTES) || exit 1; \
	done

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

docs: $(INSTALLED)  ## Build the documentation into docs/_build
	$(BIN)/sphinx-build -W -b html docs docs/_build

clean:  ## Remove what the other targets made
	rm -rf $(VENV) runs docs/_build

$(INSTALLED): pyproject.toml hatch_build.py constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
	  { echo "Python 3.11 is needed (pybullet has no wheel for newer ones): make PYTHON=/path/to/python3.11"; exit 1; }
	@echo "Installing into $(VENV); this takes a few minutes, once."
	$(PYTHON) -m venv $(VENV)
	$(PIP) --no-deps --require-hashes --requirement constraints.txt
	$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

.PHONY: constraints
constraints: $(INSTALLED)  ## Write constraints.txt anew: the newest versions that fit together, with hashes
	$(BIN)/uv pip compile pyproject.toml --extra aeb --extra pyreason --extra dev --extra docs \
	  --universal --python-version 3.11.9 --generate-hashes --no-annotate --quiet \
	  --custom-compile-command 'make constraints' --output-file constraints.txt
