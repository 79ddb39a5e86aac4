# `make demo` and `make test` first make .venv with all they need; see README.md.
# `make ROS_DISTRO=kilted demo` does it with ROS 2 Kilted, in .venv-kilted.
PYTHON ?= python3
ROS_DISTRO := jazzy
VENV := .venv$(patsubst -jazzy,,-$(ROS_DISTRO))
BIN := $(VENV)/bin
DEMO := out/demo$(VENV:.venv%=%)
# For CI, with known truth: a table of ros2_control and a ball plate behind I++ DME at once, the goals
# of a trajectory controller, and the closed loop on LinuxCNC.
KILTED_TESTS := test/nodes/test_every_reader.py packages/rotcal_ipp_dme/test/test_two_cells.py test/cli/test_doctor.py \
	test/nodes/table_adapter/test_table_goals.py test/linuxcnc/test_closed_loop.py
# The tests of PACKAGE, rotcal_ros being the core; ALONE=1: with the core and nothing else.
TESTS = $(patsubst packages/rotcal_ros/test,test,$(PACKAGE:%=packages/%/test))
HIDING = $(if $(ALONE),$(BIN)/python scripts/alone.py $(filter-out rotcal_ros,$(PACKAGE)) --)
SEED ?= 1
SAMPLE ?= 400
SECONDS ?= 60

# A sourced ROS installation must not leak into .venv, which contains its own ROS.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH
unexport VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE

.PHONY: demo resume test test-all test-aids test-kilted docs reproduce bench speed power yardstick data-set mutants fuzz soak endurance lint release compare-release setup clean help

demo: setup  ## calibrate the simulated cell over ROS 2, compensate, measure again; in out/demo
	@$(BIN)/rotcal verify config/tracer_demo.yaml --output $(DEMO) --keep-previous

resume: setup  ## continue a demo that was interrupted
	@$(BIN)/rotcal verify --resume $(DEMO)

test: setup  ## run the quick tests, minutes; PACKAGE=rotcal_papers: of one; PYTEST_ARGS="-k plane"
	@VENV=$(VENV) $(HIDING) scripts/test.sh $(or $(PYTEST_ARGS),--quick) $(TESTS)

test-all: setup  ## run the slow ones, too, as CI does once a week
	@VENV=$(VENV) scripts/test.sh

test-aids: setup  ## fetch what some tests run: packages of Node.js, NIST's suite for I++ DME
	@$(BIN)/python test/aids.py

test-kilted:  ## a live cell with known truth on ROS 2 Kilted, in .venv-kilted
	@ROTCAL_LONG_TESTS=1 $(MAKE) --no-print-directory ROS_DISTRO=kilted test \
		PYTEST_ARGS="$(KILTED_TESTS)"

docs: setup  ## build the site of the pages strictly; open out/site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "open out/site/index.html"

reproduce: setup  ## compute the papers' tables, figures and claims again: docs/papers
	@for paper in tracer three_rosette two_groups mirror; do \
		$(BIN)/rotcal reproduce $$paper -o docs/papers >/dev/null || exit; done

bench: setup  ## compare speed with well-known alternatives, side by side
	@$(BIN)/python benchmarks/run.py --json out/benchmarks.json

speed: setup  ## race every solver against its strongest peers: docs/speed.md
	@$(BIN)/python -c 'import jax, pyceres' 2>/dev/null || $(BIN)/pip install -q \
		--disable-pip-version-check -c constraints.txt -e '.[peers]'
	@$(BIN)/python benchmarks/run.py --csv research/figures/speed.csv tracer tracer_six ball_plate \
		plane_mirror table_balls two_circles monte_carlo policy

power: setup  ## what could be wrong, and would the verdict say so? docs/what_could_be_wrong.md
	@$(BIN)/python research/power_table.py $(POWER_ARGS)
	@$(BIN)/python research/gathered_table.py $(GATHERED_ARGS)

yardstick: setup  ## is this commit as true, watchful and quick as main? out/yardstick.md, hours
	@$(BIN)/python research/yardstick.py --old main --new HEAD --page out/yardstick.md $(YARDSTICK_ARGS)

data-set: setup  ## make the open data set, and its leaderboard in docs/data_set.md: out/dataset
	@$(BIN)/python research/make_dataset.py --page docs/data_set.md $(DATA_SET_ARGS)

mutants: setup  ## try small faults in the code: do the tests notice? SEED=1 SAMPLE=400
	@$(BIN)/python -c 'import coverage, libcst, mutmut' 2>/dev/null || $(BIN)/pip install -q \
		--disable-pip-version-check --no-build-isolation -c constraints.txt -e '.[mutants]'
	@nice $(BIN)/python scripts/mutants.py --seed $(SEED) --sample $(SAMPLE) $(MUTANTS_ARGS)

fuzz: setup  ## harm inputs and see that reading holds: SECONDS=3600 SEED=1 FUZZ_ARGS="--targets mcap"
	@nice $(BIN)/python scripts/fuzz.py --seconds $(SECONDS) --seed $(SEED) $(FUZZ_ARGS)

soak: setup  ## calibrate beside a busy machine, nodes standing still: SOAK_ARGS="--minutes 10"
	@$(BIN)/python scripts/soak.py $(SOAK_ARGS)

endurance: setup  ## calibrate for hours with kills, full disks, clock jumps: ENDURANCE_ARGS="--minutes 10"
	@$(BIN)/python scripts/endurance.py $(ENDURANCE_ARGS)

lint: setup  ## style, types, and which package may import which
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

release: setup  ## check, build, try with each Python, describe: out/release; RELEASE_ARGS=--rehearse
	@$(BIN)/python -c 'import build, cyclonedx_py' 2>/dev/null || $(BIN)/pip install -q \
		--disable-pip-version-check --no-build-isolation -c constraints.txt -e '.[release]'
	@$(BIN)/python scripts/release.py $(RELEASE_ARGS)

compare-release: setup  ## do two versions solve golden measurements alike? RELEASES="1.0.0 HEAD"
	@nice $(BIN)/python scripts/compare_release.py $(RELEASES)

setup:  ## make or refresh .venv (PYTHON=python3.12 chooses another Python)
	@PYTHON="$(PYTHON)" scripts/setup.sh $(ROS_DISTRO)

clean:  ## remove everything that make has made
	rm -rf .venv .venv-* build install log out *.egg-info packages/*/*.egg-info packages/*/build .coverage .hypothesis .*_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

help:  ## show this list
	@sed -n 's/^\([a-z-]*\):[^#]*## /  make \1\t/p' Makefile | expand -t 20
