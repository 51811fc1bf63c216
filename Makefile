# `make demo` recovers the Cornell box's reflectances from an image; `make test` runs the tests. All set up .venv first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-slow test-peer gpu-check lint clean

$(VENV)/.installed: setup.py constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt torch numpy
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test]"
	touch $@

demo: $(VENV)/.installed
	$(BIN)/radbp optimize cornell_reflectance

test: $(VENV)/.installed
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

# What the tests leave out because it takes minutes, one after another.
test-slow: $(VENV)/.installed
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --slow -m slow

# All that is compared with Mitsuba, by the version that the references were made with.
test-peer: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test,peer]"
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile tests/peer tests/bsdf tests/io

# On a machine with a CUDA GPU: the tests that need one, and times beside Mitsuba's; saves a report in runs/gpu-check.
# Without a GPU it says so, runs nothing and fails.
gpu-check: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test,peer,cuda]"
	$(BIN)/python -m benchmarks.gpu_check

lint: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet ruff
	$(BIN)/ruff check .

clean:
	rm -rf $(VENV) build dist runs *.egg-info
