# Every target sets itself up: .venv holds the pinned packages and neusub itself, whose kernels are compiled for the demo.
PYTHON ?= python3
BIN = .venv/bin
# A mesh large enough for them.
LARGE = import neusub, trimesh; s = trimesh.creation.icosphere(4); neusub.subdivide(neusub.Mesh(s.vertices, s.faces), levels=1)

.PHONY: demo test bench lint clean

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -c "$(LARGE)"
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
