# construction_twin: `make demo` and `make test` do all the set-up they need.

.PHONY: help setup demo build test lint bench clean

help:
	@echo "make demo             run the paper's experiment headless and print its Table 1"
	@echo "make demo ARGS=\"quick:=true decimals:=6 servo:=realistic\"   the same with launch arguments"
	@echo "make demo ARGS=gazebo the same with the twin in Gazebo 11, from a Debian 11 chroot where it is not installed; launch arguments behind it"
	@echo "make demo ARGS=screenshots   take the pictures of docs/images again; needs no display; ARGS=\"screenshots one console\": some"
	@echo "make build            build the timber panel of models/ with the mock arm on its track; ARGS=\"quick:=true\" three elements of it"
	@echo "make test             build and run every test; ARGS=unit, browser, integration, lint, or the name of a launch test: a part"
	@echo "make test ARGS=fast   the shortest unit tests, as many as fit into two minutes by what they took last time"
	@echo "make test ARGS=changed   lint, and what a change touches; ARGS=changed=COMMIT since then"
	@echo "make test ARGS=mutations   break chosen lines one at a time: a named test must notice each; ARGS=\"mutations gateway --workers 1\""
	@echo "make test ARGS=properties  the property tests with new random examples; make test takes the same ones every time; ARGS=\"properties -k follower\""
	@echo "make test ARGS=fuzz   a million hostile messages and telegrams each at a running gateway; ARGS=\"fuzz COUNT SEED\""
	@echo "make test ARGS=scenarios   every fault scenario three times; results/scenarios has the verdicts; ARGS=\"scenarios estop --runs 1\""
	@echo "make test ARGS=soak   the whole system for an hour: memory and late replies per minute; ARGS=\"soak --minutes 5\""
	@echo "make lint             check style, format, order of the folders, types and size; make test does it too"
	@echo "make bench            measure inverse kinematics, planning, the start, link, work, monitor, console and stops; writes results/bench/*.json; ARGS=ik for one of them"
	@echo "make setup            only install and build"
	@echo "make clean            remove the workspace and the venv (.ws), and what pip built here"

setup:
	@bash setup/setup.sh

demo: setup
	@bash -c 'source .ws/env.bash && exec python scripts/demo.py demo "$$@"' demo $(ARGS)

build:
	@bash setup/setup.sh work
	@bash -c 'source .ws/env.bash && exec python scripts/demo.py build "$$@"' build $(ARGS)

test:
	@bash setup/setup.sh tests
	@bash -c 'source .ws/env.bash && exec python scripts/run_tests.py "$$@"' test $(ARGS)

lint: setup
	@bash -c 'source .ws/env.bash && exec python scripts/run_tests.py lint'

bench:
	@bash setup/setup.sh tests
	@bash -c 'source .ws/env.bash && exec python scripts/bench.py "$$@"' bench $(ARGS)

clean:
	rm -rf .ws build src/*.egg-info
