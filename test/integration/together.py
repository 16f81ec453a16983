#!/usr/bin/env python3
"""Several files of tests on one bringup: `together.py test_garbage test_kill` runs them in this order.

Each has a client of its own and waits for what it needs at its begin. What would take another one's start away (a node that names
each sender once, a counter that must be 0, the home pose) comes first.
"""

import importlib
import sys
import unittest

import rospy
import rostest

#: The names of the files; what rostest adds begins with `--` or `__`.
NAMES = [argument for argument in sys.argv[1:] if not argument.startswith(("-", "_"))]


def suite() -> unittest.TestSuite:
    """Return the tests of all files, in the order of the command line."""
    rospy.init_node("together")
    # a process is one node, and keeps the name that rostest gave it
    rospy.init_node = lambda *_, **__: None
    loader = unittest.TestLoader()
    return unittest.TestSuite(loader.loadTestsFromModule(importlib.import_module(name)) for name in NAMES)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "together", "together.suite", sys.argv)
