# Each target installs what it needs into $(VENV), again only when pyproject.toml or constraints.txt changed.
PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2
BIN := $(VENV)/bin
TYPED := build/typed
# setuptools warns of every editable install; nothing of ours is imported by accident of the working folder.
PIP := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
# One process a core: the numerical libraries must not start threads of their own on top.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1

.PHONY: demo test test-full lint bench fuzz install install-dev clean

demo: install
	$(BIN)/smts-validate ingest data_samples/field1 -o logs
	$(BIN)/smts-validate run logs/field1.mcap

test: install-dev
	$(BIN)/python -m pytest -m "not full" -n $(JOBS) --dist loadfile $(ARGS)

test-full: install-dev
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile $(ARGS)

lint: install-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	rm -rf build/lib $(TYPED)
	$(PIP) --no-deps --upgrade --target $(TYPED) .
	MYPYPATH=$(TYPED) $(BIN)/mypy --strict -p smts_validate

bench: install-dev
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

FUZZ_SECONDS ?= 60
fuzz: install-fuzz
	$(BIN)/python fuzz/run.py --seconds $(FUZZ_SECONDS)

install: $(VENV)/.compiled
install-dev: $(VENV)/.installed-all $(VENV)/.compiled
install-fuzz: $(VENV)/.installed-fuzz

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed (PYTHON=python3.11 make ...)")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed-run: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e .
	touch $@

$(VENV)/.installed-all: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e ".[all]"
	touch $@ $(VENV)/.installed-run

# Compiled code is kept on disk beside the sources: made here, so that the first run is as quick as the next.
$(VENV)/.compiled: | $(VENV)/.installed-run
	@echo "compiling (once)"; mkdir -p build
	@$(BIN)/smts-validate run data_samples/field1 -o build/compiled >build/compiled.log 2>&1 || { cat build/compiled.log; exit 1; }
	touch $@

$(VENV)/.installed-fuzz: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e ".[all,fuzz]"
	touch $@ $(VENV)/.installed-all $(VENV)/.installed-run

clean:
	rm -rf build dist logs results *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
