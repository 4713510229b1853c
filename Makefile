# `make help` lists what this can do. Needs GNU make, a POSIX shell and Python 3.10 to 3.14.

# Empty: the newest Python that suits, 3.14 last. Otherwise: make run PYTHON=/path/to/python3.12
PYTHON =
SCENARIO = scenarios/tower.yaml
# make test CONSTRAINTS=/dev/null takes the newest versions of all libraries.
CONSTRAINTS = constraints.txt
# What `make gpu` examines: cuda, vulkan or metal. A quick trial of the command itself:
# make gpu ARCH=vulkan GPU_OPTIONS='--brief --sizes 1e3 --joint-sizes 20 40 --study-sizes 12'
ARCH = cuda
GPU_OPTIONS =
# Rooms whose tests `make check` runs: those without kernels and whole runs.
ROOMS = base evaluation formats measurements records scenario sensing
# Roundings, and rooms or files of tests, of `make roundings`; all if empty.
KINDS =
TESTS =
# What `make lowest` runs: all methods, and tests of whatever calls a library.
LOWEST_TESTS = tests/cli/test_commands.py::test_help_shows_an_example \
	tests/cli/test_commands.py::test_schema_accepts_what_is_shipped_and_refuses_what_is_not \
	$(addprefix tests/,app/test_doctor.py cli/test_interop.py cli/test_localize.py cli/test_page.py \
		evaluation formats/test_bags.py formats/test_foreign_formats.py \
		localization/test_second_program.py records/test_compressed_logs.py report/pictures \
		report/test_figures.py report/test_page.py scenario/test_load.py study/test_executors.py)
# `make run SYSTEM_LIBRARIES=no` leaves the machine's own packages alone.
SYSTEM_LIBRARIES = yes

bin = .venv/bin
# Workers begin with tests in a row, which share fixtures, and take over some of a slower one's.
tests = $(bin)/python -m pytest -n auto --dist worksteal
inputs = pyproject.toml constraints.txt tiswarm/base/version.py
# Each of these files stands for a step that was done; a step is done again once they are older
# than its inputs.
installed = .venv/.installed
installed_dev = .venv/.installed-dev
system_checked = $(if $(filter no,$(SYSTEM_LIBRARIES)),,.venv/.system-checked)
# An environment works in one folder only: in a copied checkout it would run the original's code.
made_in = .venv/.made-in

.NOTPARALLEL:
.DELETE_ON_ERROR:
.PHONY: help run test trial lowest roundings check docs gpu lint format clean unusable

help:  ## List what can be made
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-7s %s\n", $$1, $$2 }' Makefile

run: $(installed) $(system_checked)  ## Set up, then run a scenario (SCENARIO=scenarios/tower.yaml)
	$(bin)/tiswarm run "$(SCENARIO)"

test: lint $(system_checked)  ## Set up with the developers' tools, then check every claim
	$(tests) --durations=25

trial: $(installed_dev) $(system_checked)  ## Check claims at full size, processes, packages, devices
	$(tests) -m "trial and not slow" --durations=25

lowest:  ## Run tests with the lowest versions of libraries that are allowed, in build/lowest
	$(call make_environment,$(lowest))
	@$(lowest)/bin/python -m pip --disable-pip-version-check install --quiet uv
	@extra=$$($(uv_install) --dry-run --no-deps --only-binary :all: $(open3d) 2> $(lowest)/.open3d-log \
			&& echo "--extra open3d"); \
		$(uv_install) --only-binary :all: --resolution lowest-direct \
			--requirements pyproject.toml $$extra \
			$(patsubst %,--extra %,cluster gsd learn mcap parquet ros video)
	@$(uv_install) --no-deps $(findable) --editable .
	@$(uv_install) hypothesis pytest pytest-xdist
	$(lowest)/bin/python -m pytest -n auto --dist worksteal $(old_warns) $(LOWEST_TESTS)

roundings: $(installed_dev) $(system_checked)  ## Test numbers under other roundings (KINDS=busy TESTS=world)
	$(bin)/python -m tests.roundings $(if $(KINDS),--kinds $(KINDS)) -- $(TESTS)

check: lint  ## Check style, types and contracts, and run quick tests (ROOMS='world study')
	$(tests) --quiet tests/test_architecture.py tests/test_pages.py \
		$(ROOMS:%=tests/%)

docs: $(installed_dev)  ## Build the site of the documentation, build/docs/index.html
	$(bin)/python -m sphinx --quiet --fail-on-warning --keep-going docs build/docs
	@echo "open build/docs/index.html"

gpu: $(installed_dev) $(system_checked)  ## Check and measure a graphics card (ARCH=cuda)
	$(bin)/python -m benchmarks.gpu --arch $(ARCH) $(GPU_OPTIONS)

