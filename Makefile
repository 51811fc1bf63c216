# `make demo` recovers the Cornell box's reflectances from an image; `make test` runs the tests,
# `make test-deep` those that take longer. All set up .venv first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo docs test test-deep test-peer test-torch gpu-check release lint clean

$(VENV)/.installed: setup.py constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt torch numpy
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test]"
	@# This folder by name: a script that lies beside it would take it for the package, if they have one name.
	$(BIN)/python -c "import site; open(site.getsitepackages()[0] + '/torch_radbp_source.pth', 'w').write('$(CURDIR)\n')"
	touch $@

demo: $(VENV)/.installed
	$(BIN)/radbp optimize cornell_reflectance

# The documentation, in site/: runs the tutorials that have changed, some minutes for all. A warning is an error, and so is a
# page that is wider than a screen, if there is Chromium to look.
docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[docs]"
	$(BIN)/python -m docs.build
	$(BIN)/python -m docs.widths site

# Workers begin at either end of the list, and who is done takes from the other; compiled code is kept for all of them. Bytecode
# is written even where PYTHONDONTWRITEBYTECODE is set, since tests start many processes.
PYTEST := OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto --dist worksteal

# `python -m tests.slowest` prints the durations.
test: $(VENV)/.installed
	$(PYTEST) --keep-durations=runs/test_durations.json

# What takes longer: the rest of the long rows, and what is run from end to end.
test-deep: $(VENV)/.installed
	$(PYTEST) --deep

# All that is compared with Mitsuba, by the version that the references were made with.
test-peer: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test,peer]"
	$(PYTEST) tests/peer tests/bsdf tests/io
	$(PYTEST) --deep tests/peer tests/bsdf

# The quick tests on another version of torch, in an environment of its own:
# make test-torch VERSION=2.6.0 NUMPY="numpy<2" PYTHON=python3.10
NUMPY ?= numpy
test-torch:
	$(PYTHON) -m venv $(VENV)-torch-$(VERSION)
	$(VENV)-torch-$(VERSION)/bin/python -m pip install --quiet "torch==$(VERSION)" "$(NUMPY)"
	$(VENV)-torch-$(VERSION)/bin/python -m pip install --quiet -e ".[test]"
	OMP_NUM_THREADS=1 $(VENV)-torch-$(VERSION)/bin/python -m pytest -n auto --dist worksteal

# On a machine with a CUDA GPU: times beside Mitsuba's, and the tests that need one; saves a report in runs/gpu-check.
# `make gpu-check PART=1` and `PART=2` take a quarter of an hour together. Without a GPU it says so, runs nothing and fails.
gpu-check: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test,peer,cuda]"
	$(BIN)/python -m benchmarks.gpu_check $(if $(PART),--part $(PART))

# Wheel and source archive, into dist/, each tried in empty environments: every Python here, torch 2.6 and the newest.
release: $(VENV)/.installed
	$(BIN)/python -m tests.release

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/mypy --no-error-summary
	$(BIN)/mypy --no-error-summary --strict --follow-imports=silent tests/typing/every_public_name.py

clean:
	rm -rf $(VENV) build dist runs site *.egg-info
