"""What a node loads before it begins: twenty of them begin at once, and each second of it is a second of every start."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {"scipy", "coal", "pinocchio", "ompl", "toppra", "mujoco", "matplotlib"}


@pytest.mark.parametrize(
    ("node", "needed"),
    [
        *(
            (name, set())
            for name in ("executor", "pca_monitor", "mqtt_bridge", "mqtt_review", "mqtt_planner", "mock_rsi")
        ),
        *((name, set()) for name in ("virtual_robot", "startup", "static_frames", "sync_view", "speed_limits")),
        ("scene", {"coal", "pinocchio"}),
        ("neighbour", {"coal", "pinocchio"}),
        ("rehearsal", {"coal", "pinocchio"}),
    ],
)
def test_a_node_loads_no_library_that_it_does_not_need(node, needed):
    turn = "import construction_twin.robot.frames as f; f.rotation_to_quaternion(f.rpy_to_rotation((1.0, 2.0, 3.0)))"
    code = f"import sys, construction_twin.ros.nodes.{node}; {turn}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60.0)
    assert HEAVY & set(done.stdout.split()) == needed
