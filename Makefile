# The two commands to know:   make demo   and   make test
# Both do all their set-up themselves. Another interpreter: make test PYTHON=python3.12

PYTHON ?= python3
PYTEST_ARGS ?= -n 2 --dist worksteal
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.exumi-setup

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.PHONY: help setup demo docs test lint types wheel-check conformance readers check format public-api hooks clean

help:  ## what can be made
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 22

setup: $(STAMP)  ## a virtual environment in .venv with everything pinned

$(STAMP): pyproject.toml constraints.txt exumi_data/_version.py
	@$(PYTHON) scripts/check_python.py
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[train,record,mcap,umi,view,ray,cloud,release,test,docs]"
	@touch $(STAMP)

demo: setup  ## a simulated gripper plays: recorded live, validated, prepared, loaded, drawn
	$(BIN)/exumi demo

# Thousands of small files, each made safe against a power loss: in memory, where there is plenty of
# it, that takes a quarter less time. What failed stays there to be looked at.
define run_pytest
@free=$$(df -Pk /dev/shm 2>/dev/null | awk 'NR == 2 {print $$4}'); \
if [ "$${free:-0}" -gt 8000000 ]; then folder=$$(mktemp -d /dev/shm/exumi-XXXXXX); \
else folder=$$(mktemp -d); fi; \
echo $(BIN)/python -m pytest $(PYTEST_ARGS) --basetemp=$$folder $(1); \
$(BIN)/python -m pytest $(PYTEST_ARGS) --basetemp=$$folder $(1) && rm -rf $$folder
endef

test: setup  ## the tests; those of the documentation are made by `make docs`
	$(call run_pytest,--ignore=tests/docs)

lint: setup  ## style and the import contract
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

types: setup  ## mypy, strict
	$(BIN)/mypy

docs: export EXUMI_SITE := $(CURDIR)/site
docs: setup  ## the documentation: a site, in site/, and its tests, which run every code block
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	$(call run_pytest,tests/docs)

wheel-check: setup  ## sdist, wheel from it, fresh environment, import everything
	$(BIN)/python scripts/check_wheel.py

conformance: setup  ## our validator, writer and editor, judged by the standard's harnesses
	$(BIN)/python spec/conformance/run_validator.py --exact --batch \
	  -- $(BIN)/python spec/conformance/adapters/exumi_validator.py
	$(BIN)/python spec/conformance/run_writer.py \
	  --validator "$(BIN)/exumi validate --format json" \
	  -- $(BIN)/python spec/conformance/adapters/exumi_writer.py
	$(BIN)/python spec/conformance/run_editor.py \
	  --validator "$(BIN)/exumi validate --format json" \
	  -- $(BIN)/python spec/conformance/adapters/exumi_editor.py

readers: setup  ## both readers, ours and the second one (needs Node.js), on the corpus
	$(BIN)/python spec/conformance/run_reader.py -- $(BIN)/python spec/readers/dump.py
	$(BIN)/python spec/readers/check_typescript.py $(if $(CI)$(EXUMI_REQUIRE_NODE),--require)

check: test lint types docs wheel-check conformance readers  ## all of the above: what has to pass before a change goes in

format: setup  ## put the code in order
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

public-api: setup  ## record the public names as they are now
	$(BIN)/python scripts/public_api.py --write

hooks: setup  ## run lint and types at every commit
	$(BIN)/pre-commit install

clean:  ## remove the environment, caches and build outputs
	rm -rf $(VENV) build dist site .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
