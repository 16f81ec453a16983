"""What `make soak ARGS=faults` sees of a robot: poses, states, records, with the monotonic time at which each was heard.

It judges nothing; `soak_judge` does.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rospy
from construction_twin.msg import Execution, Feedback, Link, Sync
from sensor_msgs.msg import JointState
from soak_judge import Play, Samples, Stretch

#: States in which the executor moves the arm, or may.
_PLAYS = (Execution.PLAYING, Execution.STOPPING, Execution.PAUSING, Execution.HELD, Execution.AT_BOUNDARY)
#: A monitor that reports 50 times a second has ended when it was silent for so long [s].
_SILENT = 0.3
#: How often the review file is looked at [s].
_PERIOD = 0.01


class PoseEar:
    """Keeps the poses of a topic until they are taken."""

    def __init__(self, topic: str):
        self._heard: list[tuple[float, int, Sequence[float]]] = []
        rospy.Subscriber(topic, JointState, self._on_pose, tcp_nodelay=True, queue_size=1000)

    def _on_pose(self, message: JointState) -> None:
        self._heard.append((time.monotonic(), message.header.seq, message.position))

    def rests(self, seconds: float = 0.5) -> bool:
        """Return whether the arm has been heard in one pose all of the last `seconds`."""
        last = self._heard[-round(seconds * 250) :]
        return len(last) == round(seconds * 250) and all(pose[2] == last[0][2] for pose in last)

    @property
    def pose(self) -> Sequence[float]:
        """The newest pose [rad]."""
        return self._heard[-1][2]

    def moves(self) -> bool:
        """Return whether the newest two poses differ."""
        return len(self._heard) > 1 and self._heard[-1][2] != self._heard[-2][2]

    def take(self) -> Samples:
        """Return what was heard since the last call, its last pose of then first."""
        heard, self._heard = self._heard, self._heard[-1:]
        times, numbers, positions = zip(*heard) if heard else ((), (), ())
        return Samples(np.array(times), np.array(numbers, dtype=np.int64), np.array(positions))


class StateEar:
    """Keeps the changes of a state, and the stretches in which it stood; after a silence of `lapses` [s] nobody says it."""

    def __init__(self, topic: str, kind: type, key=lambda message: message.state, lapses: float = math.inf):
        self._key = key
        self._lapses = lapses
        self._changes: list[tuple[float, object, str]] = []
        self._heard = 0.0
        rospy.Subscriber(topic, kind, self.on_state)

    def on_state(self, message) -> None:
        """Take a report."""
        now, key = time.monotonic(), self._key(message)
        if self._changes and now - self._heard > self._lapses:
            self._changes.append((max(self._heard, self._changes[-1][0]), None, "silent"))
        self._heard = now
        if not self._changes or self._changes[-1][1] != key:
            self._changes.append((now, key, f"{message.text}: {message.reason}"))

    def take(self, until: float) -> list[tuple[Stretch, object]]:
        """Return the stretches since the last call, each with its state; the last one is cut at `until`, and goes on."""
        changes = self._changes
        self._changes = [(until, *changes[-1][1:])] if changes else []
        ends = [change[0] for change in changes[1:]] + [until]
        return [(Stretch(begin, end, text), key) for (begin, key, text), end in zip(changes, ends)]


class TrailEar:
    """Keeps by how much the arm trails its stream: each pose names the target that it answers to.

    It trails by more than playout and servo while replies were lost, or its speed was limited.
    """

    #: Kept is what differs by more than this from what was kept last [s].
    CHANGE = 0.01
    #: More is no trail, but a clock that was set [s]; the gateway brakes before.
    LONGEST = 5.0

    def __init__(self, topic: str):
        self._heard: list[tuple[float, float]] = []
        rospy.Subscriber(topic, Feedback, self._on_feedback, tcp_nodelay=True, queue_size=1000)

    def _on_feedback(self, message: Feedback) -> None:
        trail = (message.header.stamp - message.command_stamp).to_sec()
        known = bool(message.command_stamp) and 0.0 <= trail <= self.LONGEST
        if known and (not self._heard or abs(trail - self._heard[-1][1]) > self.CHANGE):
            self._heard.append((time.monotonic(), trail))

    def take(self) -> tuple[tuple[float, float], ...]:
        """Return time and trail [s] of what was heard since the last call, the last one of then first."""
        heard, self._heard = self._heard, self._heard[-1:]
        return tuple(heard)


class RecordEye:
    """Looks at the review file: when each approval was first seen there, by plan."""

    def __init__(self, path: Path):
        self.path = path
        self.approved: dict[str, float] = {}
        self.lines = 0
        self._at = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="records", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._over.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._over.wait(_PERIOD):
            if self.path.exists() and self.path.stat().st_size > self._at:
                self._look()

    def _look(self) -> None:
        with open(self.path, "rb") as file:
            file.seek(self._at)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        now = time.monotonic()
        for line in whole.splitlines():
            record = json.loads(line)
            self.lines += 1
            if record.get("verdict") == "approved":
                self.approved.setdefault(record["plan"], now)
        self._at += len(whole)


class Witness:
    """Everything that is heard and seen of one robot; the legs take it."""

    def __init__(self, review_file: Path):
        self.arm, self.twin = PoseEar("mock_rsi/joint_states"), PoseEar("twin/joint_states")
        self._link = StateEar("link", Link)
        self.trail = TrailEar("physical/feedback")
        self._sync = StateEar("sync", Sync, lapses=_SILENT)
        self._execution = StateEar("execution", Execution, lambda message: (message.state, message.plan_id))
        self.records = RecordEye(review_file)

    def plays(self, until: float) -> tuple[Play, ...]:
        """Return the stretches in which plans were played; what is paused is not."""
        return tuple(
            Play(plan, stretch.begin, stretch.end)
            for stretch, (state, plan) in self._execution.take(until)
            if state in _PLAYS
        )

    def armed(self, until: float) -> tuple[Stretch, ...]:
        """Return the stretches in which the link said ARMED."""
        return tuple(stretch for stretch, state in self._link.take(until) if state == Link.ARMED)

    def gate(self, until: float) -> tuple[tuple[Stretch, ...], tuple[Stretch, ...]]:
        """Return the stretches in which the gate was IN_SYNC, and those for which it left that."""
        stretches = self._sync.take(until)
        in_sync = tuple(stretch for stretch, state in stretches if state == Sync.IN_SYNC)
        holds = tuple(
            after for (_, before), (after, state) in zip(stretches, stretches[1:])
            if before == Sync.IN_SYNC and state not in (Sync.IN_SYNC, None)
        )  # fmt: skip
        return in_sync, holds
