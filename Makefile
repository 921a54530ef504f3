# Two commands do everything on a machine that has Python >= 3.11, git and make: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUTPUT ?= output
# Test processes; each takes up to 4 GB. In the order of the folders the long files come before the short ones.
WORKERS ?= 2

.PHONY: install run test campaign lint benchmark paper notebooks docs clean

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; assert sys.version_info >= (3, 11), 'rotorjax needs Python 3.11 or newer: make PYTHON=python3.12 ...'"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	touch $@

$(VENV)/.tested: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[test,lint]"
	touch $@

run: $(VENV)/.installed
	$(BIN)/python experiments/stories.py --output $(OUTPUT)

# Older fusion compiles in two thirds of the time, and most of what tests compile runs once; both flags are known to the
# pinned jaxlib.
test: export XLA_FLAGS := --xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 $(XLA_FLAGS)
test: $(VENV)/.tested
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

campaign: $(VENV)/.tested
	$(BIN)/python -m pytest -n $(WORKERS) -m campaign

lint: $(VENV)/.tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

benchmark: $(VENV)/.tested
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[benchmark]"
	$(BIN)/python benchmarks/run.py
	$(BIN)/python benchmarks/dataset.py
	$(BIN)/python benchmarks/training.py
	$(BIN)/python benchmarks/batch.py
	$(BIN)/python benchmarks/waveforms.py --output benchmarks/results
	$(BIN)/python benchmarks/hidden_forces.py --output benchmarks/results
	$(BIN)/python benchmarks/evidence.py --output benchmarks/results
	$(BIN)/python benchmarks/half_orders.py
	$(BIN)/python benchmarks/contact.py
	$(BIN)/python benchmarks/explanations.py --output benchmarks/results
	$(BIN)/python experiments/train_network.py --no-times --output benchmarks/results
	$(BIN)/python experiments/train_conditioned.py --output benchmarks/results

paper: $(VENV)/.installed
	$(BIN)/rotorjax paper --output paper_tables

notebooks: $(VENV)/.tested
	$(BIN)/python notebooks/execute.py

$(VENV)/.documented: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[docs]"
	touch $@

docs: $(VENV)/.documented
	$(BIN)/python docs/generate.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "The site: build/site/index.html"

clean:
	rm -rf $(VENV) $(OUTPUT) build dist *.egg-info
