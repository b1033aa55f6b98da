# Set-up, demo and checks on a machine without ROS. With ROS 2: `colcon build`, see README.md.
#
#   make demo ARGS='...'    ARGS goes to the demo, to pytest or to the benchmark
#   make test PYTHON=...    the Python of a new .venv (an old one stays: `make clean`)

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
OMNIMAN := $(BIN)/omniman

# Written last, when the step before it is complete.
EMPTY := $(VENV)/empty.stamp
RUNTIME := $(VENV)/runtime.stamp
TESTING := $(VENV)/testing.stamp
DOCUMENTING := $(VENV)/documenting.stamp

# A .venv that was moved, or whose Python is gone, is made anew.
ifneq ($(shell cat $(EMPTY) 2>&1 && $(BIN)/python -E -c '' 2>&1),$(CURDIR))
$(shell rm -f $(EMPTY) $(RUNTIME) $(TESTING) $(DOCUMENTING))
endif

export PYTHON
# A ROS in this shell must not mix with the wheels in .venv.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH COLCON_PREFIX_PATH
unexport CMAKE_PREFIX_PATH RMW_IMPLEMENTATION ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION
# Set by the wheels' Python for its children, which then do not look for their libraries.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Without cached bytecode, every node compiles the package anew when it starts.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help venv demo test lint types tests test-all fuzz bench docs clean
.NOTPARALLEL:

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(RUNTIME) ## Run the demo
	$(OMNIMAN) demo $(ARGS)

# The types are checked beside the tests, which wait for processes at first.
test: lint ## Check style and types and run all tests
	@nice $(BIN)/mypy >$(VENV)/types.log 2>&1 & types=$$!; \
	.ci/tests $(BIN)/python $(ARGS); tests=$$?; \
	wait $$types; types=$$?; \
	cat $(VENV)/types.log; exit $$((tests | types))

lint: $(TESTING) ## Check the style
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports --no-cache

types: $(TESTING) ## Check the types
	$(BIN)/mypy

tests: $(TESTING) ## Run the tests
	.ci/tests $(BIN)/python $(ARGS)

test-all: $(TESTING) ## Run the exhaustive tests, too
	ROS_PYTHON_CHECK_FIELDS=1 .ci/tests $(BIN)/python
	time env ROS_PYTHON_CHECK_FIELDS=1 .ci/tests $(BIN)/python -m exhaustive --durations=20

# OMNIMAN_FUZZ is the number of examples of each fuzz test: a million takes two hours of CPU time.
fuzz: export OMNIMAN_FUZZ ?= 1000000
fuzz: $(TESTING) ## Give each codec, node and page OMNIMAN_FUZZ frames, messages and events of any content
	.ci/tests $(BIN)/python test/can_drives -n auto -m '' -k 'no_frame and raises' $(ARGS)
	.ci/tests $(BIN)/python test/nodes/test_fuzz.py -n auto -m '' $(ARGS)
	.ci/tests $(BIN)/python test/viewer -n auto -m '' -k fuzz $(ARGS)

bench: $(RUNTIME) ## Measure how long the control cycle takes
	$(OMNIMAN) bench $(or $(ARGS),control)

docs: $(DOCUMENTING) ## Build the documentation in docs/_build/html
	$(BIN)/python -m sphinx -b html -W --keep-going -q -j auto docs docs/_build/html

venv: $(TESTING) ## Make .venv with all that is needed

clean: ## Remove .venv and what the tools leave behind
	rm -rf $(VENV) build docs/_build docs/examples docs/changelog.md *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

$(EMPTY):
	.ci/venv $(VENV)
	echo '$(CURDIR)' > $@

$(RUNTIME): setup.py | $(EMPTY)
	$(PIP) install --quiet --editable '.[ros,plot,viewer,world]'
	touch $@

$(TESTING): $(RUNTIME)
	$(PIP) install --quiet --editable '.[ros,plot,viewer,world,cluster,browser,docs,test]'
	touch $@

$(DOCUMENTING): $(RUNTIME)
	$(PIP) install --quiet --editable '.[ros,plot,viewer,world,docs]'
	touch $@
