#!/usr/bin/env python3
"""A shipped scenario as a user runs it: starts launch/scenario.launch and reads its verdict.

Every scenario runs on the simulated chain, with the same judge, in `test/unit/chain/test_scenarios.py`; a few of them here as well.

`test_scenario.py NAME broker_port:=N rsi_port:=N`
"""

import json
import sys
import tempfile
import unittest
from pathlib import Path

import rostest
from started import Started

#: The name and the ports; what rostest adds begins with `--` or `__`. In sys.argv itself `port:=N` would be a remapping.
ARGUMENTS = [argument for argument in sys.argv[1:] if not argument.startswith(("-", "_"))]
#: Longest that a scenario may take, with start-up and judgement, on a busy machine [s].
TIME_LIMIT = 150


class ScenarioTest(unittest.TestCase):
    """One run of one scenario."""

    def test_the_cell_does_what_the_scenario_expects(self):
        name, *ports = ARGUMENTS
        with tempfile.TemporaryDirectory() as results:
            words = [f"scenario:={name}", f"results_dir:={results}", f"gateway_trace:={results}/trace", *ports]
            launch = Started("roslaunch", "construction_twin", "scenario.launch", *words, COLUMNS="160")
            output = launch.finish(TIME_LIMIT)
            path = Path(results) / name / "verdict.json"
            self.assertTrue(path.is_file(), f"there is no verdict:\n{output[-6000:]}")
            verdict = json.loads(path.read_text())
        states = [f"{c['at_s']:9.3f} {c['topic']} {c['value']}: {c['reason']}" for c in verdict["changes"]]
        failed = [f"{c['name']}: {c['found']}; expected {c['expected']}" for c in verdict["checks"] if not c["passed"]]
        self.assertTrue(verdict["passed"], "\n".join([*failed, *states]))
        self.assertIn(f"{name}: passed", output)
        print(json.dumps(verdict["measured"]), flush=True)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "scenario", ScenarioTest, sys.argv)
