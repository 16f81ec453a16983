"""Reads a bag by the package rosbags, without ROS, and makes a `Recording` of it.

A bag carries the text of its messages' definitions, and rosbags generates Python code from the definitions that it is given. It is
given this package's (``msg``) beside its own of ROS's common messages, and nothing from the bag: what was recorded with another
definition (type name and md5) is refused.
"""

from __future__ import annotations

import json
import struct
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from construction_twin.core.errors import NOT_OPENED, ConstructionTwinError, FileError, system_message
from construction_twin.core.share import share_file
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.recording import (
    FeedbackStream,
    LinkSnapshot,
    PlayedPlan,
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
MOCK = "mock_rsi/status"
TRANSITIONS = "transitions"
ARM = "mock_rsi/joint_states"
#: Topics of a `Recording`, relative to the robot's namespace. Only twin and physical have to be there.
TOPICS = (TWIN, PHYSICAL, FEEDBACK, COMMAND, EXPECTED, EXECUTION, PLAN, LINK, SYNC, MOCK)
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
    MOCK: "std_msgs/String",
    TRANSITIONS: "construction_twin/Transition",
    ARM: "sensor_msgs/JointState",
}
#: What rosbags raises for a file that is damaged or another one's: it takes what it finds for text, lengths and offsets.
_DAMAGED = (
    ReaderError, SerdeError, ValueError, LookupError, EOFError, TypeError, AssertionError, OverflowError, MemoryError, RuntimeError,
    struct.error,
)  # fmt: skip


class Bag:
    """A bag that is open for reading."""

    def __init__(self, reader: Reader):
        self._reader = reader
        self._store, self._known = _definitions()
        self.topics = frozenset(each.topic for each in reader.connections)

    def raw(self, types: Mapping[str, str]) -> Iterator[tuple[Connection, bytes, int]]:
        """Yield connection, serialized message and reception [ns] of what was recorded on some topics, in order of reception."""
        chosen = [each for each in self._reader.connections if each.topic in types]
        for each in chosen:
            self._check(each, types[each.topic])
        # rosbags takes no connection for all of them
        for connection, received, data in self._reader.messages(chosen) if chosen else ():
            yield connection, data, received

    def everything(self) -> Iterator[tuple[Connection, bytes, int]]:
        """Yield connection, serialized message and reception [ns] of the whole bag, in order of reception."""
        for connection, received, data in self._reader.messages():
            yield connection, data, received

    def messages(self, types: Mapping[str, str]) -> Iterator[tuple[str, Any, int]]:
        """Yield topic, message and reception [ns]; see `raw`. A message has its type's fields as attributes."""
        for connection, data, received in self.raw(types):
            yield connection.topic, self._store.deserialize_ros1(data, connection.msgtype), received

    def _check(self, connection: Connection, kind: str) -> None:
        # its name as ROS 1 has it
        topic, found = connection.topic, connection.msgtype.replace("/msg/", "/")
        if found != kind:
            raise ConstructionTwinError(f"{topic} in the bag is a {found}; expected a {kind}")
        if connection.digest != self._known[kind]:
            sums = f"md5 {connection.digest}, installed is {self._known[kind]}"
            other = f"{topic} in the bag was recorded with another definition of {kind} ({sums})"
            raise ConstructionTwinError(f"{other}; evaluate it with the version of the package that recorded it")


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """Open a bag for reading. No code is generated from what it contains."""
    try:
        # rosbags says of a file that is not there that it is damaged
        Path(path).open("rb").close()
        with Reader(path) as reader:
            yield Bag(reader)
    except NOT_OPENED as error:
        raise FileError(str(path), error) from error
    except (*_DAMAGED, OSError) as error:
        if "not indexed" in str(error):
            sentence = f"{path} was not closed properly; run `rosbag reindex {path}` and try again"
            raise ConstructionTwinError(sentence) from error
        raise ConstructionTwinError(f"{path} cannot be read as a rosbag: {system_message(error)}") from error


@cache
def _definitions() -> tuple[Typestore, Mapping[str, str]]:
    """Return how messages are read, and the md5 of each type of `TYPES`."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for file in sorted(share_file("msg").glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"construction_twin/msg/{file.stem}"))
    names = sorted(set(TYPES.values()))
    return store, {name: store.generate_msgdef(name.replace("/", "/msg/"), ros_version=1)[1] for name in names}


def write_mcap(path: str | Path, output: Path) -> None:
    """Write everything in a bag as MCAP (profile ``ros1``), with the bag's own message definitions."""
    with open_bag(path) as bag, output.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1", library="construction_twin")
        channels: dict[int, int] = {}
        for connection, data, received in bag.everything():
            if connection.id not in channels:
                schema = writer.register_schema(
                    connection.msgtype.replace("/msg/", "/"), "ros1msg", connection.msgdef.data.encode()
                )
                channels[connection.id] = writer.register_channel(connection.topic, "ros1", schema)
            writer.add_message(channels[connection.id], received, data, received)
        writer.finish()


