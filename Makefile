# Every target sets itself up: .venv holds the pinned packages and neusub itself.
PYTHON ?= python3
BIN = .venv/bin

.PHONY: demo test bench lint clean

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

demo: .venv/ready
	$(BIN)/python examples/demo.py --output demo

test: .venv/ready
	$(BIN)/python -m pytest -n 2

bench: .venv/ready
	$(BIN)/python benchmarks/run.py

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/pyright

clean:
	rm -rf .venv demo
