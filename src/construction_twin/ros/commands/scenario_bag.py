"""Reads the bag of a scenario, and what its driver noted, into a `Run`. Needs no ROS master."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.evaluation.bag import (
    ARM,
    EXECUTION,
    LINK,
    MOCK,
    SYNC,
    TRANSITIONS,
    messages_of,
    nanoseconds,
    open_bag,
    read_recording,
)
from construction_twin.scenario.timeline import Change, GatewayStop, Run, SyncMoment

BAG, NOTES, TRACE, VERDICT = "scenario.bag", "run.json", "gateway.trace", "verdict.json"
#: What is recorded, relative to the robot's namespace.
TOPICS = (
    "twin/joint_states",
    "physical/joint_states",
    "physical/feedback",
    "command/joint_states",
    "expected/joint_states",
    "sync",
    "transitions",
    "plan",
    "review",
    "execution",
    "link",
    MOCK,
    ARM,
)


def read_run(folder: Path, namespace: str | None = None) -> Run:
    """Read a recorded run.

    Args:
        folder: Holds the bag and the driver's notes.
        namespace: The robot's; default: that of the only robot in the bag.

    Raises:
        ConstructionTwinError: If something is missing.
    """
    path = folder / BAG
    recording = read_recording(path, namespace)
    prefix = recording.robot.rstrip("/")
    notes = json.loads((folder / NOTES).read_text())
    changes = [Change(**change) for change in notes["actions"]]
    with open_bag(path) as bag:
        read = messages_of(bag, recording.robot, (SYNC, TRANSITIONS, LINK, EXECUTION, MOCK, ARM))
    messages = {name: [message for _, message in found] for name, found in read.items()}
    for name in (SYNC, EXECUTION, MOCK, ARM):
        if name not in messages:
            raise ConstructionTwinError(f"{path} holds no {prefix}/{name}; was the mock controller recorded?")
    reports = [json.loads(message.data) for message in messages[MOCK]]
    transitions = messages.get(TRANSITIONS, [])
    changes += [*_states("sync", messages[SYNC][:1]), *_transitions(transitions)]
    changes += _states("link", messages.get(LINK, []))
    changes += [*_states("execution", messages[EXECUTION]), *_outcomes(messages[EXECUTION]), *_faults(reports)]
    arm = messages[ARM]
    columns = [arm[0].name.index(joint) for joint in recording.joint_names]
    missed = np.array([report["counters"]["missed"] for report in reports])
    told = np.array([report["stamp"] for report in reports], dtype=np.int64)
    return Run(
        recording=recording,
        changes=tuple(sorted(changes, key=lambda change: change.stamp)),
        closings=tuple(_closings(transitions, messages[SYNC])),
        arm_stamps=np.array([nanoseconds(message.header.stamp) for message in arm], dtype=np.int64),
        arm=np.array([message.position for message in arm])[:, columns],
        missed=int(missed[-1] - missed[0]),
        missed_at=told[np.diff(missed, prepend=missed[0]) > 0],
        failure=notes["failure"],
        stops=tuple(dict.fromkeys(_stops(messages.get(LINK, [])))),
        stated=next((tuple(report["stop_ramp"]["distance_deg"]) for report in reports if report["stop_ramp"]), ()),
    )


def _states(topic: str, messages: list) -> Iterator[Change]:
    last = None
    for message in messages:
        if message.text != last:
            last = message.text
            yield Change(nanoseconds(message.header.stamp), topic, last, message.reason)


def _outcomes(messages: list) -> Iterator[Change]:
    last = None
    for message in messages:
        found = message.plan_id, message.outcome
        if message.outcome and found != last:
            yield Change(nanoseconds(message.header.stamp), "outcome", message.outcome, message.reason)
        last = found


def _faults(reports: list[dict]) -> Iterator[Change]:
    """Return which faults began and ended, by name, and the controller sessions that began."""
    before: set[str] = set()
    session = reports[0]["session"]
    for report in reports:
        now = set(report["faults"])
        for topic, texts in (("fault", now - before), ("fault_end", before - now)):
            for text in sorted(texts):
                name, _, subject = text.partition(" ")
                yield Change(report["stamp"], topic, name, subject)
        if report["session"] != session:
            session = report["session"]
            yield Change(report["stamp"], "session", str(session), report["reason"])
        before = now


def _stops(messages: list) -> Iterator[GatewayStop]:
    for message in messages:
        told = {pair.key: pair.value for pair in message.gateway_counters}
        if told.get("stop_took_s"):
            stated, moved = (tuple(map(float, told[f"stop_{name}_deg"].split())) for name in ("distance", "moved"))
            yield GatewayStop(told["stop_cause"], stated, moved)


def _transitions(messages: list) -> Iterator[Change]:
    """Return every change of the gate's state: two of them may come within one cycle, which `sync` does not show."""
    for message in messages:
        yield Change(nanoseconds(message.header.stamp), "sync", message.to_text, message.reason)


def _closings(transitions: list, syncs: list) -> Iterator[SyncMoment]:
    stamps = [nanoseconds(sync.header.stamp) for sync in syncs]
    for message in transitions:
        if message.from_text == "IN_SYNC":
            stamp = nanoseconds(message.header.stamp)
            last = syncs[max(0, bisect_right(stamps, stamp) - 1)]
            measured = tuple(message.name), tuple(message.error), tuple(message.threshold)
            yield SyncMoment(stamp, *measured, last.servo_lag)