def nanoseconds(time: Any) -> int:
    """Return a time in a message [ns]."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def read_recording(path: str | Path, namespace: str | None = None) -> Recording:
    """Read one robot's run from a bag; `namespace`, e.g. ``/kr120``: by default that of the only robot in it."""
    with open_bag(path) as bag:
        robot = choose_robot(bag.topics, namespace)
        return _Run(robot, messages_of(bag, robot)).recording()


def choose_robot(topics: Iterable[str], namespace: str | None, topic: str = TWIN) -> str:
    """Return the namespace of the robot that is asked for, or of the only one, among those with a topic; see `read_recording`."""
    robots = sorted(each[: -len(topic)].rstrip("/") or "/" for each in topics if each.endswith(f"/{topic}"))
    if not robots:
        if topic != TWIN:
            raise ConstructionTwinError(f"the bag holds no topic .../{topic}")
        raise ConstructionTwinError(f"the bag holds no topic .../{TWIN}; record at least .../{TWIN} and .../{PHYSICAL}")
    if namespace is None:
        if len(robots) > 1:
            raise ConstructionTwinError(f"the bag holds the robots {', '.join(robots)}; name one of them")
        return robots[0]
    wanted = "/" + namespace.strip("/")
    if wanted not in robots:
        raise ConstructionTwinError(f"the bag holds no robot {wanted}; it holds {', '.join(robots)}")
    return wanted


def messages_of(bag: Bag, robot: str, wanted: Iterable[str] = TOPICS) -> dict[str, list[tuple[int, Any]]]:
    """Return per topic, relative to the robot's namespace, the pairs of reception [ns] and message, in order of reception."""
    relative = {f"{robot.rstrip('/')}/{topic}": topic for topic in wanted}
    messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for topic, message, received in bag.messages({topic: TYPES[name] for topic, name in relative.items()}):
        messages[relative[topic]].append((received, message))
    return messages


class _Run:
    """Messages of one robot's run."""

    def __init__(self, robot: str, messages: dict[str, list[tuple[int, Any]]]):
        self._robot = robot
        self._messages = messages
        self._joints: tuple[str, ...] = ()

    def recording(self) -> Recording:
        """Return it as arrays and records."""
        messages = self._messages
        for name in (TWIN, PHYSICAL):
            if not messages[name]:
                topic = f"{self._robot.rstrip('/')}/{name}"
                raise ConstructionTwinError(f"the bag holds no messages on {topic}; is that side recorded?")
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
        )

    def _changes(self) -> tuple[StateChange, ...]:
        """Return the changes of the reported states, the first report included."""
        changes = []
        for topic, source in REPORTS.items():
            before = None
            for _, message in self._messages[topic]:
                # the words, not the numbers: those of older bags meant other states
                if message.text != before:
                    before = message.text
                    changes.append(StateChange(nanoseconds(message.header.stamp), source, before, message.reason))
        return tuple(sorted(changes, key=lambda change: change.stamp))

    def _arrays(self, topic: str) -> dict[str, np.ndarray]:
        messages = self._messages[topic]
        return {
            "stamps": np.array([nanoseconds(message.header.stamp) for _, message in messages], dtype=np.int64),
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
                if missing := [joint for joint in self._joints if joint not in names]:
                    lacking = f"a message on {topic} lacks {', '.join(missing)}"
                    raise ConstructionTwinError(f"{lacking}; each must name all joints")
                columns[names] = [names.index(joint) for joint in self._joints]
            if len(message.position) != len(names):
                found = f"{len(message.position)} values for {len(names)} joints"
                raise ConstructionTwinError(f"a message on {topic} has {found}")
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
            command_stamps=np.array([nanoseconds(message.command_stamp) for _, message in messages], dtype=np.int64),
        )

    def _plans(self) -> tuple[PlayedPlan, ...]:
        """Return the executions, each with the last outcome that was reported for it."""
        plans: dict[tuple[str, int], PlayedPlan] = {}
        for _, message in self._messages[EXECUTION]:
            start = nanoseconds(message.plan_start)
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
        raise ConstructionTwinError(f"the last message on {MOCK} is not JSON: {error}") from error
    return status if isinstance(status, dict) else None
