# One entry for everything. A fresh Debian with python3 (3.11 or newer), git and make is enough to start.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.NOTPARALLEL:

# The first of these that is Python 3.11 or newer builds the virtual environment; `make PYTHON=… setup` chooses.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo "$$p"; break; }; done)
# Many tests wait for a device or a browser: one process more than there are cores keeps these busy. Each begins with a stretch of
# the list of its own, so that what a module prepares is seldom prepared twice.
PYTEST_FLAGS ?= -n $(shell echo $$(( $$(nproc) < 3 ? $$(nproc) + 1 : 4 ))) --dist worksteal

# Every path is relative, so that the folder's own name may hold spaces.
BIN := .venv/bin
PIP_INSTALL := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check --constraint constraints.txt
# The glass hemisphere of the paper, with 2,696 small photos: half a minute of simulation on two cores.
DEMO_SCENE := hemisphere --size 240 --display-columns 1536 --width-px 24 --step-px 4
COMMANDS_PAGE := docs/reference/commands.md
# Scripts of tests/bench that count faults by the hundred and take from minutes to an hour.
ENDURANCE := camera_soak kill_captures kill_wire_captures cut_power fill_disk quiet_captures random_captures

.PHONY: help setup demo test check lint format bench endurance docs commands picture clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*## ' Makefile | sed -E 's/^([a-z]+):[^#]*## (.*)/make \1\t\2/' | expand -t 16

setup: .venv/full.stamp  ## build .venv with everything that tests, style checks and documentation need

demo: .venv/core.stamp  ## a simulated capture, its reconstruction, and a report to look at
	@rm -rf demo
	$(BIN)/rig simulate $(DEMO_SCENE) demo/session
	$(BIN)/recon run demo/session --out demo/result
	$(BIN)/recon evaluate demo/result --truth demo/session --primitive sphere --known-radius 27.99
	@echo "Open demo/result/report.html in a browser; demo/result/mesh.glb in any 3-D viewer."

test: .venv/full.stamp  ## run the tests
	$(BIN)/python -m pytest $(PYTEST_FLAGS)

check: lint test docs  ## everything that must hold before a commit: lint, test and docs

lint: .venv/full.stamp  ## formatting, style, types, import contracts
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m ruff check .
	$(BIN)/python -m mypy
	$(BIN)/lint-imports

format: .venv/full.stamp  ## put the sources into the project's format
	$(BIN)/python -m ruff format .
	$(BIN)/python -m ruff check --fix .

bench: .venv/full.stamp  ## measure time and peak memory; `recon bench` and each script in tests/bench print JSON
	@echo "# recon bench"
	$(BIN)/recon bench
	@for script in tests/bench/*.py; do \
		name="$$(basename "$$script" .py)"; \
		case " $(ENDURANCE) " in *" $$name "*) continue;; esac; \
		case "$$name" in _*) continue;; esac; \
		echo "# $$name"; \
		$(BIN)/python -m "tests.bench.$$name"; \
	done

endurance: .venv/full.stamp  ## kill, starve and spoil captures by the hundred; takes an hour or two
	@for name in $(ENDURANCE); do echo "# $$name"; $(BIN)/python -m "tests.bench.$$name"; done

docs: .venv/full.stamp  ## build the documentation site into docs/_build/html; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "documentation: docs/_build/html/index.html"

commands: .venv/full.stamp  ## write docs/reference/commands.md from the programs' own help
	$(BIN)/python docs/render_commands.py $(COMMANDS_PAGE)

picture: .venv/full.stamp  ## make the pictures of README.md from a simulated scan
	$(BIN)/python docs/images/make_readme_picture.py

clean:  ## remove everything that these targets made
	rm -rf .venv demo docs/_build build .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# What `demo` needs: the programs alone.
.venv/core.stamp: .venv/made.stamp pyproject.toml constraints.txt
	@echo "installing into .venv (once; a few hundred MB to fetch) ..."
	@$(PIP_INSTALL) --editable .
	@touch $@

# What developers need as well; it contains the core, so `demo` installs nothing after it.
.venv/full.stamp: .venv/made.stamp pyproject.toml constraints.txt
	@echo "installing into .venv with devices, tests and documentation (once) ..."
	@$(PIP_INSTALL) --editable '.[rig,cluster,raw,dev,docs]'
	@touch .venv/core.stamp $@

# Debian ships Python without venv's half that installs pip; fetch it where we may, else say so in one sentence.
.venv/made.stamp:
	@if [ -z "$(PYTHON)" ]; then \
		echo "Python 3.11 or newer was not found; install it (Debian: apt-get install python3), or run: make PYTHON=/path/to/python setup" >&2; \
		exit 1; \
	fi
	@if ! "$(PYTHON)" -c 'import venv; from ensurepip import version' 2>/dev/null; then \
		if [ "$$(id -u)" = 0 ]; then as_root=(env); \
		elif command -v sudo >/dev/null && { [ -t 0 ] || sudo -n true 2>/dev/null; }; then as_root=(sudo); \
		else as_root=(); fi; \
		if [ $${#as_root[@]} = 0 ] || ! command -v apt-get >/dev/null; then \
			echo "$(PYTHON) cannot make virtual environments; install its venv module (Debian: sudo apt-get install python3-venv) and run make again." >&2; \
			exit 1; \
		fi; \
		echo "installing python3-venv ..."; \
		"$${as_root[@]}" apt-get -qq update; \
		"$${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq install --yes python3-venv >/dev/null; \
		"$(PYTHON)" -c 'import venv; from ensurepip import version' 2>/dev/null || { \
			echo "$(PYTHON) still cannot make virtual environments: it is not Debian's own; run: make PYTHON=/usr/bin/python3 setup" >&2; exit 1; }; \
	fi
	@"$(PYTHON)" -m venv .venv
	@touch $@
