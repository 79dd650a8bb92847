# `make demo` and `make test` need Python 3.10 to 3.14 with venv, on Linux x86-64; the rest they fetch into .venv.

PYTHON ?= python3
PY := .venv/bin/python
# Given after the command of a target, as in: make test ARGS="-k friction"
ARGS ?=
# How long the fuzz suite runs.
MINUTES ?= 2

.PHONY: help demo reproduce test test-slow fuzz lint bench bench-bags docs evidence clean
.DEFAULT_GOAL := help

# A ROS installation or another environment around us would mix its libraries with ours.
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH VIRTUAL_ENV
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

help:
	@echo "make demo       run the rig from quiet sliding into squeal; leaves a bag and a picture in bags/"
	@echo "make reproduce  the paper's figures and tables beside its numbers; leaves reproduction/"
	@echo "make test       run the tests (ARGS: options for pytest)"
	@echo "make test-slow  what starts and ends processes many times: signals, sessions that are gone, rigs of one name"
	@echo "make fuzz       inputs that nobody means well, for two minutes (MINUTES=30: for longer); fuzz_findings/ has what it finds"
	@echo "make lint       check style, types and imports"
	@echo "make bench      measure speed against peers, and the live node; writes docs/benchmarks.md"
	@echo "                ARGS=engine, ARGS=cycles or ARGS=nodes for one of them, ARGS=\"nodes --minutes 10\" for the long run"
	@echo "make bench-bags long series of tests of bags; recording, replay, export at full load (half an hour)"
	@echo "make docs       write docs/parameters.md anew from the code"
	@echo "make evidence   search anew for docs/evidence/*.csv, half an hour"
	@echo "make clean      remove .venv, caches and build output; recordings stay"
	@echo "Another Python: make PYTHON=python3.12 ..."

demo: .venv/.ready
	.venv/bin/squeal-rig demo $(ARGS)

reproduce: .venv/.ready
	.venv/bin/squeal-rig reproduce $(ARGS)

# What computes runs on two cores; what starts ROS graphs, five processes and more each, one after another.
GRAPHS := tests/nodes tests/system tests/bags

test: .venv/.ready
ifeq ($(ARGS),)
	$(PY) -m pytest -n 2 --dist loadfile $(addprefix --ignore=,$(GRAPHS))
	$(PY) -m pytest $(GRAPHS)
else
	$(PY) -m pytest $(ARGS)
endif

test-slow: .venv/.ready
	$(PY) -m pytest -m slow $(ARGS)

# One command after another and one graph, so that a deadline is one of the input and not of the machine.
fuzz: .venv/.ready
	$(PY) -m tests.fuzz --minutes $(MINUTES) $(ARGS)

bench: .venv/.bench
	$(PY) -m benchmarks $(ARGS)

lint: .venv/.lint
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	$(PY) -m mypy
	.venv/bin/lint-imports

bench-bags: .venv/.ready
	$(PY) -m pytest -m bench -s tests/recording tests/bags $(ARGS)
	$(PY) -m tests.bags.measure_bags 600

docs: .venv/.ready
	$(PY) -m squeal_rig.catalogue.parameter_table > docs/parameters.md

evidence: .venv/.ready
	$(PY) -m squeal_rig.studies.inverse.evidence docs/evidence $(ARGS)

clean:
	rm -rf .venv build install log dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	rm -rf .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# --- the environment -------------------------------------------------------------------------------------

# Editable, so that a change needs no new install; nodes are started as modules, config/ is found beside the package.
.venv/.ready: setup.py pyproject.toml
	$(if $(missing),$(error $(missing)))
	@echo "Setting up .venv, once; this takes a minute or two."
	$(if $(usable),,$(PYTHON) -m venv --clear .venv)
	$(PY) -m pip install -qq --editable '.[jazzy,test]'
	@touch $@

.venv/.bench: .venv/.ready
	$(PY) -m pip install -qq --editable '.[bench]'
	if command -v gfortran >/dev/null; then $(PY) -m pip install -qq numbalsoda; \
	else echo "No gfortran: numbalsoda is left out of the benchmarks."; fi
	@touch $@

.venv/.lint: .venv/.ready
	$(PY) -m pip install -qq --editable '.[lint]'
	@touch $@

# The version of .venv's Python, and nothing where there is none or it no longer runs.
version = import sys; print("%d.%d" % sys.version_info[:2])
present := $(shell $(PY) -c '$(version)' 2>/dev/null)
# An interpreter named by the user is the one to be used; else an environment that runs is good as it is.
wanted := $(if $(filter-out file default undefined,$(origin PYTHON)),$(shell $(PYTHON) -c '$(version)' 2>/dev/null),$(present))
usable := $(and $(present),$(filter $(present),$(wanted)))
ifeq ($(usable),)
.PHONY: .venv/.ready
endif

# Empty where .venv can be made, else the one sentence that says why not; make adds the full stop.
missing = $(shell \
	if [ "$$(uname -s) $$(uname -m)" != "Linux x86_64" ]; then \
	  echo "ROS 2 Jazzy comes from PyPI for Linux on x86_64 only, and this machine is $$(uname -s) on $$(uname -m)"; \
	elif ! command -v "$(PYTHON)" >/dev/null 2>&1; then \
	  echo "$(PYTHON) was not found, and Python 3.10 to 3.14 with venv is needed (Debian, Ubuntu: apt install python3-venv)"; \
	elif ! "$(PYTHON)" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 14))' >/dev/null 2>&1; then \
	  echo "$(PYTHON) is $$("$(PYTHON)" -V 2>&1 | head -n 1), and 3.10 to 3.14 is needed: name another one, as in make PYTHON=python3.12"; \
	elif ! "$(PYTHON)" -c 'import ensurepip, venv' >/dev/null 2>&1; then \
	  echo "$(PYTHON) cannot make an environment, its venv module is not installed (Debian, Ubuntu: apt install python3-venv)"; \
	fi)
