# ua_fleet: `make demo` and `make test` do all set-up themselves.

SHELL := /bin/bash
PYTHON := .venv/bin/python
PYTHON_ROS1 := .venv-ros1/bin/python
# Parts of the system whose absence fails the tests that need them, instead of skipping these:
#   make test REQUIRE=ros1,ros2,node,ur,libmodbus,mbpoll,umockdev,dbus,compiler,netns,npm,node-red,chromium,mosquitto,nats,promtool,postgres
REQUIRE ?=
# Test processes side by side, four a core, since most tests wait for processes that they started: make test JOBS=1
# Which file is given out next is decided by tests/schedule.py.
JOBS ?= $(shell echo $$((4 * $$(nproc 2>/dev/null || echo 1))))
# One group of benchmarks: make bench ONLY=codec
ONLY ?=
# Which demonstration: make demo DEMO=talkrobots
DEMO ?= pal
# More options for pytest (no files) or the demonstration: make test ARGS="-k topics"
ARGS ?=
# Else each process of tests would compile all of our modules and of the tests' for itself.
unexport PYTHONDONTWRITEBYTECODE
# How often a test that failed is run again before it counts as failed; those that were are named, with what went wrong:
#   make test RERUNS=1
RERUNS ?=
# How pytest ends where ARGS choose no test at all, which one of the two environments may.
NO_TESTS = $(if $(ARGS),5,0)

# A disturbance, or some: make testbed ONLY="server:killed rosmaster", or ONLY=runs; KEEP=1 leaves the testbed up
KEEP ?=

# Runs of teleoperation over the whole chain, by their seeds: make test-teleoperation SEEDS=17,40-43
SEEDS ?= 0-199

# Virtual carried runs, by their seeds: make test-carried CARRIED=17,40-43
CARRIED ?= 0-1999

.PHONY: help setup setup-test demo test test-main test-ros1 test-mutations test-teleoperation test-carried picture pictures testbed testbed-check bench lint format docs docs-serve sbom lock clean

help:
	@echo "make demo    the fault-tolerant assembly line: OPC UA server, ROS 1 arm, ROS 2 mobile robot;"
	@echo "             DEMO=talkrobots: nine tasks on seven robots and machines, one of which fails"
	@echo "make test    all tests; what this machine lacks is skipped with the reason"
	@echo "make test-mutations  200,000 mutated messages of JSON and UADP, of which make test has a part"
	@echo "make test-teleoperation  200 runs in which robots are driven by hand and something on the way is cut or stops"
	@echo "make test-carried    2,000 virtual runs that bridges carry, in a network that loses, doubles and cuts, with kills"
	@echo "make testbed compose.yaml on this machine's Docker engine: all profiles to their end, then every kind of"
	@echo "             container disturbed; testbed-check only says what this machine lacks for it"
	@echo "make lint    ruff, mypy, pyright, import rules"
	@echo "make docs    the documentation as a site, in build/site; docs-serve shows it while it is edited"
	@echo "make picture what README begins with, taken anew; pictures: of all pages of the console, in build/pictures"
	@echo "make sbom    what the wheel and the images are made of (CycloneDX), in build/sbom"
	@echo "make bench   measure against peers and floors; ONLY=codec for one group"
	@echo "make setup   the two virtual environments alone; demo and test do it themselves"

# Who ends them by Ctrl-C needs no `Error 130`: make, which gets it too, ends then, and nothing follows.
# It tells `wait: No child processes` where it comes to that only when its child has gone, as on a busy machine: so the
# child waits until make's SIGINT (2 in the mask) does not wait any more.
ENDED = || { [ $$? -eq 130 ] && while ((0x0$$(sed -n 's/^ShdPnd:\s*//p' /proc/$$PPID/status 2>/dev/null) & 2)); do sleep 0.01; done; }

setup:
	@scripts/setup $(ENDED)

setup-test:
	@scripts/setup --test $(ENDED)

demo: setup
	@.venv/bin/ua-fleet demo $(DEMO) $(ARGS) $(ENDED)

REPEATS = $(if $(RERUNS),--reruns $(RERUNS) -raR --rerun-show-tracebacks)

# The tests in the one environment, and in the other, which has rospy.
MAIN_TESTS = $(PYTHON) -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder --require="$(REQUIRE)" $(REPEATS) $(ARGS)
# Bridges alone: what a server stores needs packages that the other does not have.
ROS1_TESTS = $(PYTHON_ROS1) -m pytest tests/contract tests/unit/bridges/ros1 --ignore=tests/contract/history --drivers=ros1 --require="$(REQUIRE)" \
	-p no:cacheprovider $(REPEATS) $(ARGS)

