# Each target does all of its own set-up.
# Overrides: PYTHON= (3.11 or newer), VENV= (where the environment goes), WORKERS= (test files run at a time, 0: none; many wait),
# FUZZ= (campaigns and their options), ALL= (figures that take long, too), FRESH=1 (every command that a test runs is a
# new interpreter, not the copy of one that has imported the product: tests/warm_start.py).
PYTHON ?= python3
VENV ?= .venv
WORKERS ?= $(shell cores=$$(nproc); echo $$((cores < 7 ? cores + 2 : 8)))
python := $(VENV)/bin/python
ready := $(VENV)/.ready
folders := $(shell find player tools shaders calib_data -type d ! -name __pycache__ ! -path 'calib_data/example*')

# Where it is set, each of thousands of processes would compile every module that it reads.
export PYTHONDONTWRITEBYTECODE =

.DEFAULT_GOAL := help
# apt and pip are run one at a time, whatever -j says.
.NOTPARALLEL:
.PHONY: help play test lint types docs fuzz bench study hard-cases figures clean system-play system-test

help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' $(firstword $(MAKEFILE_LIST))

play: $(ready) ## see what it does: the shipped example, before and after
	$(python) -m counterlight example --folder calib_data/example

test: system-test $(ready) ## everything that must hold
	$(python) -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

lint: $(ready) ## style and types
	$(python) -m ruff check .
	$(python) -m ruff format --check .
	$(python) -m mypy

types: $(ready) ## types as a user's pyright sees them, in strict mode (300 MB)
	$(python) -m pip install --quiet --disable-pip-version-check -c constraints.txt basedpyright
	$(python) -m basedpyright

fuzz: system-test $(ready) ## campaigns of damage, kills and floods, minutes: FUZZ="kills --seed 7 --count 500"
	$(python) -m tests.fuzz $(FUZZ)

bench: $(ready) ## timings, next to scipy's on this machine
	$(python) -m tests.bench

study: $(ready) ## what accuracy costs in time: study/report.html
	$(python) -m counterlight study -o study

hard-cases: $(ready) ## how every method takes near-singular, contradictory and noisy systems
	$(python) -m tests.studies.hard_cases

docs: $(ready) ## the pages as a site: site/index.html
	$(python) -m pip install --quiet --disable-pip-version-check -c constraints.txt mkdocs-material mkdocstrings-python
	NO_MKDOCS_2_WARNING=1 $(python) -m mkdocs build

figures: $(ready) ## which figures of the pages are stale: minutes, ALL=1: hours
	$(python) -m tests.figures $(if $(ALL),--all)

clean: ## remove the environment and everything that was built
	[ ! -f $(VENV)/pyvenv.cfg ] || rm -rf $(VENV)
	rm -rf site study fuzz build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis calib_data/example
	find . -name __pycache__ -not -path './.git/*' -prune -exec rm -rf {} +

system-play system-test:
	@$(PYTHON) -B tools/system_packages.py $(@:system-%=%)

# --no-build-isolation: the constraints hold for setuptools, too. The strict install links to files: new ones need it again.
$(ready): pyproject.toml constraints.txt $(folders) | system-play
	$(PYTHON) -m venv $(VENV)
	$(python) -m pip install --disable-pip-version-check -c constraints.txt setuptools
	$(python) -m pip install --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[test,lint,study]' \
		--config-settings editable_mode=strict
	@touch $@