lint: $(installed_dev)  ## Check format, style, types and architecture
	$(bin)/ruff format --check --quiet .
	$(bin)/ruff check --quiet .
	$(bin)/mypy
	$(bin)/lint-imports --no-logo

format: $(installed_dev)  ## Format, and mend what can be mended safely
	$(bin)/ruff format .
	$(bin)/ruff check --fix .

clean:  ## Remove .venv, caches and build leftovers; reports stay
	rm -rf .venv build dist *.egg-info .*_cache .hypothesis .coverage htmlcov
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# --- set-up ----------------------------------------------------------------------------------

usable := $(shell test "$$(cat $(made_in) 2>/dev/null || pwd)" = "$$(pwd)" \
	&& $(bin)/python -c 'import pip' 2>/dev/null && echo yes)
ifneq ($(usable),yes)
$(bin)/python: unusable
$(shell rm -f .venv/.installed .venv/.installed-dev .venv/.system-checked)
endif

suits = import sys, venv, ensurepip; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 14))
candidates = $(if $(PYTHON),"$(PYTHON)",python3.13 python3.12 python3.11 python3.10 python3.14 python3)

define make_environment
	@for python in $(candidates); do \
		if "$$python" -c '$(suits)' 2>/dev/null; then \
			echo "making $(1) with $$("$$python" --version)"; \
			rm -rf $(1) && "$$python" -m venv $(1); \
			exit; \
		fi; \
	done; \
	echo "$(if $(PYTHON),$(PYTHON) is not a,found no) Python 3.10 to 3.14 with venv:" \
		"install python3 and python3-venv, or say make PYTHON=/path/to/python3" >&2; \
	exit 1
endef

$(bin)/python:
	$(call make_environment,.venv)

# The build tool comes from constraints.txt too, hence no isolated build.
pip_install = $(bin)/python -m pip --disable-pip-version-check install -c "$(CONSTRAINTS)"
# Beside a clone, Python takes the clone's folder for the package unless its place is in a .pth file.
findable = --config-settings editable_mode=compat
# Of pip's report only the large downloads are shown; errors are.
comma = ,
# Without a wheel for this Python and system, as with glibc before 2.31, the renderer taichi draws.
open3d = $(if $(filter Linux-x86_64,$(shell uname -s)-$(shell uname -m)),open3d-cpu,open3d)
define install
	@echo "installing $(2) into .venv; the first time that takes minutes"
	@{ $(pip_install) --quiet setuptools \
		&& if $(pip_install) --no-deps --only-binary :all: $(open3d) 2> .venv/.open3d-log; then \
			wanted='.[$(if $(1),$(1)$(comma))open3d]'; \
		else \
			wanted='.$(if $(1),[$(1)])'; \
			echo "no open3d for this Python and system: taichi draws pictures" \
				"(see .venv/.open3d-log)" >&2; \
		fi && $(pip_install) --no-build-isolation $(findable) --editable "$$wanted"; \
		echo $$? > .venv/.pip-status; } \
		| sed -n -e 's/^ *\(Downloading .* MB)\).*/  \1/p' \
			-e 's/^Installing collected packages.*/  Installing/p'; \
	exit "$$(cat .venv/.pip-status)"
	@pwd > $(made_in)
endef

# Compiled as pip does, because a compilation in a test warns of old code.
lowest = build/lowest
uv_install = $(lowest)/bin/uv pip install --quiet --python $(lowest)/bin/python --compile-bytecode
# Old libraries warn of what new versions of Python and of libraries will take away.
old_warns = -W ignore::DeprecationWarning -W ignore::PendingDeprecationWarning

$(installed): $(inputs) | $(bin)/python
	$(call install,,tiswarm)
	@touch $@

$(installed_dev): $(inputs) | $(bin)/python
	$(call install,dev,tiswarm and the developers' tools)
	@touch $(installed) $@

# Taichi, open3d and the tests of devices need libraries that pip cannot bring.
.venv/.system-checked: tiswarm/app/doctor.py $(installed)
	@missing=$$($(bin)/tiswarm doctor --missing-packages) \
		|| { echo "warning: could not look for system libraries" >&2; exit 0; }; \
	if test -z "$$missing"; then \
		:; \
	elif ! command -v apt-get >/dev/null; then \
		echo "libraries are missing: install what Debian calls $$missing"; \
	elif test "$$(id -u)" -ne 0; then \
		echo "libraries are missing: sudo apt-get install $$missing"; \
	else \
		echo "installing system libraries: $$missing"; \
		{ apt-get update && DEBIAN_FRONTEND=noninteractive \
			apt-get install -y --no-install-recommends $$missing; } > .venv/.apt-log 2>&1 \
		|| echo "warning: that failed (see .venv/.apt-log); pictures will be simpler," \
			"and tests of devices fail" >&2; \
	fi; \
	touch $@
