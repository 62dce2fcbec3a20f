# Every target does all that it needs from a bare checkout: Python >= 3.11 with venv, and make.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TABLES := table1 table2

.PHONY: install $(TABLES) test slow clean

install: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "jaxnh needs Python 3.11 or newer; name one by PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(RUN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,dask]'
	touch $@

$(TABLES): $(INSTALLED)
	$(RUN)/python -m jaxnh.sweep configs/$@.yaml

test: $(INSTALLED)
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/basedpyright --warnings
	$(RUN)/pytest --numprocesses 2

slow: $(INSTALLED)
	$(RUN)/pytest --numprocesses 2 -m slow

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache
