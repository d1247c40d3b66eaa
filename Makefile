# Everything runs in an environment of its own, made on first use.
PYTHON ?= python3.11
VENV   ?= .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help run test test-slow lint verify clean

help:
	@echo "make run        run the graphene crack scene; ends by naming its report"
	@echo "make test       lint, types, import laws, and all tests that are not slow"
	@echo "make test-slow  the slow tests"
	@echo "make verify     cases with a known answer, as a table"
	@echo "make clean      remove the environment and all caches"

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	$(BIN)/python -m mpm_service.compile_kernels
	touch $(READY)

run: $(READY)
	$(BIN)/scalebridge run scenes/graphene_crack.toml

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(BIN)/pytest -m "not slow" -n 2 --dist loadgroup

test-slow: $(READY)
	$(BIN)/pytest -m slow

verify: $(READY)
	$(BIN)/scalebridge verify

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
