"""From a bag's messages to a `Recording`, whatever reads the bag.

Two readers do: ROS's rosbag in `construction_twin.ros.commands.bag`, and `pure_bag`, which needs no ROS. A message is an object
with its type's fields as attributes; what its times are, the reader knows (`Bag.nanoseconds`).
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.evaluation.recording import (
    FeedbackStream,
    LinkSnapshot,
    PlayedPlan,
    RecordedVerdict,
    Recording,
    StateChange,
    Stream,
)

TWIN = "twin/joint_states"
PHYSICAL = "physical/joint_states"
FEEDBACK = "physical/feedback"
COMMAND = "command/joint_states"
EXPECTED = "expected/joint_states"
EXECUTION = "execution"
PLAN = "plan"
LINK = "link"
SYNC = "sync"
REVIEW = "review"
MOCK = "mock_rsi/status"
#: Topics read, relative to the robot's namespace. Only twin and physical have to be there.
TOPICS = (TWIN, PHYSICAL, FEEDBACK, COMMAND, EXPECTED, EXECUTION, PLAN, LINK, SYNC, REVIEW, MOCK)
#: Reports whose changes of state are told, and what they are called.
REPORTS = {SYNC: "gate", EXECUTION: "execution", LINK: "link"}

#: Type that each topic must have.
TYPES = {
    TWIN: "sensor_msgs/JointState",
    PHYSICAL: "sensor_msgs/JointState",
    FEEDBACK: "construction_twin/Feedback",
    COMMAND: "sensor_msgs/JointState",
    EXPECTED: "sensor_msgs/JointState",
    EXECUTION: "construction_twin/Execution",
    PLAN: "construction_twin/Plan",
    LINK: "construction_twin/Link",
    SYNC: "construction_twin/Sync",
    REVIEW: "construction_twin/Review",
    MOCK: "std_msgs/String",
}


class Bag(Protocol):
    """A bag that is open for reading."""

    @property
    def types(self) -> Mapping[str, str]:
        """Type of each topic: ``sensor_msgs/JointState``."""

    def messages(self, topics: Iterable[str]) -> Iterator[tuple[str, Any, int]]:
        """Return topic, message and reception [ns] of what was recorded on some topics, in order of reception.

        Raises:
            ConstructionTwinError: If a message is of an unknown type, or of another definition of its type, or the bag is damaged.
        """

    def nanoseconds(self, time: Any) -> int:
        """Return a time in a message [ns]."""


def recording_of(bag: Bag, namespace: str | None = None) -> Recording:
    """Return one robot's run.

    Args:
        namespace: The robot's namespace, e.g. ``/kr120``; default: that of the only robot in the bag.

    Raises:
        ConstructionTwinError: If the bag holds no or several robots, a topic of another type or of another definition of its type,
            or too little data.
    """
    robot = choose_robot(bag.types, namespace)
    return _Run(bag, robot, messages_of(bag, robot)).recording()


def check_definition(known: Mapping[str, str], topic: str, name: str, md5: str) -> None:
    """Check that a bag's messages have the definition that is known here.

    Args:
        known: md5 of each definition, by type name.
        topic, name, md5: Of the bag's connection: topic, type name and md5 of the definition.

    Raises:
        ConstructionTwinError: If the type is not among them, or its definition is another one.
    """
    if name not in known:
        raise ConstructionTwinError(
            Sentence("view.bag.type_of", topic=topic, found=name, known=", ".join(sorted(known)))
        )
    if md5 != known[name]:
        raise ConstructionTwinError(
            Sentence("view.bag.definition", topic=topic, name=name, md5=md5, installed=known[name])
        )


def robots_in(topics: Iterable[str], wanted: str = TWIN) -> list[str]:
    """Return the namespaces that hold a topic, sorted; ``/`` for the root."""
    return sorted(topic[: -len(wanted)].rstrip("/") or "/" for topic in topics if topic.endswith(f"/{wanted}"))


def choose_robot(types: Mapping[str, str], namespace: str | None, topic: str = TWIN) -> str:
    """Return the namespace of the robot that is asked for, or of the only one, among those with a topic; see `recording_of`."""
    robots = robots_in(types, topic)
    if not robots:
        if topic != TWIN:
            raise ConstructionTwinError(Sentence("view.bag.no_such_topic", topic=topic))
        raise ConstructionTwinError(Sentence("view.bag.no_topic", topic=TWIN, twin=TWIN, physical=PHYSICAL))
    if namespace is None:
        if len(robots) > 1:
            raise ConstructionTwinError(Sentence("view.bag.robots", robots=", ".join(robots)))
        return robots[0]
    wanted = "/" + namespace.strip("/")
    if wanted not in robots:
        raise ConstructionTwinError(Sentence("view.bag.no_robot", robot=wanted, robots=", ".join(robots)))
    return wanted


def messages_of(bag: Bag, robot: str, wanted: Iterable[str] = TOPICS) -> dict[str, list[tuple[int, Any]]]:
    """Return per topic, relative to the robot's namespace, the pairs of reception [ns] and message, in order of reception.

    Raises:
        ConstructionTwinError: If a topic has another type than `TYPES` says; see also `Bag.messages`.
    """
    relative = {f"{robot.rstrip('/')}/{topic}": topic for topic in wanted}
    for topic, name in relative.items():
        found = bag.types.get(topic)
        if found not in (None, TYPES[name]):
            raise ConstructionTwinError(Sentence("view.bag.type", topic=topic, found=found, type=TYPES[name]))
    messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for topic, message, received in bag.messages(list(relative)):
        messages[relative[topic]].append((received, message))
    return messages


class _Run:
    """What was read of one robot's run."""

    def __init__(self, bag: Bag, robot: str, messages: dict[str, list[tuple[int, Any]]]):
        self._time = bag.nanoseconds
        self._robot = robot
        self._messages = messages
        self._joints: tuple[str, ...] = ()

    def recording(self) -> Recording:
        """Return it as arrays and records."""
        messages = self._messages
        for name in (TWIN, PHYSICAL):
            if not messages[name]:
                topic = f"{self._robot.rstrip('/')}/{name}"
                raise ConstructionTwinError(Sentence("view.bag.no_messages", topic=topic))
        reported = set(messages[PHYSICAL][0][1].name)
        self._joints = tuple(name for name in messages[TWIN][0][1].name if name in reported)
        return Recording(
            robot=self._robot,
            joint_names=self._joints,
            twin=self._stream(TWIN),
            physical=self._stream(PHYSICAL),
            feedback=self._feedback(),
            command=self._stream(COMMAND) if messages[COMMAND] else None,
            plans=self._plans(),
            waypoints={message.id: len(message.trajectory.points) for _, message in messages[PLAN]},
            links=tuple(_link(received, message) for received, message in messages[LINK]),
            mock=_mock(messages[MOCK]),
            expected=self._stream(EXPECTED) if messages[EXPECTED] else None,
            changes=self._changes(),
            verdicts=self._verdicts(),
        )

    def _verdicts(self) -> tuple[RecordedVerdict, ...]:
        messages = [message for _, message in self._messages[REVIEW]]
        verdicts = [
            RecordedVerdict(self._time(each.header.stamp), each.plan_id, each.approved, each.reviewer, each.reason)
            for each in messages
        ]
        # a latched verdict is recorded once more by whoever listens again
        return tuple(sorted(dict.fromkeys(verdicts), key=lambda verdict: verdict.stamp))

    def _changes(self) -> tuple[StateChange, ...]:
        """Return when the reported states became others; what a report says first counts too."""
        changes = []
        for topic, source in REPORTS.items():
            before = None
            for _, message in self._messages[topic]:
                # the words, not the numbers: those of older bags meant other states
                if message.text != before:
                    before = message.text
                    changes.append(StateChange(self._time(message.header.stamp), source, before, message.reason))
        return tuple(sorted(changes, key=lambda change: change.stamp))

    def _arrays(self, topic: str) -> dict[str, np.ndarray]:
        messages = self._messages[topic]
        return {
            "stamps": np.array([self._time(message.header.stamp) for _, message in messages], dtype=np.int64),
            "positions": self._positions(topic),
            "received": np.array([received for received, _ in messages], dtype=np.int64),
        }

    def _positions(self, topic: str) -> np.ndarray:
        messages = self._messages[topic]
        columns: dict[tuple[str, ...], list[int]] = {}
        rows = []
        for _, message in messages:
            names = tuple(message.name)
            if names not in columns:
                missing = [joint for joint in self._joints if joint not in names]
                if missing:
                    raise ConstructionTwinError(Sentence("view.bag.no_joints", topic=topic, joints=", ".join(missing)))
                columns[names] = [names.index(joint) for joint in self._joints]
            if len(message.position) != len(names):
                raise ConstructionTwinError(
                    Sentence("view.bag.count", topic=topic, found=len(message.position), count=len(names))
                )
            rows.append([message.position[column] for column in columns[names]])
        return np.array(rows, dtype=float).reshape(len(rows), len(self._joints))

    def _stream(self, topic: str) -> Stream:
        return Stream(**self._arrays(topic))

    def _feedback(self) -> FeedbackStream | None:
        messages = self._messages[FEEDBACK]
        if not messages:
            return None
        return FeedbackStream(
            **self._arrays(FEEDBACK),
            seq=np.array([message.seq for _, message in messages], dtype=np.uint64),
            command_stamps=np.array([self._time(message.command_stamp) for _, message in messages], dtype=np.int64),
        )

    def _plans(self) -> tuple[PlayedPlan, ...]:
        """Return the executions, each with the last outcome that was reported for it."""
        plans: dict[tuple[str, int], PlayedPlan] = {}
        for _, message in self._messages[EXECUTION]:
            start = self._time(message.plan_start)
            if message.plan_id and start:
                done = message.state not in (message.PLAYING, message.STOPPING)
                outcome = message.outcome if done else ""
                plans[message.plan_id, start] = PlayedPlan(message.plan_id, start, message.duration, outcome)
        return tuple(sorted(plans.values(), key=lambda plan: plan.start))


def _link(received: int, message) -> LinkSnapshot:
    return LinkSnapshot(
        received=received,
        session=message.session,
        commands_sent=int(message.commands_sent),
        counters={pair.key: pair.value for pair in message.gateway_counters},
        reply_bins=tuple(map(int, message.reply_us_bins)),
        reply_counts=tuple(map(int, message.reply_us_counts)),
    )


def _mock(messages: list) -> dict | None:
    if not messages:
        return None
    try:
        status = json.loads(messages[-1][1].data)
    except json.JSONDecodeError as error:
        raise ConstructionTwinError(Sentence("view.bag.no_json", topic=MOCK, problem=str(error))) from error
    return status if isinstance(status, dict) else None
