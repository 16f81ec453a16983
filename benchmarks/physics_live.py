"""Part of the physics benchmark: the rate of one twin beside the whole system, as a process of its own for each twin.

    python benchmarks/physics_live.py mujoco

Prints JSON: ``rate_hz`` of `twin/joint_states`, ``jitter_ms_p99`` of the time between two of them, and ``cores`` that
`virtual_robot` took.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import rosgraph
import rosnode
import rospy
from bringup import START, bringup
from construction_twin.msg import Sync
from link_world import cpu_seconds, wait_for
from sensor_msgs.msg import JointState

from construction_twin.core.units import CYCLE

#: For so long it is measured [s].
MEASURED = 20.0
ROBOT = "kr120"


def measured(twin: str) -> dict[str, float]:
    """Run the system with this twin, and return the figures."""
    with bringup(f"twin:={twin}", "rehearsal:=off"):
        master = rosgraph.Master("/bench_physics")
        wait_for(master.is_online, START, "a ROS master")
        rospy.init_node("bench_physics", disable_signals=True)
        arrivals: list[float] = []
        states: list[int] = []
        rospy.Subscriber(f"/{ROBOT}/sync", Sync, lambda message: states.append(message.state))
        wait_for(lambda: states and states[-1] == Sync.IN_SYNC, START, "twin and arm in sync")
        pid = _process(master)
        rospy.Subscriber(
            f"/{ROBOT}/twin/joint_states", JointState, lambda _message: arrivals.append(time.perf_counter()),
            tcp_nodelay=True, queue_size=None,
        )  # fmt: skip
        wait_for(lambda: len(arrivals) > 250, START, "the twin's poses")
        first, used = len(arrivals), cpu_seconds(pid)
        wait_for(lambda: arrivals[-1] - arrivals[first - 1] >= MEASURED, 3 * MEASURED, "the end")
        used = cpu_seconds(pid) - used
        times = np.array(arrivals[first - 1 :])
    seconds = float(times[-1] - times[0])
    return {
        "rate_hz": round((len(times) - 1) / seconds, 2),
        "jitter_ms_p99": round(float(np.percentile(np.abs(np.diff(times) - CYCLE), 99)) * 1e3, 3),
        "cores": round(used / seconds, 3),
    }


def _process(master: rosgraph.Master) -> int:
    """Return the process of the twin."""
    api = master.lookupNode(f"/{ROBOT}/virtual_robot")
    code, message, pid = rosnode.ServerProxy(api).getPid("/bench_physics")
    if code != 1:
        raise RuntimeError(message)
    return pid


if __name__ == "__main__":
    json.dump(measured(sys.argv[1]), sys.stdout)
