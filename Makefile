# `make demo` and `make test` are all that a newcomer needs; both make .venv first.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PYTEST := $(BIN)/python -m pytest -q

# Small matrices: more BLAS threads than one only get in each other's way.
export OPENBLAS_NUM_THREADS ?= 1
# The tests start Python hundreds of times: let it keep what it compiled, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install car lock demo test lint types layers docs media unit all-tests safety bench size clean
help:            ## this list
	@grep -hE '^[a-z]+: .*##|^[a-z]+:  +##' Makefile | sed 's/:.*##/\t/'

install: $(STAMP) ## make .venv and install steerd with its development tools
$(STAMP): pyproject.toml constraints.txt car.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "steerd needs Python 3.11 or newer; set one with: make PYTHON=python3.12 install"; exit 3; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
	  { rm -rf $(VENV); echo "could not make a virtual environment; on Debian/Ubuntu: sudo apt install python3-venv"; exit 3; }
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --progress-bar off --no-deps --require-hashes -r car.lock
	$(BIN)/python -m pip install --quiet --progress-bar off -c constraints.txt -e '.[bag,baselines]' --group dev --group docs
	@touch $(STAMP)

car:             ## make .venv with what drives a car, and nothing else: the locked versions, by hash
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --progress-bar off --no-deps --require-hashes -r car.lock
	$(BIN)/python -m pip install --quiet --progress-bar off --no-deps -e .

lock:            ## write car.lock anew: the newest versions of what drives a car, with hashes
	$(PYTHON) -m venv .lock
	.lock/bin/python -m pip install --quiet uv
	.lock/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --upgrade \
	  --group car --custom-compile-command 'make lock' -o car.lock
	rm -rf .lock

demo: install     ## drive 20 s of simulated figure-eight with a live status, record it
	$(BIN)/steerd run --sim --auto-arm --path figure8 --speed 1.5 --duration 20

test: install lint types layers docs all-tests ## everything that CI checks

lint: install     ## formatting and style
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: install    ## mypy --strict
	$(BIN)/mypy

layers: install   ## which room may import which
	$(BIN)/lint-imports --no-cache

docs: install     ## the site, into site/; a broken link or anchor is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

media: install    ## the pictures of README, site and tutorial, from their own commands (minutes; Chromium)
	$(BIN)/python docs/media.py
	$(BIN)/python -m benchmarks.pictures

unit: install     ## the quick tests, half a minute: no processes, no statistics, no whole commands
	$(PYTEST) -n 2 -m "not realtime and not slow" tests/unit

all-tests: install
	# By file: what a file's tests share (a drive, an identified car) is made once. Folders in their
	# order: whole commands and builds begin first, else one of them is what all wait for at the end.
	$(PYTEST) -n 2 --dist loadfile --no-loadscope-reorder -m "not realtime"
	# A machine that stalls for 30 ms rightly stops a car; such a drive is driven again, twice at most;
	# the run fails if more than a tenth of them needed that (tests/conftest.py).
	$(PYTEST) -m realtime --reruns 2

bench: install     ## measure everything; writes docs/results/performance.md (20 minutes)
	$(BIN)/python -m pip install --quiet --progress-bar off -c constraints.txt --group bench
	$(BIN)/python -m benchmarks.run

safety: install   ## all of the fault matrix and its real-time cells; writes the tables of the safety pages
	$(BIN)/python -m tests.safety.report
	STEERD_LIVE=all $(PYTEST) -m realtime --reruns 2 tests/safety

size: install     ## lines of each room against its goal; no room may grow
	$(BIN)/python -m tests.contract.size

clean:            ## remove what was made here
	rm -rf $(VENV) site .mypy_cache .ruff_cache .pytest_cache .hypothesis
