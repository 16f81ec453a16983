"""Faults of the mock controller: names, arguments, effects. Time is a count of cycles, randomness has a seed; axis angles, SI."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.units import NANOSECONDS
from construction_twin.mock.controller import MockController
from construction_twin.mock.own_motion import T1_SPEED
from construction_twin.robot.motion_errors import JointRangeError


class DatagramInFlight(NamedTuple):
    """A datagram that arrives when it is `due` [ns]; a tuple, which the heap sorts by time, then by the order of sending."""

    due: int
    order: int
    data: bytes


class ImpairedLine:
    """Loses, doubles and delays datagrams of one direction; one may overtake another.

    Attributes:
        drop, duplicate: Fractions of the datagrams, 0 to 1.
        delay, jitter: Each is late by `delay` to `delay` + `jitter` [ns], evenly spread.
    """

    def __init__(self, random_numbers: random.Random):
        self._random = random_numbers
        self.drop = self.duplicate = 0.0
        self.delay = self.jitter = 0
        self._order = itertools.count()
        self._queue: list[DatagramInFlight] = []
        self.dropped = self.doubled = self.delayed = 0

    @property
    def active(self) -> bool:
        """Whether the line impairs datagrams, or still holds delayed ones."""
        return bool(self.drop or self.duplicate or self.delay or self.jitter or self._queue)

    def send(self, data: bytes, now: int) -> None:
        """Send a datagram at `now` [ns]."""
        if self.drop and self._random.random() < self.drop:
            self.dropped += 1
            return
        twice = bool(self.duplicate) and self._random.random() < self.duplicate
        self.doubled += twice
        self.delayed += bool(self.delay or self.jitter)
        for _ in range(1 + twice):
            due = now + self.delay + round(self._random.random() * self.jitter)
            heapq.heappush(self._queue, DatagramInFlight(due, next(self._order), data))

    def pop_arrived(self, now: int) -> list[DatagramInFlight]:
        """Return what has arrived by `now` [ns], in the order of arrival."""
        arrived = []
        while self._queue and self._queue[0].due <= now:
            arrived.append(heapq.heappop(self._queue))
        return arrived

    def next_arrival(self) -> int | None:
        """Return when the next datagram arrives [ns], or None."""
        return self._queue[0].due if self._queue else None


#: Which datagrams a fault of the network meets: both directions, packets to the PC, or replies to the controller.
DIRECTIONS = ("", "to_pc", "to_controller")


@dataclass(frozen=True)
class FaultKind:
    """The arguments of a fault.

    Attributes:
        axis: ``one`` axis, ``any`` (none named: all of them), or ``no`` axis.
        values: Allowed numbers of values; -1 stands for one per axis.
        shift: True when the value is a difference of an axis angle, whose sign follows the axis's.
        lasting: False: it is over as soon as it has happened, and cannot be switched off.
    """

    axis: str
    values: tuple[int, ...]
    meaning: str
    network: bool = False
    shift: bool = False
    positive: bool = True
    lasting: bool = True
    largest: float = math.inf
    whole: bool = False


#: Every fault by its name.
KINDS = {
    "stall": FaultKind("one", (0,), "no value"),
    "slow": FaultKind("one", (1,), "the largest velocity [rad/s]"),
    "offset": FaultKind("one", (1,), "the offset [rad]", shift=True, positive=False),
    "drift": FaultKind("one", (1,), "the rate [rad/s]", shift=True, positive=False),
    "backlash": FaultKind("one", (1,), "the play [rad]"),
    "noise": FaultKind("any", (1,), "the standard deviation [rad]"),
    "drop": FaultKind("no", (1,), "the fraction of datagrams, up to 1", network=True, largest=1.0),
    "delay": FaultKind("no", (1, 2), "delay and jitter, up to 1 s", network=True, positive=False, largest=1.0),
    "duplicate": FaultKind("no", (1,), "the fraction of datagrams, up to 1", network=True, largest=1.0),
    "estop": FaultKind("no", (0,), "no value"),
    "rsi_timeout": FaultKind("no", (0,), "no value"),
    "t1": FaultKind("no", (0, 1), "nothing, or the tool's speed [m/s]"),
    "mode": FaultKind("no", (1,), "the operating mode: 1 T1, 2 T2, 3 AUT, 4 EXT", largest=4.0, whole=True),
    "program": FaultKind(
        "no", (1,), "the program's state: 1 FREE, 2 RESET, 3 ACTIVE, 4 STOP, 5 END", largest=5.0, whole=True
    ),
    "override": FaultKind("no", (1,), "the override, 0 to 100 percent", positive=False, largest=100.0),
    "grip_fails": FaultKind("no", (0,), "no value"),
    "grip_lost": FaultKind("no", (0,), "no value", lasting=False),
    "opened_by_hand": FaultKind("no", (0,), "no value", lasting=False),
    "no_read_back": FaultKind("no", (0,), "no value"),
    "collision": FaultKind(
        "one", (1,), "the torque with which something pushes on the axis [Nm]", shift=True, positive=False
    ),
    "restart": FaultKind("no", (0,), "no value", lasting=False),
    "restart_at": FaultKind("no", (-1,), "a pose [rad]", positive=False, lasting=False),
    "jog": FaultKind("no", (-1,), "a pose [rad]", positive=False, lasting=False),
}


@dataclass(frozen=True)
class Fault:
    """A fault to be injected or ended; without an axis it is of none, or of all.

    It ends by itself after a `duration` [s], 0: never. Of ``jog``: the length of the motion, 0: moderate.
    """

    name: str
    axis: str = ""
    values: tuple[float, ...] = ()
    direction: str = ""
    duration: float = 0.0

    @property
    def subject(self) -> str:
        """The part of the controller that is faulty; it has one fault at a time."""
        return self.axis or self.direction

    def __str__(self) -> str:
        return f"{self.name} {self.subject}".strip()


_OnOff = tuple[Callable[[], None], Callable[[], None]]


class FaultBoard:
    """The faults of one controller and of its network.

    Attributes:
        to_pc, to_controller: Where datagrams go while a line is active.
    """

    def __init__(self, controller: MockController, seed: int):
        self.controller = controller
        controller.encoders.random = random.Random(f"{seed} encoders")
        self.to_pc = ImpairedLine(random.Random(f"{seed} to_pc"))
        self.to_controller = ImpairedLine(random.Random(f"{seed} to_controller"))
        self.changes = 0
        self._cycle = 0
        self._active: dict[tuple[str, str], tuple[Fault, float]] = {}

    @property
    def active(self) -> tuple[str, ...]:
        """The faults that are on, as texts."""
        return tuple(str(fault) for fault, _ in self._active.values())

    def tick(self) -> None:
        """Advance by one cycle, before `MockController.begin_cycle`; end faults by time, a time-out with the session it stops."""
        self._cycle += 1
        if not self._active:
            return
        for fault, end in tuple(self._active.values()):
            if self._cycle >= end or (fault.name == "rsi_timeout" and not self.controller.running):
                self.end(fault)

    def inject(self, fault: Fault) -> str:
        """Switch a fault on, or change its values; return what happens now, one sentence."""
        kind = self._check(fault)
        start, _ = self._actions(fault)
        try:
            start()
        except (ValueError, JointRangeError) as error:
            raise ConfigurationError(fault.name, fault.values, str(error)) from error
        self.changes += 1
        if not kind.lasting:
            return f"{fault.name} is carried out"
        cycles = math.ceil(fault.duration / self.controller.config.period - 1e-9) if fault.duration else math.inf
        self._active[fault.name, fault.subject] = fault, self._cycle + cycles
        if fault.duration:
            return f"{fault} is on for {fault.duration:g} s"
        return f"{fault} is on"

    def end(self, fault: Fault) -> str:
        """Switch a fault off; only name, axis and direction count."""
        if (fault.name, fault.subject) not in self._active:
            expected = f"a fault that is on: {', '.join(self.active) or 'none is'}"
            raise ConfigurationError(fault.name, fault.subject or None, expected)
        _, stop = self._actions(fault)
        stop()
        del self._active[fault.name, fault.subject]
        self.changes += 1
        return f"{fault} is over"

    def _check(self, fault: Fault) -> FaultKind:
        if fault.name not in KINDS:
            raise ConfigurationError("fault", fault.name, f"one of {', '.join(KINDS)}")
        kind, axes = KINDS[fault.name], self.controller.config.axes
        if kind.axis == "one" and not fault.axis or kind.axis == "no" and fault.axis:
            raise ConfigurationError(fault.name, fault.axis, "a joint" if kind.axis == "one" else "no joint")
        if fault.axis and fault.axis not in axes:
            raise ConfigurationError(fault.name, fault.axis, f"one of {', '.join(axes)}")
        if fault.direction not in (DIRECTIONS if kind.network else ("",)):
            expected = "direction to_pc, to_controller or none" if kind.network else "no direction"
            raise ConfigurationError(fault.name, fault.direction, expected)
        counts = [len(axes) if count < 0 else count for count in kind.values]
        if len(fault.values) not in counts or not all(map(math.isfinite, fault.values)):
            raise ConfigurationError(fault.name, fault.values, kind.meaning)
        if kind.positive and not all(value > 0.0 for value in fault.values):
            raise ConfigurationError(fault.name, fault.values, f"{kind.meaning}, greater than 0")
        bounded = math.isfinite(kind.largest)
        if any(bounded and not 0.0 <= value <= kind.largest or kind.whole and value % 1 for value in fault.values):
            raise ConfigurationError(fault.name, fault.values, kind.meaning)
        if not (math.isfinite(fault.duration) and fault.duration >= 0.0):
            raise ConfigurationError(fault.name, fault.duration, "a duration [s] of 0 or more")
        return kind

    def _actions(self, fault: Fault) -> _OnOff:
        """Return what switches the fault on, and off."""
        if fault.name in ("stall", "slow", "collision"):
            return self._servo(fault)
        if fault.name in ("offset", "drift", "backlash", "noise"):
            return self._encoders(fault)
        if KINDS[fault.name].network:
            return self._network(fault)
        if fault.name in ("mode", "program", "override"):
            return self._channel(fault)
        if fault.name in ("grip_fails", "grip_lost", "opened_by_hand", "no_read_back"):
            return self._grip(fault)
        controller, values = self.controller, fault.values
        actions: dict[str, _OnOff] = {
            "estop": (controller.press_emergency_stop, partial(setattr, controller, "emergency_pressed", False)),
            "rsi_timeout": (
                partial(setattr, controller, "ignores_replies", True),
                partial(setattr, controller, "ignores_replies", False),
            ),
            "t1": (lambda: controller.limit_tool_speed(values[0] if values else T1_SPEED), controller.lift_tool_speed),
            "restart": (controller.restart, _nothing),
            "restart_at": (lambda: controller.restart(values), _nothing),
            "jog": (lambda: controller.run_program(values, fault.duration), _nothing),
        }
        return actions[fault.name]

    def _channel(self, fault: Fault):
        """Return the acts that falsify an optional channel, and restore it."""

        def set_status(value: float | None) -> None:
            self.controller.status_shown = replace(self.controller.status_shown, **{fault.name: value})  # type: ignore[arg-type]

        value = fault.values[0] if fault.values else 0.0
        return lambda: set_status(value if fault.name == "override" else int(value)), lambda: set_status(None)

    def _grip(self, fault: Fault):
        tool = self.controller.tool
        if tool is None:
            file = self.controller.terms.description
            raise ConstructionTwinError(f"{fault.name}: found None, expected {file} with channels of a tool")
        return {
            "grip_fails": (partial(setattr, tool, "fails", True), partial(setattr, tool, "fails", False)),
            "grip_lost": (partial(setattr, tool, "lost", True), _nothing),
            "opened_by_hand": (tool.open_by_hand, _nothing),
            "no_read_back": (partial(setattr, tool, "hidden", True), partial(setattr, tool, "hidden", False)),
        }[fault.name]

    def _servo(self, fault: Fault):
        servo, config = self.controller.servo, self.controller.config
        joint = config.axes.index(fault.axis)
        limits = config.velocity[joint], config.acceleration[joint]
        if fault.name == "collision":
            return lambda: servo.push(joint, fault.values[0]), lambda: servo.push(joint, 0.0)
        if fault.name == "stall":
            return lambda: servo.stall(joint), lambda: servo.release(joint, *limits)
        return lambda: servo.limit(joint, fault.values[0], limits[1]), lambda: servo.unlimit(joint, *limits)

    def _encoders(self, fault: Fault):
        encoders, axes = self.controller.encoders, self.controller.config.axes
        joints = [axes.index(fault.axis)] if fault.axis else range(len(axes))

        def put(value: float) -> None:
            for joint in joints:
                encoders.disturb(fault.name, joint, value, self.controller.measured[joint])

        return lambda: put(fault.values[0]), lambda: put(0.0)

    def _network(self, fault: Fault):
        lines = [getattr(self, direction) for direction in DIRECTIONS[1:] if fault.direction in ("", direction)]

        def put(value: float, more: float = 0.0) -> None:
            for line in lines:
                if fault.name == "delay":
                    line.delay, line.jitter = round(value * NANOSECONDS), round(more * NANOSECONDS)
                else:
                    setattr(line, fault.name, value)

        return lambda: put(*fault.values), lambda: put(0.0)


def _nothing() -> None:
    """End a fault that ends by itself."""
