# The two commands:  make demo   and   make test.  Each sets itself up first; Python 3.11 or later is all it needs.

PYTHON ?= $(shell python3.11 --version >/dev/null 2>&1 && echo python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin

# One worker a core. Each takes neighbouring tests, so that they compile different kernels, then those left to others.
PARALLEL := -n auto --dist worksteal

# Tests start many processes, which would all compile the sources anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test test-full campaign fresh test-report lint bench bench-full paper paper-full comparison figures docs release-check lock clean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-11s %s\n", $$1, $$2}' Makefile

demo: $(VENV)/.ready  ## simulate a small recording, measure it, score it; the report is demo/results/report.html
	$(BIN)/plenopiv demo demo --overwrite

test: lint  ## style, types, import order, and the quick tests
	$(BIN)/python -m pytest $(PARALLEL) -m "not full"

test-full: $(VENV)/.ready-dev  ## the tests of minutes, which make test leaves out
	$(BIN)/python -m pytest $(PARALLEL) -m full

campaign: $(VENV)/.ready-dev  ## what takes hours: each script of campaigns/ goes on where it was stopped
	for script in $$(grep -l __main__ campaigns/*.py); do $(BIN)/python $$script || exit 1; done

fresh: $(VENV)/.ready  ## make recorded tables anew that an earlier program made: hours, goes on where it was stopped
	$(BIN)/python benchmarks/fresh.py --again

test-report: $(VENV)/.ready-dev demo  ## reports in a headless Chromium without a network (apt-get install chromium)
	$(BIN)/python -m pip install --quiet -r requirements-browser.txt
	PYTHONPATH=tests/report $(BIN)/python -m pytest tests/report_browser

lint: $(VENV)/.ready-dev  ## style, types and import order alone
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

bench: $(VENV)/.ready  ## measure speed against limits and peers, a quarter of an hour, and write docs/speed.md
	$(BIN)/python benchmarks/speed/start_and_threads.py
	$(BIN)/python benchmarks/speed/limits.py
	$(BIN)/python benchmarks/speed/reconstruction.py
	$(BIN)/python benchmarks/speed/peers.py
	$(BIN)/python benchmarks/correlation/run.py
	$(BIN)/python benchmarks/speed/speed_page.py

bench-full: bench  ## and all conditions of docs/accuracy.md, the paper's full size too: an hour
	$(BIN)/python benchmarks/accuracy/run_conditions.py
	$(BIN)/python benchmarks/accuracy/run_conditions.py full
	$(BIN)/python benchmarks/accuracy/table.py
	$(BIN)/python benchmarks/speed/memory.py build/accuracy/scores.jsonl
	$(BIN)/python benchmarks/speed/scaling.py build/accuracy/scores.jsonl build/accuracy
	$(BIN)/python benchmarks/speed/speed_page.py

paper: $(VENV)/.ready  ## draw the source paper's figures anew, and write docs/paper.md from their numbers
	$(BIN)/python paper/resolution.py
	$(BIN)/python paper/schematics.py
	$(BIN)/python paper/point_images.py
	$(BIN)/python paper/single_particles.py
	$(BIN)/python paper/gain_in_quality.py
	$(BIN)/python paper/candidates_over_depth.py
	$(BIN)/python paper/time_and_density.py
	$(BIN)/python paper/normalisation.py
	$(BIN)/python paper/comparison.py reduced
	$(BIN)/python paper/needed.py
	$(BIN)/python paper/both_frames.py
	$(BIN)/python paper/page.py

paper-full: paper  ## and the comparison of section 4 in all of the paper's volume: hours, 16 GB
	$(BIN)/python paper/comparison.py full
	$(BIN)/python paper/ghosts.py
	$(BIN)/python paper/page.py

comparison: $(VENV)/.ready  ## of this only LF-PIV, Tomo-PIV and a DNS jet: section 4 in a cut of its volume
	$(BIN)/python paper/comparison.py reduced

figures: $(VENV)/.ready  ## draw the pictures of the README from the demo and the gallery
	$(BIN)/python docs/make_figures.py
	$(BIN)/python docs/site/make_gallery.py
	$(BIN)/python docs/make_field_picture.py

docs: $(VENV)/.ready  ## the documents as a site, without a network: build/site/html/index.html
	$(BIN)/python -m pip install --quiet -r requirements-docs.txt
	$(BIN)/python docs/site/build_site.py

release-check: $(VENV)/.ready  ## wheel and sdist into dist/, installed in fresh environments and tried without the repository
	$(BIN)/python .ci/release_check.py

lock:  ## resolve pyproject.toml anew into the requirements files
	$(PYTHON) -m venv --clear build/lock
	build/lock/bin/pip install --quiet --upgrade "setuptools>=77" .
	build/lock/bin/pip freeze --all --exclude pip --exclude plenopiv > requirements.txt
	build/lock/bin/pip install --quiet ".[dev]"
	build/lock/bin/pip freeze --all --exclude pip --exclude plenopiv > build/lock/all.txt
	(echo "-r requirements.txt"; grep -vixFf requirements.txt build/lock/all.txt) > requirements-dev.txt
	build/lock/bin/pip install --quiet uv
	build/lock/bin/uv pip compile --quiet --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	  requirements.txt -o requirements-hashed.txt
	$(PYTHON) -m venv --clear build/lock
	build/lock/bin/pip install --quiet -r requirements.txt
	build/lock/bin/pip install --quiet ".[docs]"
	build/lock/bin/pip freeze --all --exclude pip --exclude plenopiv > build/lock/all.txt
	(echo "-r requirements.txt"; grep -vixFf requirements.txt build/lock/all.txt) > requirements-docs.txt

clean:  ## remove everything that make made
	rm -rf $(VENV) build demo .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	find src tests docs -name __pycache__ -prune -exec rm -rf {} +

# A stamp is newer than its lock file once the environment holds what the lock file says.
$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "PlenoPIV needs Python 3.11 or later; name one with: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.ready: requirements.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -r requirements.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.ready-dev: requirements-dev.txt $(VENV)/.ready
	$(BIN)/python -m pip install --quiet -r requirements-dev.txt
	@touch $@
