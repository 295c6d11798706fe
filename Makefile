# SPDX-License-Identifier: Apache-2.0
# make setup: everything into .venv | demo: count a recorded bag, the more known the surer | test: lint and tests
# make setup-cell: what counting takes and no more: without torch, simulation and tests
# make docs: the documentation as a site, into out/docs/index.html; a warning is an error
# make soak: many scans in a row, and every node killed in every state (some ten minutes)
# make lock: pins of all packages with their hashes, from .venv into requirements.lock
# make fuzz: readers of strangers' bytes with changed ones, SECONDS_EACH=60, all or TARGET="mcap rig"
# make sbom: the bill of materials of .venv (CycloneDX), into out/sbom.json
# make coverage: tests of the core, and which of its branches they take (out/coverage/index.html)
# LOCKED=1 make setup: with the packages of requirements.lock, and no others
# PYTHON=/path/to/python3.12 make setup: with an interpreter of your choice (3.11 to 3.13)

SHELL := bash
DEMO := .venv/bin/stack-counter replay bags/demo
# Tests of the core, from views to the count, and of bags, which drive all of it.
CORE := test/test_*.py $(addprefix test/,config geometry views fusion display occupancy visible_parts \
	container segmentation multiview reconstruction parts weighing tasks bag)
# Puts this package's messages on the paths where ROS 2 is sourced; does nothing elsewhere.
IN_VENV := source .venv/ros.bash &&

.PHONY: help setup setup-cell whole demo test lint docs soak fuzz lock sbom coverage clean

help:
	@sed -n '2,11s/^# //p' Makefile

setup:
	@PYTHON="$(PYTHON)" LOCKED="$(LOCKED)" bash scripts/setup.sh

setup-cell:
	@SETUP_CELL=1 $(MAKE) --no-print-directory setup

whole: setup
	@[ ! -f .venv/cell ] || \
		{ echo "this .venv is for a cell that only counts; expected the whole: make clean setup" >&2; exit 2; }

demo: setup
	@echo; echo "The demo bin, 182 flange nuts. Only the volume of one is known:"; echo
	@$(DEMO) --unit-volume-cm3 6.00488
	@echo; echo "The same bin, and the sides of the box around one nut too:"; echo
	@$(DEMO) --unit-volume-cm3 6.00488 --part-size-mm 34.5x34.5x16
	@echo; echo "The same bin, and the part is known from its CAD file (config/parts.yaml):"; echo
	@$(DEMO) --part demo_nut

lint: whole
	$(IN_VENV) .venv/bin/ruff check .
	$(IN_VENV) .venv/bin/mypy stack_counter

# Two processes of one thread each share the tests.
test: lint
	$(IN_VENV) OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n 2 --dist worksteal

docs: whole
	$(IN_VENV) .venv/bin/python -m sphinx -W --keep-going -E -q docs out/docs
	@echo "out/docs/index.html"

soak: setup
	$(IN_VENV) PYTHONPATH="test:$$PYTHONPATH" .venv/bin/python test/nodes/soak.py

fuzz: whole
	@.venv/bin/python -c 'import atheris' 2>/dev/null || \
		.venv/bin/python -c 'import setup; print(*setup.EXTRAS["fuzz"], sep="\n")' | \
		.venv/bin/uv pip install --quiet --python .venv/bin/python -r -
	$(IN_VENV) OMP_NUM_THREADS=1 .venv/bin/python test/fuzz/run.py $(TARGET) \
		--seconds $(or $(SECONDS_EACH),60)

lock: whole
	@bash scripts/lock.sh

# Tools of their own, beside .venv: they are no part of what they look at.
sbom: setup
	@mkdir -p out
	.venv/bin/uv tool run --quiet --from 'cyclonedx-bom>=7.5' cyclonedx-py environment \
		--mc-type application --output-reproducible -o out/sbom.json .venv/bin/python
	@echo "out/sbom.json"

coverage: whole
	$(IN_VENV) OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n 2 --dist worksteal --cov \
		--cov-report=term:skip-covered --cov-report=html:out/coverage $(CORE)
	@echo "out/coverage/index.html"

clean:
	rm -rf .venv build install log dist *.egg-info .pytest_cache .ruff_cache .mypy_cache out
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
