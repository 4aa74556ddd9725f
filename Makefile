# Two commands are enough: `make demo` and `make test`; each sets up what is missing.
# Variables on the command line reach the scripts.
VARIABLES := TASK METHOD HIDDEN SEED ITERATIONS OUTPUT COUNT PACKAGES BENCHMARKS PYTHON CXX \
  ROS_DOMAIN_ID OMP_NUM_THREADS OPENBLAS_NUM_THREADS FASTRTPS_DEFAULT_PROFILES_FILE
given := $(foreach v,$(.VARIABLES),$(if $(filter command,$(origin $v)),$v))
unknown := $(firstword $(filter-out $(VARIABLES),$(given)))
ifneq ($(unknown),)
  $(error There is no variable $(unknown).$(shell python3 -c 'import difflib, sys; \
    print(*(f" Did you mean {n}?" for n in difflib.get_close_matches(sys.argv[1], sys.argv[2:], 1)))' \
    $(unknown) $(VARIABLES)) `make help` lists the variables of each target)
endif
.DEFAULT_GOAL := help
.PHONY: help setup development demo test test-all coverage faults damages bench bench-peers web wheels site lint clean distclean

help:  ## list these targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup:  ## virtual environment, wheels, colcon build; skips what stands
	@scripts/setup.bash

development:
	@scripts/setup.bash development

demo: setup  ## learn in a graph of ROS 2 nodes (TASK= METHOD= HIDDEN= SEED= ITERATIONS=)
	@scripts/run_demo.bash

test: development  ## the tests, without the long and the adversarial ones; nothing may be left behind
	@scripts/run_tests.bash

test-all: development  ## all tests: floods, damages, commands of the pages, a colcon workspace, Chromium, robots of others (downloads)
	@.venv/bin/python -m pip install --quiet -r requirements/browser.txt
	@.venv/bin/python -m pip install --quiet --no-deps -r requirements/robots.txt
	@scripts/run_tests.bash -m ''

coverage: development  ## lines and branches that the tests reach, with limits (PACKAGES="safety": theirs alone; else an hour)
	@scripts/measure_coverage.bash $(PACKAGES)

faults: development  ## kill, stop and restart the nodes of a training graph at random, COUNT=40 times; SEED= repeats a run
	@FAULTS=$(or $(COUNT),40) $(if $(SEED),FAULTS_SEED=$(SEED)) scripts/run_tests.bash tests/nodes/test_faults.py -m '' --timeout=0 -s

damages: development  ## damage COUNT=2000 bags at random and run every reader on them (SEED=)
	@bash -c 'source env.bash && exec nice python -m tests.bags.damage --count $(or $(COUNT),2000) --seed $(or $(SEED),7)'

bench: development  ## speed, as ratios to peers and floors (BENCHMARKS= OUTPUT=); installs the peers
	@scripts/run_benchmarks.bash $(BENCHMARKS)

bench-peers: development  ## against PPO and SAC of Stable-Baselines3 (OUTPUT=); takes long
	@scripts/run_benchmarks.bash reinforcement_learning

web:  ## fetch what pages in the browser are made of (npm): `vgps export --web` and `vgps demo` need it
	@scripts/build_web_parts.bash

wheels: setup web  ## wheels of vgps_ros and of its messages, into dist/
	@scripts/build_wheels.bash

site: development  ## the documentation site, into build/site; every link and reference must hold
	@scripts/build_site.bash

lint: development  ## ruff (rules and format) and mypy
	@scripts/check_style.bash

clean:  ## remove build, install, log and caches; keeps the virtual environment
	@rm -rf build dist install log .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
	@find vgps_ros tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## the same, and the virtual environment
	@rm -rf .venv
