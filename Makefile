# Each target makes .venv and installs what it needs; nothing but Python 3.11 to 3.13 is assumed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= 2
STUDY := runs/refractory-period-quick
INSTALL := $(BIN)/pip install --quiet --no-compile -c constraints.txt
# pip compiles modules one by one, also the tests of packages. Without any, a process compiles what it imports, and where
# PYTHONDONTWRITEBYTECODE is set each process does so anew: the import of torch and scipy takes twice as long. Some
# packages hold files of later versions of Python, which fail.
COMPILE := $(BIN)/python -m compileall -qq -j 0 -x '/tests?/' $(VENV)/lib $(CODE) || true
CODE := neurotact encoders exporters networks opponents readers streams studies
SOURCES := pyproject.toml constraints.txt CMakeLists.txt $(wildcard native/*) neurotact/__init__.py

# Where there is a compiler, a C++ error must not fall back silently to the slow reference.
ifneq ($(shell command -v c++ || command -v g++ || command -v clang++),)
export NEUROTACT_REQUIRE_NATIVE = 1
endif
# The extra `test` is installed below: a test that is skipped for want of one of its packages is an error.
export NEUROTACT_REQUIRE_EXTRAS = 1
# Half of what collecting the tests takes is compiling them: it is kept for the next run.
export PYTHONDONTWRITEBYTECODE =
# Tests of a file share what they make: a file stays with a worker.
PYTEST := $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: study test test-rest test-all test-slow wheel lint docs bench device clean

study: $(VENV)/.installed
	$(BIN)/neurotact study run refractory-period --quick --workers $(WORKERS) -o $(STUDY)

# The quick level, in minutes: tests/README.md.
test: $(VENV)/.installed
	$(PYTEST)

# What `make test` leaves: the thorough level, and more examples of tests that draw them.
test-rest: $(VENV)/.installed
	$(PYTEST) -m '(thorough or hypothesis) and not slow' --hypothesis-profile thorough

# What a change must pass, as in CI.
test-all: test test-rest wheel

# The long tests, by hand, and other random examples each time.
test-slow: $(VENV)/.installed
	$(PYTEST) -m 'slow or hypothesis' --hypothesis-profile random

# The source distribution and the wheel, installed as a user does: every command runs outside the checkout.
wheel: $(VENV)/.installed
	$(BIN)/pytest -m slow tests/test_wheel.py

lint: $(VENV)/.linters
	$(BIN)/ruff check $(CODE) tests benchmarks docs
	$(BIN)/ruff format --check $(CODE) tests benchmarks docs
	mkdir -p build/packages/neurotact_parts
	for room in encoders exporters networks opponents readers streams studies; do ln -sfn ../../../$$room build/packages/neurotact_parts/$$room; done
	$(BIN)/pyright
	$(BIN)/pyright -p docs/examples

# The site in build/docs; a broken link or anchor, as any warning, is an error. It runs docs/examples, each anew where
# it has changed.
docs: $(VENV)/.site
	$(BIN)/python -m sphinx -E -W --keep-going -q -c docs/site docs build/docs
	@echo build/docs/index.html

bench: $(VENV)/.peers
	$(BIN)/python benchmarks/rsnn_training.py
	NEUROTACT_BRIAN2_PYTHON=$(VENV)-brian2/bin/python $(BIN)/python benchmarks/encoding.py

# Wants cc, and for the processors gcc-arm-none-eabi and qemu-system-arm; what is absent is skipped, with the reason.
device: $(VENV)/.installed
	$(BIN)/python benchmarks/device.py

# One install for all, since each would compile the kernels anew. An editable install does not rebuild C++: the
# stamp does, whenever native/ changes.
$(VENV)/.installed: $(SOURCES)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) -e '.[test]'
	$(COMPILE)
	touch $@

$(VENV)/.linters: $(VENV)/.installed
	$(INSTALL) ruff pyright
	touch $@

$(VENV)/.site: $(VENV)/.installed
	$(INSTALL) sphinx myst-parser furo sphinx-gallery sphinx-copybutton
	touch $@

# Norse, SpikingJelly and NeuroBench ask for torchvision or torchaudio, which they do not need here; Brian2 needs an older numpy than ours.
$(VENV)/.peers: $(VENV)/.installed
	$(INSTALL) jax
	$(BIN)/pip install --quiet --no-deps norse spikingjelly loguru neurobench==2.3.0
	$(PYTHON) -m venv $(VENV)-brian2
	$(VENV)-brian2/bin/pip install --quiet brian2 'numpy<2' 'setuptools<82' cython
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-brian2 build runs docs/gallery_of_examples
