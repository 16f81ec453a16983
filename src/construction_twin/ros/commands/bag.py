"""Reads a rosbag into a `Recording`. Needs no ROS master and no running node.

A bag may come from elsewhere: it is opened by `known_bag.open_bag`, which runs no code from it.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import genpy
import numpy as np
import rosbag
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.evaluation.recording import (
    FeedbackStream,
    LinkSnapshot,
    PlayedPlan,
    Recording,
    StateChange,
    Stream,
)
from construction_twin.msg import Execution, Feedback, Link, Plan, Sync
from construction_twin.robot.plan import Plan as PlanValue
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.shared.known_bag import open_bag

TWIN = "twin/joint_states"
PHYSICAL = "physical/joint_states"
FEEDBACK = "physical/feedback"
COMMAND = "command/joint_states"
EXECUTION = "execution"
PLAN = "plan"
LINK = "link"
SYNC = "sync"
MOCK = "mock_rsi/status"
#: Topics read, relative to the robot's namespace. Only twin and physical have to be there.
TOPICS = (TWIN, PHYSICAL, FEEDBACK, COMMAND, EXECUTION, PLAN, LINK, SYNC, MOCK)
#: Reports whose changes of state are told, and what they are called.
REPORTS = {SYNC: "gate", EXECUTION: "execution", LINK: "link"}

#: Type each topic must have. The bag is read with these classes; another definition of the same type is refused.
TYPES: dict[str, type[genpy.Message]] = {
    TWIN: JointState,
    PHYSICAL: JointState,
    FEEDBACK: Feedback,
    COMMAND: JointState,
    EXECUTION: Execution,
    PLAN: Plan,
    LINK: Link,
    SYNC: Sync,
    MOCK: String,
}


def read_recording(path: str | Path, namespace: str | None = None) -> Recording:
    """Read one robot's run from a bag.

    Parameters
    ----------
    path : str or Path
    namespace : str, optional
        The robot's namespace, e.g. ``/kr120``; default: that of the only robot in the bag.

    Returns
    -------
    recording : Recording

    Raises
    ------
    ConstructionTwinError
        If the file cannot be read as a bag, holds no or several robots, a topic of another type or of another definition of
        its type, or too little data.
    """
    with open_bag(path, TYPES.values()) as bag:
        types = {topic: info.msg_type for topic, info in bag.get_type_and_topic_info().topics.items()}
        robot = _choose_robot(types, namespace)
        messages = _read_messages(bag, robot, types)
    return _to_recording(robot, messages)


def read_plans(path: str | Path, namespace: str | None = None) -> list[PlanValue]:
    """Return every plan of one robot in a bag, the oldest first.

    Parameters
    ----------
    path, namespace
        As in `read_recording`.

    Raises
    ------
    ConstructionTwinError
        As `read_recording`.
    TrajectoryError
        For a plan that is not what its hash says.
    """
    with open_bag(path, TYPES.values()) as bag:
        types = {topic: info.msg_type for topic, info in bag.get_type_and_topic_info().topics.items()}
        messages = _read_messages(bag, _choose_robot(types, namespace), types, (PLAN,))
    # a latched plan is recorded once more by whoever listens again
    return list({message.id: plan_from_msg(message) for _, message in messages[PLAN]}.values())


def robots_in(topics: Iterable[str]) -> list[str]:
    """Return the namespaces that hold a ``twin/joint_states``, sorted; ``/`` for the root."""
    return sorted(topic[: -len(TWIN)].rstrip("/") or "/" for topic in topics if topic.endswith(f"/{TWIN}"))


def _choose_robot(types: dict[str, str], namespace: str | None) -> str:
    robots = robots_in(types)
    if not robots:
        raise ConstructionTwinError(f"the bag holds no topic .../{TWIN}; record at least .../{TWIN} and .../{PHYSICAL}")
    if namespace is None:
        if len(robots) > 1:
            raise ConstructionTwinError(f"the bag holds the robots {', '.join(robots)}; choose one with --robot")
        return robots[0]
    wanted = "/" + namespace.strip("/")
    if wanted not in robots:
        raise ConstructionTwinError(f"the bag holds no robot {wanted}; it holds {', '.join(robots)}")
    return wanted


def _read_messages(
    bag: rosbag.Bag, robot: str, types: dict[str, str], wanted: Iterable[str] = TOPICS
) -> dict[str, list[tuple[int, Any]]]:
    """Return per topic (relative) the pairs of reception [ns] and message, in order of reception."""
    relative = {f"{robot.rstrip('/')}/{topic}": topic for topic in wanted}
    for topic, name in relative.items():
        found = types.get(topic)
        if found not in (None, TYPES[name]._type):
            raise ConstructionTwinError(f"{topic} in the bag is a {found}; expected a {TYPES[name]._type}")
    messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for topic, message, received in bag.read_messages(topics=list(relative)):
        messages[relative[topic]].append((received.to_nsec(), message))
    return messages


def _to_recording(robot: str, messages: dict[str, list]) -> Recording:
    for name in (TWIN, PHYSICAL):
        if not messages[name]:
            raise ConstructionTwinError(
                f"the bag holds no messages on {robot.rstrip('/')}/{name}; is that side recorded?"
            )
    reported = set(messages[PHYSICAL][0][1].name)
    joints = tuple(name for name in messages[TWIN][0][1].name if name in reported)
    return Recording(
        robot=robot,
        joint_names=joints,
        twin=_stream(messages[TWIN], joints, TWIN),
        physical=_stream(messages[PHYSICAL], joints, PHYSICAL),
        feedback=_feedback(messages[FEEDBACK], joints),
        command=_stream(messages[COMMAND], joints, COMMAND) if messages[COMMAND] else None,
        plans=_plans(messages[EXECUTION]),
        waypoints={message.id: len(message.trajectory.points) for _, message in messages[PLAN]},
        links=tuple(_link(received, message) for received, message in messages[LINK]),
        mock=_mock(messages[MOCK]),
        changes=_changes(messages),
    )


def _changes(messages: dict[str, list]) -> tuple[StateChange, ...]:
    """Return when the reported states became others; what a report says first counts too."""
    changes = []
    for topic, source in REPORTS.items():
        before = None
        for _, message in messages[topic]:
            # the words, not the numbers: those of older bags meant other states
            if message.text != before:
                before = message.text
                changes.append(StateChange(message.header.stamp.to_nsec(), source, before, message.reason))
    return tuple(sorted(changes, key=lambda change: change.stamp))


def _arrays(messages: list, joints: tuple[str, ...], topic: str) -> dict[str, np.ndarray]:
    columns: dict[tuple[str, ...], list[int]] = {}
    rows = []
    for _, message in messages:
        names = tuple(message.name)
        if names not in columns:
            missing = [joint for joint in joints if joint not in names]
            if missing:
                raise ConstructionTwinError(
                    f"a message on {topic} lacks {', '.join(missing)}; each must name all joints"
                )
            columns[names] = [names.index(joint) for joint in joints]
        if len(message.position) != len(names):
            raise ConstructionTwinError(
                f"a message on {topic} has {len(message.position)} positions for {len(names)} joints"
            )
        rows.append([message.position[column] for column in columns[names]])
    return {
        "stamps": np.array([message.header.stamp.to_nsec() for _, message in messages], dtype=np.int64),
        "positions": np.array(rows, dtype=float).reshape(len(rows), len(joints)),
        "received": np.array([received for received, _ in messages], dtype=np.int64),
    }


def _stream(messages: list, joints: tuple[str, ...], topic: str) -> Stream:
    return Stream(**_arrays(messages, joints, topic))


def _feedback(messages: list, joints: tuple[str, ...]) -> FeedbackStream | None:
    if not messages:
        return None
    return FeedbackStream(
        **_arrays(messages, joints, FEEDBACK),
        seq=np.array([message.seq for _, message in messages], dtype=np.uint64),
        command_stamps=np.array([message.command_stamp.to_nsec() for _, message in messages], dtype=np.int64),
    )


def _plans(messages: list) -> tuple[PlayedPlan, ...]:
    """Return the executions, each with the last outcome that was reported for it."""
    plans: dict[tuple[str, int], PlayedPlan] = {}
    for _, message in messages:
        start = message.plan_start.to_nsec()
        if message.plan_id and start:
            done = message.state not in (message.PLAYING, message.STOPPING)
            outcome = message.outcome if done else ""
            plans[message.plan_id, start] = PlayedPlan(message.plan_id, start, message.duration, outcome)
    return tuple(sorted(plans.values(), key=lambda plan: plan.start))


def _link(received: int, message) -> LinkSnapshot:
    return LinkSnapshot(
        received=received,
        session=message.session,
        commands_sent=message.commands_sent,
        counters={pair.key: pair.value for pair in message.gateway_counters},
        reply_bins=tuple(message.reply_us_bins),
        reply_counts=tuple(message.reply_us_counts),
    )


def _mock(messages: list) -> dict | None:
    if not messages:
        return None
    try:
        status = json.loads(messages[-1][1].data)
    except json.JSONDecodeError as error:
        raise ConstructionTwinError(f"the last message on {MOCK} is not JSON: {error}") from error
    return status if isinstance(status, dict) else None