# Those in the environment with rospy wait for most of their time: they run beside the others, and are told at the end.
test: setup-test
	@code=0; ros1=0; pid=; log=$$(mktemp); \
	trap '[ -z "$$pid" ] || kill $$pid 2>/dev/null; rm -f "$$log"' EXIT; \
	if [ -x $(PYTHON_ROS1) ]; then \
		$(ROS1_TESTS) >"$$log" 2>&1 & pid=$$!; \
	else \
		echo "skipped: the contract suite for ROS 1, since there is no .venv-ros1 (see make setup)" >"$$log"; \
	fi; \
	$(MAIN_TESTS) || code=$$?; \
	[ -z "$$pid" ] || wait $$pid || ros1=$$?; \
	pid=; cat "$$log"; \
	[ $$code -eq 0 ] || [ $$code -eq $(NO_TESTS) ] || exit $$code; \
	if [ ! -x $(PYTHON_ROS1) ]; then exit $$code; fi; \
	[ $$ros1 -eq 0 ] || [ $$code-$$ros1 = 0-$(NO_TESTS) ]

test-main: setup-test
	@$(MAIN_TESTS)

test-ros1: setup-test
	@$(ROS1_TESTS)

test-teleoperation: setup-test
	@UA_FLEET_TELEOPERATION_SEEDS=$(SEEDS) $(PYTHON) -m pytest -s tests/teleoperation/test_chain.py --require="$(REQUIRE)" $(ARGS)

test-carried: setup-test
	@UA_FLEET_CARRIED_SEEDS=$(CARRIED) $(PYTHON) -m pytest tests/carried $(ARGS)

# Decoded alone, and as a server hears them over MQTT. The usual run of the tests has a part of those of JSON. And
# 100,000 generated structures of OPC UA Binary, encoded by us and by asyncua.
test-mutations: setup-test
	@UA_FLEET_ALL_MUTATIONS=1 $(PYTHON) -m pytest --timeout=3600 tests/unit/wire/test_fuzz.py \
		tests/unit/wire/json/test_fuzz.py tests/unit/wire/json/test_text_plan.py tests/unit/transport/mqtt/test_hostile_json.py \
		tests/unit/endpoint/test_binary.py $(ARGS)

# Those with which README begins, made by the test that goes through the nine tasks in the page.
picture: setup-test
	$(PYTHON) -m pytest -q tests/e2e/test_talkrobots_page.py --require=chromium,ros1,ros2,ur
	cp build/pictures/console-light.png build/pictures/console-dark.png docs/assets/

# Of each page in both themes and all widths, of which the usual run of the tests keeps none.
pictures: setup-test
	UA_FLEET_PICTURES=1 $(PYTHON) -m pytest -q tests/console --require=chromium $(ARGS)

testbed: setup-test
	@ONLY="$(ONLY)" KEEP="$(KEEP)" $(PYTHON) -m tests.testbed

testbed-check:
	@$(or $(shell command -v python3),$(PYTHON)) -m tests.testbed.checks

bench: setup-test
	$(PYTHON) -m benchmarks $(if $(ONLY),--only $(ONLY))

lint: setup-test
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/pyright
	.venv/bin/lint-imports
	@$(PYTHON) scripts/web.py --run lint

format: setup-test
	.venv/bin/ruff check --fix .
	.venv/bin/ruff format .

# Nothing is left of pages that are gone.
docs: setup-test
	@rm -rf build/site
	@.venv/bin/zensical build --strict
	@echo "build/site/index.html"

docs-serve: setup-test
	.venv/bin/zensical serve

# The images that docker compose has built here, if any.
sbom: setup-test
	@$(PYTHON) scripts/sbom.py wheel build/sbom
	@images=$$(docker images --format '{{.Repository}}:{{.Tag}}' 'ua-fleet/*' 2>/dev/null | sort); \
	if [ -n "$$images" ]; then $(PYTHON) scripts/sbom.py images build/sbom $$images; \
	else echo "no images of ua-fleet are on this machine (docker compose build makes them): only the wheel's"; fi

lock:
	uv pip compile pyproject.toml --universal --python-version 3.11 --group build --group web --group dev --group docs --group ros1-tests \
		--extra server --extra client --extra ros2 --extra modbus --extra ur --extra sensors --extra plot --extra recording --extra postgres --extra keyring --extra console \
		--no-emit-index-url --no-emit-find-links --no-annotate --no-header --generate-hashes --quiet --output-file requirements.lock

clean:
	rm -rf .venv .venv-ros1 .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache .cache build dist
