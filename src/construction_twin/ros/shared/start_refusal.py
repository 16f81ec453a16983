"""How a start is refused: a node publishes one sentence on `start_refused`, and `startup` ends the launch.

Where the arm may be moving by now `startup` does not: then the node ends after a while, and roslaunch starts it again.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import rosgraph

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.ros.shared.master import RunningNode, running

#: In the robot's namespace; of broker and console, which serve several robots, in the one above.
TOPIC = "start_refused"
#: Variable that bringup.launch gives to its nodes, and parameter of the robot: which roslaunch it is of.
VARIABLE, PARAMETER = "CONSTRUCTION_TWIN_LAUNCH", "launch"
#: After that a node that cannot start ends, and is started again [s].
RESTART_DELAY = 10.0


def launch_id() -> str:
    """Return which roslaunch started this process; empty: none, or a foreign launch file."""
    return os.environ.get(VARIABLE, "")


def expect_no_other(name: str) -> None:
    """Raise a ConfigurationError where a node of this name runs, or another launch has started the robot."""
    uri = rosgraph.get_master_uri()
    name = rosgraph.names.load_mappings(sys.argv).get("__name", name)
    own, startup = (rosgraph.names.ns_join(rosgraph.names.get_ros_namespace(), each) for each in (name, "startup"))
    # what all nodes of a second launch find alike comes first
    others = [
        node for node in running([startup] if launch_id() else [], uri) if node.pid is not None and not _is_beside(node)
    ]
    found = others or running([own], uri)
    if found:
        expected = f"no such node on {uri}: end its launch, or give another robot"
        raise ConfigurationError(found[0].name, str(found[0]), expected)


def _is_beside(node: RunningNode) -> bool:
    try:
        return f"{VARIABLE}={launch_id()}".encode() in Path(f"/proc/{node.pid}/environ").read_bytes().split(b"\0")
    except OSError:
        return False  # of another machine, or user


def exec_unless_running() -> None:
    """Execute the program that this one's words name, unless a node of its name runs: for stock nodes of a launch."""

    def exec_program() -> None:
        expect_no_other("")
        os.execvp(sys.argv[1], sys.argv[1:])

    run_program(rosgraph.names.load_mappings(sys.argv).get("__name", "alone"), exec_program)


def expect_own_parameters() -> None:
    """Raise a ConfigurationError where a later launch has replaced the robot's parameters."""
    import rospy

    if launch_id() and rospy.get_param(PARAMETER, launch_id()) != launch_id():
        found = f"parameters of another launch in {rospy.get_namespace()}"
        expected = "this one's: when the arm stands, end both launches, and start one"
        raise ConfigurationError(rospy.resolve_name(PARAMETER), found, expected)


def refuse(sentence: str, log: bool = True) -> NoReturn:
    """End a node that cannot start: in a launch publish why, print it too (`log`), and wait `RESTART_DELAY`; else at once."""
    import rospy

    from construction_twin.msg import StartRefused

    if not launch_id():
        sys.exit(f"{rospy.get_name()} cannot start: {sentence}")
    publisher = rospy.Publisher(TOPIC, StartRefused, queue_size=1, latch=True)
    publisher.publish(launch_id(), sentence)
    if log:
        print(f"cannot start: {sentence}", flush=True)
    ended = threading.Event()
    rospy.on_shutdown(ended.set)
    ended.wait(RESTART_DELAY)
    sys.exit(0)


def run_program(name: str, main: Callable[[], int | None]) -> NoReturn:
    """Run a program that speaks no ROS, as a node of a launch; what it raises at its start refuses that."""
    try:
        sys.exit(main())
    except ConstructionTwinError as error:
        if not launch_id():
            sys.exit(f"{name}: {error}")
        import rospy

        try:
            # under a name that ends no other node
            rospy.init_node(name, argv=sys.argv[:1], anonymous=True)
        except rospy.exceptions.ROSInitException:
            sys.exit(1)  # it is asked to end
        refuse(str(error), log=False)
