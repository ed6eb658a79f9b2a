# Two verbs do everything on a fresh machine: `make demo` and `make test`. Both install into .venv first.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
INSTALLED := $(VENV)/installed

.PHONY: demo test check benchmark clean

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet --constraint constraints.txt --editable ".[agents,collect,cluster,pictures,remotes,dev]"
	touch $@

# A quarter of the data (every fourth snapshot) and a thousandth of the paper's steps, at a learning rate to match.
DEMO_AGENTS := transformer_bc dt dadt
DEMO_TRAINING := --steps 1000 --learning-rate 1e-3 --warmup-steps 100 --evaluate-every 0

demo: $(INSTALLED)  ## rebuild a part of Hopper's data, train three agents on it, score them in five unseen bodies
	$(BIN)/dynagen data build Hopper --every 4
	$(BIN)/dynagen baseline Hopper --output .demo/random
	$(BIN)/python -m leaderboard submit .demo/random --board .demo/board --replace
	set -e; for agent in $(DEMO_AGENTS); do \
	  $(BIN)/python -m agents.train $$agent --robot Hopper --every 4 --runs .demo/runs $(DEMO_TRAINING); \
	  $(BIN)/python -m agents.submit .demo/runs/$$agent-Hopper-seed0-every4 --output .demo/$$agent --authors "make demo"; \
	  $(BIN)/python -m leaderboard submit .demo/$$agent --board .demo/board --replace; \
	done
	$(BIN)/python -m leaderboard show --board .demo/board
	$(BIN)/python -m agents.summary .demo/runs --output .demo/summary.html
	@echo "Learning curves: .demo/summary.html, or $(BIN)/tensorboard --logdir .demo/runs"

test: $(INSTALLED)  ## all tests, a file on one of all processors
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

check: $(INSTALLED)  ## format, lint, types, layers, the pages that are made, the leaderboard's entries
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m leaderboard build --check
	$(BIN)/python -m results build --check
	$(BIN)/python -m leaderboard verify --all

benchmark: $(INSTALLED)  ## speeds, as ratios within one run
	$(BIN)/python -m pytest tests/benchmarks --benchmark-only

clean:
	rm -rf $(VENV) .demo
