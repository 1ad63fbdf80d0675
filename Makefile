# Sets up .venv once (again when pyproject.toml or constraints.txt change) and runs everything inside it.
VENV ?= .venv
PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3)
OUT ?= out
WORKERS ?= 2
ROOMS ?=
COUNT ?= 200
SEED ?= 0

PY := $(VENV)/bin/python
INSTALLED := $(VENV)/.installed
INSTALLED_DEV := $(VENV)/.installed-dev
# One thread of linear algebra in each test process: more of them fight over the cores.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: help demo test test-fast lint types docs commands wheel-check mutants quickstart clean

help:
	@echo "make demo         run the demonstration into $(OUT)/ (open $(OUT)/index.html)"
	@echo "make test         all tests"
	@echo "make test-fast    all tests but the slow ones"
	@echo "make lint         ruff: rules and formatting"
	@echo "make types        pyright"
	@echo "make docs         build the site into $(OUT)/docs; a broken link fails"
	@echo "make commands     write docs/command_line.md anew, from the program"
	@echo "make wheel-check  build wheel and sdist, compare with git, run the demo from the wheel in an empty folder"
	@echo "make mutants      try COUNT small changes of the code and count what the tests notice (ROOMS=\"camera detect\" SEED=1)"
	@echo "make quickstart   render again the capture that ships for the quick start"

demo: $(INSTALLED)
	$(PY) -m gfp_grasp.demo --out $(OUT)

test: $(INSTALLED_DEV)
	$(ONE_THREAD) $(PY) -m pytest -n $(WORKERS) --dist worksteal

test-fast: $(INSTALLED_DEV)
	$(ONE_THREAD) $(PY) -m pytest -n $(WORKERS) --dist worksteal -m "not slow"

lint: $(INSTALLED_DEV)
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .

types: $(INSTALLED_DEV)
	$(PY) -m pyright --pythonpath $(PY)

docs: $(INSTALLED_DEV)
	$(PY) -m sphinx -W --keep-going -q -b html docs $(OUT)/docs

commands: $(INSTALLED)
	$(PY) docs/command_line.py > docs/command_line.md

wheel-check: $(INSTALLED_DEV)
	$(PY) tests/wheel_check.py

mutants: $(INSTALLED_DEV)
	$(ONE_THREAD) $(PY) tests/mutants.py --count $(COUNT) --seed $(SEED) --jobs $(WORKERS) \
		$(if $(ROOMS),--rooms $(ROOMS),--json results/mutants.json)

quickstart: $(INSTALLED)
	$(PY) -m gfp_grasp.demo.quickstart

clean:
	rm -rf $(VENV) $(OUT) dist build

$(PY):
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || \
		{ echo "Python 3.11 or newer is needed; name one: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(INSTALLED): pyproject.toml constraints.txt | $(PY)
	$(PY) -m pip install --quiet -e . -c constraints.txt
	@touch $@

$(INSTALLED_DEV): pyproject.toml constraints.txt | $(PY)
	$(PY) -m pip install --quiet -e ".[dev]" -c constraints.txt
	@touch $@ $(INSTALLED)
