"""The last failure of a running system, as a file for `construction_twin.replay`."""

from __future__ import annotations

import json
from typing import Any

import rospy
from sensor_msgs.msg import JointState

from construction_twin.core.errors import RequestRefused, SilenceError
from construction_twin.core.records import json_value
from construction_twin.monitor.settings import GateSettings
from construction_twin.msg import PlanOutcome
from construction_twin.planning.planner import PlannerSettings
from construction_twin.replay import AGREED, failure, replay
from construction_twin.robot.urdf import read_text
from construction_twin.ros.shared.params import robot_from_parameters
from construction_twin.ros.shared.robot_client import OperatorClient
from construction_twin.views.texts import Snapshot


def running_failure(namespace: str, now: Snapshot, client: OperatorClient) -> str:
    """Return the last plan that failed, else the hold of now, as JSON; RequestRefused: neither is there."""
    state = {name: json_value(getattr(now, name)) for name in ("link", "sync", "execution", "hold")}
    planner = rospy.get_param(f"{namespace}/planner")
    robot: dict[str, Any] = {
        "urdf": rospy.get_param(f"{namespace}/robot_description"),
        "description": rospy.get_param(f"{namespace}/robot"),
        "self_collision": read_text(planner["self_collision"]),
    }
    try:
        outcome = client.latched("plan_outcome", PlanOutcome, "no plan was asked for", "ask for one")
    except SilenceError:
        outcome = PlanOutcome(success=True)
    if not outcome.success and outcome.request:
        settings = {name: planner[name] for name in PlannerSettings.model_fields}
        return failure("plan", outcome.message, state, robot=robot, settings=settings, **json.loads(outcome.request))
    if now.hold is None or not now.hold.since or now.sync is None:
        raise RequestRefused("nothing has failed: the last plan was made, and the gate is not held")
    joints = robot_from_parameters(f"{namespace}/").joint_names
    poses = {}
    for name in ("twin", "physical"):
        message = client.latched(f"{name}/joint_states", JointState, "there is no pose", "see why it is down")
        held = dict(zip(message.name, message.position))
        poses[name] = [held[joint] for joint in joints]
    monitor = rospy.get_param(f"{namespace}/pca_monitor")
    settings = {name: monitor[name] for name in GateSettings.model_fields if name in monitor}
    # those of now, which `configure_gate` changes; the twin rests, so that they are the joints' own
    settings["thresholds"] = {joint: value for joint, value in zip(now.sync.name, now.sync.threshold) if value > 0}
    hold = {"robot": robot, "settings": settings, "decimals": monitor["decimals"], **poses}
    if (sentence := replay({"kind": "hold", **hold})) == AGREED:
        raise RequestRefused(f"the poses do not keep the gate closed: {now.hold.cause}")
    return failure("hold", sentence, state, **hold)
