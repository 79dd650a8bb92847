# `make demo` and `make test` need Python 3.10 to 3.14 with venv, on Linux x86-64; the rest they fetch into .venv.

PYTHON ?= python3
PY := .venv/bin/python
# Given after the command of a target, as in: make test ARGS="-k friction"
ARGS ?=
# How long the fuzz suite runs.
MINUTES ?= 2

.PHONY: help demo reproduce test test-slow test-long test-docs faults fuzz lint bench bench-bags docs docs-site policy evidence
.PHONY: soak dist audit lowest pythons extras clean
.DEFAULT_GOAL := help

# A ROS installation or another environment around us would mix its libraries with ours.
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH VIRTUAL_ENV
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

help:
	@echo "make demo       run the rig from quiet sliding into squeal; leaves a bag and a picture in bags/"
	@echo "make reproduce  the paper's figures and tables beside its numbers; leaves reproduction/"
	@echo "make test       run the tests (ARGS: options for pytest)"
	@echo "make test-slow  what starts and ends processes many times: signals, sessions that are gone, rigs of one name; long fits"
	@echo "make test-long  half an hour of stable running without an alarm, 400 fits whose intervals must hold, 700 hits and zones by"
	@echo "                force, a live campaign that is killed, thousands of leaves from a busy graph"
	@echo "make test-docs  every tutorial from start to end, and the Python of every page"
	@echo "make faults     break the rig in some forty ways and see where it ends; writes docs/faults.md"
	@echo "make fuzz       inputs that nobody means well, for two minutes (MINUTES=30: for longer); fuzz_findings/ has what it finds"
	@echo "make lint       check style, types and imports"
	@echo "make bench      measure speed against peers, and the live node; writes docs/benchmarks.md"
	@echo "                ARGS=engine, cycles, instruments, nodes, stops, campaigns or page for one, ARGS=\"nodes --minutes 10\" for the long run"
	@echo "make bench-bags long series of tests of bags; recording, replay, export at full load (half an hour)"
	@echo "make docs       write docs/parameters.md anew from the code"
	@echo "make docs-site  build the documentation site into docs/_build/html"
	@echo "make policy     write config/security/policy.xml anew from the running nodes"
	@echo "make evidence   search anew for docs/evidence/*.csv, half an hour"
	@echo "make soak       full load for ten minutes, nodes killed and started again; fails on a slope; soak/ (HOURS=8)"
	@echo "make dist       build sdist and wheel into dist/ and check them"
	@echo "make audit      look for known vulnerabilities in what is installed; write a bill of materials into dist/"
	@echo "make lowest     run the tests on the oldest dependencies that setup.py admits, with Python 3.10 or 3.11 (OLDEST=python3.11)"
	@echo "make pythons    install the wheel with every Python from 3.10 to 3.14 that is here, and start the simulator"
	@echo "make extras     install the wheel with each of its extras alone"
	@echo "make clean      remove .venv, caches and build output; recordings stay"
	@echo "Another Python: make PYTHON=python3.12 ..."

demo: .venv/.ready
	.venv/bin/squeal-rig demo $(ARGS)

reproduce: .venv/.ready
	.venv/bin/squeal-rig reproduce $(ARGS)

# What computes, then what starts ROS graphs: five processes and more each, in domains of their own. The browser comes last
# and alone: a graph of its own beside it is all that two cores carry. Without one, its tests are left out.
GRAPHS := tests/nodes tests/system tests/bags tests/faults tests/page/test_foxglove.py
PAGE := tests/page/test_in_browser.py tests/page/test_picture.py
TWO := -n 2 --dist loadfile

test: .venv/.ready
ifeq ($(ARGS),)
	$(PY) -m pytest $(TWO) $(addprefix --ignore=,$(GRAPHS) $(PAGE))
	$(PY) -m pytest $(TWO) $(GRAPHS)
	$(PY) -m pytest $(PAGE)
else
	$(PY) -m pytest $(ARGS)
endif

test-slow: .venv/.ready
	$(PY) -m pytest $(TWO) -m slow $(ARGS)

test-long: .venv/.ready
	$(PY) -m pytest -m long tests $(ARGS)

test-docs: .venv/.ready
	$(PY) -m pytest -n 2 -m docs tests/docs $(ARGS)

faults: .venv/.ready
	FAULTS_TABLE=docs/faults.md $(PY) -m pytest -m "slow or not slow" tests/faults $(ARGS)

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

docs-site: .venv/.docs
	$(PY) -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

soak: .venv/.ready
	$(PY) -m tests.soak --out soak $(if $(HOURS),--hours $(HOURS)) $(ARGS)

policy: .venv/.ready
	$(PY) -m tests.graph.policies config/security/policy.xml

evidence: .venv/.ready
	$(PY) -m squeal_rig.studies.inverse.evidence docs/evidence $(ARGS)

dist: .venv/.dist
	rm -rf build dist squeal_rig.egg-info
	$(PY) -m build
	$(PY) -m twine check --strict dist/*

# The database is asked through pip-audit's own client; where the machine does not reach it, that is said in one line.
audit: .venv/.dist
	@mkdir -p dist
	@$(PY) -m pip_audit --progress-spinner off --skip-editable -f cyclonedx-json -o dist/bill-of-materials.json \
	  2>dist/audit.log; code=$$?; if [ -s dist/bill-of-materials.json ]; then grep -v '^WARNING' dist/audit.log; exit $$code; \
	else echo "make audit: left out, the database of vulnerabilities was not reached (dist/audit.log)"; fi

# numba's and SciPy's oldest have no wheels for Python 3.12 and later. Two numbas of one Python would take each other's
# compiled code away, beside the package.
OLDEST ?= $(firstword $(foreach python,python3.10 python3.11,$(shell $(python) -c 'import ensurepip, venv' 2>/dev/null && echo $(python))) $(PYTHON))
lowest: .venv/.ready
	$(OLDEST) -m venv --clear .venv-lowest
	$(PY) .ci/lowest.py > .venv-lowest/lowest.txt
	.venv-lowest/bin/python -m pip install -qq --constraint .venv-lowest/lowest.txt --editable '.[jazzy,test]'
	NUMBA_CACHE_DIR=$(CURDIR)/.venv-lowest/numba .venv-lowest/bin/python -m pytest $(ARGS)

pythons: dist
	.ci/pythons dist/*.whl

extras: dist
	.ci/extras dist/*.whl

clean:
	rm -rf .venv .venv-lowest build install log dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	rm -rf .hypothesis docs/_build docs/reference/commands.md docs/reference/python.md
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

.venv/.docs: .venv/.ready
	$(PY) -m pip install -qq --editable '.[docs]'
	@touch $@

.venv/.dist: .venv/.ready
	$(PY) -m pip install -qq --editable '.[dist]'
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
