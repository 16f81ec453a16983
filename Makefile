# construction_twin: `make demo` and `make test` do all the set-up they need.

.PHONY: help setup demo gazebo build test lint mutations bench properties fuzz scenarios soak screenshots clean

help:
	@echo "make demo             run the paper's experiment headless and print its Table 1"
	@echo "make demo ARGS=\"quick:=true decimals:=6 servo:=realistic\"   the same with launch arguments"
	@echo "make gazebo           the same with the twin in Gazebo 11, from a Debian 11 chroot where it is not installed; ARGS as of make demo"
	@echo "make build            build the timber panel of models/ with the mock arm on its track; ARGS=\"quick:=true\" three elements of it"
	@echo "make test             build and run every test; ARGS=unit, browser, integration, lint, or the name of a launch test: a part"
	@echo "make test ARGS=fast   the shortest unit tests, as many as fit into two minutes by what they took last time"
	@echo "make test ARGS=changed   lint, and what a change touches; ARGS=changed=COMMIT since then"
	@echo "make lint             check style, format, order of the folders and types; make test does it too"
	@echo "make mutations        break chosen lines one at a time: a named test must notice each; ARGS=\"gateway --workers 1\""
	@echo "make bench            measure inverse kinematics, planning, the start, link, work, monitor, console and stops; writes results/bench/*.json; ARGS=ik for one of them"
	@echo "make properties       the property tests with new random examples; make test takes the same ones every time; ARGS=\"-k follower\""
	@echo "make fuzz             a million hostile messages and telegrams each at a running gateway; ARGS=\"COUNT SEED\""
	@echo "make scenarios        every fault scenario three times; results/scenarios has the verdicts"
	@echo "make soak             the whole loop for an hour: memory and late replies per minute"
	@echo "make screenshots      take the pictures of docs/images again; needs no display; ARGS=\"one marker track two_robots\", ARGS=console"
	@echo "make setup            only install and build"
	@echo "make clean            remove the workspace and the venv (.ws), and what pip built here"

setup:
	@bash setup/setup.sh

demo: setup
	@bash -c 'source .ws/env.bash && exec python scripts/demo.py "$$@"' demo $(ARGS)

gazebo: setup
	@bash -c 'source .ws/env.bash; server=gzserver; command -v gzserver >/dev/null || { scripts/gazebo_chroot.sh make && server="$$PWD/scripts/gazebo_chroot.sh run gzserver"; } && GZSERVER="$$server" exec python scripts/demo.py twin:=gazebo servo:=realistic "$$@"' gazebo $(ARGS)

build:
	@bash setup/setup.sh work
	@bash -c 'source .ws/env.bash && exec python scripts/build.py "$$@"' build $(ARGS)

test:
	@bash setup/setup.sh tests
	@bash -c 'source .ws/env.bash && python scripts/run_tests.py $(ARGS)'

lint: setup
	@bash -c 'source .ws/env.bash && python scripts/lint.py'

mutations:
	@bash setup/setup.sh tests
	@bash -c 'source .ws/env.bash && python scripts/mutations.py $(ARGS)'

bench:
	@bash setup/setup.sh tests
	@bash -c 'source .ws/env.bash && python scripts/bench.py $(ARGS)'

properties: setup
	@bash -c 'source .ws/env.bash && HYPOTHESIS_PROFILE=random exec python -m pytest -q -p no:cacheprovider $$(grep -rl "^from hypothesis" test/unit test/extensions --include="test_*.py") $(ARGS)'

fuzz: setup
	@bash -c 'source .ws/env.bash && FUZZ_COUNT=$${1:-1000000} FUZZ_SEED=$${2:-1} exec python -m pytest -q -s test/unit/gateway/test_fuzz.py' fuzz $(ARGS)

scenarios: setup
	@bash -c 'source .ws/env.bash && python scripts/scenarios.py $(ARGS)'

soak: setup
	@bash -c 'source .ws/env.bash && python scripts/soak.py $(ARGS)'

screenshots:
	@bash setup/setup.sh $$(case "$(ARGS)" in ""|console*) echo tests;; esac)
	@bash -c 'source .ws/env.bash; [ "$$1" = console ] || python tools/screenshots.py "$$@" || exit; case "$$1" in ""|console) exec .ws/browser/bin/python tools/console_pictures.py;; esac' screenshots $(ARGS)

clean:
	rm -rf .ws build src/*.egg-info
