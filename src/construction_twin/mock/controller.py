"""A mock robot controller of any make: no clock, no socket, one call per controller cycle.

`begin_cycle` opens cycle k and returns packet k; `receive` takes what arrives during it; the next `begin_cycle` closes it: the
valid reply k, or what an axis keeps when there is none, becomes its setpoint, the servo moves, and packet k + 1 reports where it
ended. With `IdealServo(3)` the pose that packet k + 3 reports is start + correction of reply k. When the session stops, the arm
stands still at once, but for the ramp of an emergency stop. Angles are those of the controller's axes, in the order of
`MockConfig.axes`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from construction_twin.controller.port import ControllerStatus, MockStatus, make_of
from construction_twin.controller.telegram import STAMP_WRAP, Reply, stamp_step
from construction_twin.core.errors import ConfigurationError, TelegramError
from construction_twin.mock.config import MockConfig
from construction_twin.mock.gripper import SimulatedTool
from construction_twin.mock.own_motion import EmergencyBrake, Program, ToolSpeedLimit
from construction_twin.mock.servo import Encoders, Servo
from construction_twin.robot.motion_errors import JointRangeError

#: The servo is given this long to arrive at the end of a program, and refused replies are over after this long without one [s].
_SETTLING, _RECOVERY = 1.0, 1.0
#: A reply is reported as late when its packet left no longer ago than this [ms].
_LONGEST_STEP = STAMP_WRAP // 2 - 1
#: Slack of the soft limits [rad]: start + (limit - start) need not round to the limit.
_RANGE_SLACK = 1e-9

#: Position [m] and A, B, C [rad] of the tool in the base, from axis angles [rad].
ForwardKinematics = Callable[[tuple[float, ...]], tuple[Sequence[float], Sequence[float]]]


class ReplyRefusals:
    """Refused replies of a controller, with a log line at begin and end.

    Attributes:
        last: Why the last one did not count; "" before the first.
        present: The same; "" when so many have counted since that it is over.
        valid: How many have counted since.
        log_lines: Sentences for the log, which whoever writes them removes.
    """

    def __init__(self, recovery: int) -> None:
        self._recovery = recovery
        self.last = ""
        self.log_lines: list[str] = []
        self.begin_session()

    def begin_session(self) -> None:
        """Forget what belongs to the session before; `last` stays for people."""
        self.present = ""
        self._reported: set[str] = set()
        self._refused = self.valid = 0

    def on_refused(self, kind: str, sentence: str) -> None:
        """Count a reply that is refused; the first of its kind is logged at once."""
        self.last = self.present = sentence
        self._refused += 1
        self.valid = 0
        if kind not in self._reported:
            self._reported.add(kind)
            self.log_lines.append(f"reply refused: {sentence}")

    def on_valid(self) -> None:
        """Count a valid reply."""
        if not self.present:
            return
        self.valid += 1
        if self.valid >= self._recovery:
            self.log_lines.append(
                f"replies count again; {self._refused} were refused, the last one because {self.last}"
            )
            self.begin_session()


class MockController:
    """One mock controller: a method for each thing that replies, people and faults do to it; the module says when.

    Attributes:
        running: False when the session has stopped, for `reason`; then nothing is sent and nothing is accepted.
        flag: The controller's own flag that the link was interrupted (timeout).
        stamp: Of the last packet [ms].
        start_pose, setpoint, measured: Length n. Programmed pose of the session, present setpoint, measured axes [rad].
        reported, true_position: Length n. What the last packet reports of the axes, and where they really are, which only faults of
            encoders tell apart [rad].
        applied: Length n. Correction in effect, after clamping [rad].
        correction_lower, correction_upper: Length n. Bounds in force in this session [rad].
        emergency_pressed, ignores_replies: The emergency stop is pressed, which to release starts nothing; replies are ignored.
        needs_person: True after an emergency stop: a session is started by a person only.
        ramp: The last emergency stop's, until the next session.
        tool: What the channels of a tool switch and read; None where the layout has none.
        status_shown: What packets say of the controller in place of what is. It changes nothing else.
    """

    #: `mismatched`: to no packet; `without_stop`: valid ones without the declared Stop; `unexpected`: while stopped
    COUNTERS = (
        *("packets", "replies", "missed", "late_replies", "mismatched", "duplicates", "malformed", "wrong_sentype"),
        *("without_stop", "clamped", "unexpected", "ignored"),
    )

    def __init__(self, config: MockConfig, servo: Servo, forward_kinematics: ForwardKinematics):
        self.emergency_pressed = self.needs_person = self.ignores_replies = False
        self.ramp: EmergencyBrake | None = None
        self.program: Program | None = None
        self._tool_limit: ToolSpeedLimit | None = None
        self._tool_speed = 0.0
        self._settling = 0
        self._open = False
        self._reply: Reply | None = None
        self._start_tool: tuple[float, ...] = ()
        self.config = config
        self.servo = servo
        self._period = config.period
        self.encoders = Encoders(len(config.axes), config.period)
        self.refusals = ReplyRefusals(round(_RECOVERY / config.period))
        self.reported: tuple[float, ...] = config.start_pose
        self._forward_kinematics = forward_kinematics
        layout = config.layout
        make = make_of(layout.make)
        self.status_shown = MockStatus()
        self._absolute = make.absolute
        #: Terms of the make's pendant and files.
        self.terms = make.terms
        side = make.controller_side(layout, config.axes, config.units, config.precision)
        self._encode, self._decode, self._status = side.encode, side.decode, side.status
        self.tool: SimulatedTool | None = None
        if layout.switched or layout.outputs or layout.inputs:
            self.tool = SimulatedTool(layout, config.gripper, config.period)
        #: Per axis, whether a missed reply keeps its correction.
        self._holds = side.holds
        self._stop_declared, self._holds_stop = layout.stop, side.holds_stop
        self._linear = linear = [unit.linear for unit in config.units] or [False] * len(config.axes)
        self._people_units = [(1e3, "mm") if slides else (math.degrees(1.0), "deg") for slides in linear]
        self._max_step = _per_cycle(config.velocity, config.velocity_factor * config.period)
        self._max_step_change = _per_cycle(config.acceleration, config.acceleration_factor * config.period**2)
        self.counters = dict.fromkeys(self.COUNTERS, 0)
        self.session = 0
        self.stamp = 0
        self._start_session(config.start_pose, config.first_stamp)

    @property
    def measured(self) -> tuple[float, ...]:
        """Measured axis positions [rad], shape (n,)."""
        return self.servo.measured

    @property
    def true_position(self) -> tuple[float, ...]:
        """Where the axes really are [rad], shape (n,)."""
        return tuple([angle - slip for angle, slip in zip(self.measured, self.encoders.slip)])

    @property
    def status(self) -> ControllerStatus:
        """The controller's status, for telegrams with channels for it."""
        return self._status(self._shown)

    @property
    def _shown(self) -> MockStatus:
        return replace(self.status_shown, slow=bool(self._tool_speed))

    def restart(self, pose: Sequence[float] | None = None) -> None:
        """Start a new session at a pose [rad] within the soft limits, by default what the encoders report."""
        if self.emergency_pressed:
            expected = "a released one: inject `estop` with `on` false"
            raise ConfigurationError("restart", "the emergency stop is pressed", expected)
        if pose is None:
            pose = _clamp(self.reported, self.config.lower, self.config.upper)
        self._check_range(pose)
        self._start_session(tuple(pose), self._stamp_after(self.config.restart_gap))

    def begin_cycle(self) -> bytes | None:
        """Close the open cycle, move the servo, open the next one; return the datagram, None when the session has stopped."""
        if self.running and self._open:
            self._close_cycle()
            self.stamp = self._stamp_after(self.config.cycle * self.running)  # just stopped: it keeps its stamp
        elif not self.running:
            self._move_without_session()
        if self.tool is not None:
            self.tool.step()
        measured = self.measured
        self.reported = self.encoders.read(measured) if self.encoders.active else measured
        if not self.running:
            return None
        self._open = True
        self._reply = None
        self.counters["packets"] += 1
        pose = _flat(self._forward_kinematics(self.reported))
        setpoint = self.setpoint if self._absolute else self.start_pose
        values = self.stamp, self.reported, setpoint, pose, self._start_tool, self.missed, self._shown
        outputs = None if self.tool is None or self.tool.hidden else self.tool.outputs
        return self._encode(*values, outputs, {} if self.tool is None else self.tool.inputs)

    def receive(self, data: bytes, in_time: bool = True) -> bool:
        """Handle a datagram in the open cycle, `in_time` or too late; return whether it is the reply."""
        if not self.running or self._decode is None:
            return self._count("unexpected")
        if self.ignores_replies:
            return self._count("ignored")
        try:
            telegram = self._decode(data)
        except TelegramError as error:
            return self._refuse("wrong_sentype" if error.reason == "sentype" else "malformed", error.reason, str(error))
        if telegram.controller_ms != self.stamp or not self._open:
            behind, beside = divmod(stamp_step(telegram.controller_ms, self.stamp, _LONGEST_STEP), self.config.cycle)
            if behind > 0 and not beside and stamp_step(self._first_stamp, telegram.controller_ms, _LONGEST_STEP) >= 0:
                cycles = f"cycle{'s' if behind > 1 else ''}"
                late = f"the reply to {self.terms.stamp} {telegram.controller_ms} came {behind} {cycles} late"
                return self._refuse("late_replies", "late", late)
            found = f"the reply carries {self.terms.stamp} {telegram.controller_ms}"
            expected = f"{found}; expected that of the packet, unchanged: {self.stamp}"
            return self._refuse("mismatched", "stamp", expected)
        if not in_time:
            late = f"the reply to {self.terms.stamp} {telegram.controller_ms} came after the end of its cycle"
            return self._refuse("late_replies", "late", late)
        if self._reply is not None:
            return self._count("duplicates")
        self._reply = telegram
        self.counters["replies"] += 1
        self.refusals.on_valid()
        return True

    def _stamp_after(self, time: int) -> int:
        """Return the stamp of `time` [ms] from now."""
        stamp = self.stamp + time
        return stamp - STAMP_WRAP if self.config.first_stamp < STAMP_WRAP <= stamp else stamp

    def press_emergency_stop(self) -> None:
        """Brake to rest within the acceleration limits and end the session; packets cease at once."""
        self.emergency_pressed = self.needs_person = True
        self.program = None
        if self.running:
            begin = self.setpoint, self._last_step
            self.ramp = EmergencyBrake(*begin, self.config.acceleration, self.measured, self._period)
            self._stop("emergency stop")

    def limit_tool_speed(self, speed: float) -> None:
        """Select T1: the tool moves no faster than `speed` [m/s]."""
        self._tool_speed = speed
        self._tool_limit = self._build_tool_limit(self.setpoint, self._last_step)

    def lift_tool_speed(self) -> None:
        """Select another mode: the arm catches up within its limits."""
        self._tool_speed = 0.0
        if self._tool_limit is not None:
            self._tool_limit.lift()

    def run_program(self, goal: Sequence[float], duration: float = 0.0) -> None:
        """Move to a pose [rad], with the present corrections; without a duration [s] at `JOG_FRACTION` of the limits."""
        if self.emergency_pressed or self.ramp is not None and not self.ramp.done:
            raise ConfigurationError("jog", tuple(goal), "an arm at rest whose emergency stop is not pressed")
        self._check_range(goal)
        if not self.running:
            self.ramp = None
            self.start_pose, self.applied = self.setpoint, self._zero
        target = tuple([q - correction for q, correction in zip(goal, self.applied)])
        limits = self.config.velocity, self.config.acceleration
        self.program = Program(self.start_pose, target, *limits, duration, self._period)

    def _build_tool_limit(self, position: Sequence[float], step: Sequence[float]) -> ToolSpeedLimit:
        limits = self.config.velocity, self.config.acceleration
        forward = self._forward_kinematics
        return ToolSpeedLimit(position, step, *limits, lambda q: forward(q)[0], self._tool_speed, self._period)

    def _programmed_pose(self, program: Program) -> tuple[float, ...]:
        pose = program.advance()
        if program.done:
            self.program = None
        return pose

    def _move_without_session(self) -> None:
        """One cycle without a session: the ramp, or a program."""
        if self.ramp is not None:
            self.setpoint = self.ramp.advance()
        elif self.program is not None:
            self.setpoint = self.start_pose = self._programmed_pose(self.program)
            self._settling = round(_SETTLING / self._period)
        elif self._settling:
            self._settling -= 1
        else:
            return
        self.servo.step(self.setpoint)

    def _start_session(self, pose: tuple[float, ...], stamp: int) -> None:
        config = self.config
        self._check_range(pose)
        self.session += 1
        self.running, self.reason, self.flag = True, "", False
        self.stamp = self._first_stamp = stamp
        self.missed = 0
        self.start_pose = self.setpoint = pose
        self.applied = self._zero = (0.0,) * len(pose)
        self._last_step = self._zero
        self._stop_level = False
        below = tuple(min(0.0, low - q) for low, q in zip(config.lower, pose))
        above = tuple(max(0.0, high - q) for high, q in zip(config.upper, pose))
        self.correction_lower = config.correction_lower or below
        self.correction_upper = config.correction_upper or above
        self._open, self._reply = False, None
        self.refusals.begin_session()
        self._start_tool = _flat(self._forward_kinematics(pose))
        if self.tool is not None:
            self.tool.begin_session()
        self.servo.reset(pose)
        self.encoders.absorb()
        self.ramp = self.program = self._tool_limit = None
        self.needs_person = False
        if self._tool_speed:
            self._tool_limit = self._build_tool_limit(pose, self._zero)

    def _check_range(self, pose: Sequence[float]) -> None:
        config = self.config
        for index, (axis, value, lower, upper) in enumerate(zip(config.axes, pose, config.lower, config.upper)):
            if not lower - _RANGE_SLACK <= value <= upper + _RANGE_SLACK:
                raise JointRangeError(axis, value, lower, upper, self._linear[index])

    def _close_cycle(self) -> None:
        if self.program is not None:
            self.start_pose = self._programmed_pose(self.program)
            self._start_tool = _flat(self._forward_kinematics(self.start_pose))
        if self._decode is None:
            self.setpoint = self.start_pose
            # nothing is expected, nothing is corrected
            self.servo.step(self.setpoint)
            return
        correction = self._missed_reply() if self._reply is None else self._valid_reply(self._reply)
        setpoint = tuple(start + value for start, value in zip(self.start_pose, correction))
        if self._tool_limit is not None:
            setpoint = self._tool_limit.follow(setpoint)
            if self._tool_limit.done:
                self._tool_limit = None
        if fault := self._fault(setpoint):
            self._stop(fault)
        if not self.running:
            return
        self._last_step = tuple(new - old for new, old in zip(setpoint, self.setpoint))
        self.applied, self.setpoint = correction, setpoint
        self.servo.step(setpoint)

    def _missed_reply(self) -> tuple[float, ...]:
        self.counters["missed"] += 1
        self.missed += 1
        if self.tool is not None:
            self.tool.on_missed_reply()
        if self.missed >= self.config.timeout:
            self.flag = True
            refused = self.refusals.present and not self.refusals.valid
            why = f"; the last one was refused: {self.refusals.last}" if refused else ""
            self._stop(f"timeout: {self.missed} cycles without a valid reply{why}")
        self._stop_level = self._stop_level and self._holds_stop
        return tuple(value if held else 0.0 for value, held in zip(self.applied, self._holds))

    def _valid_reply(self, reply: Reply) -> tuple[float, ...]:
        self.missed = 0
        if self.tool is not None:
            self.tool.on_reply(reply.switched)
        self.counters["without_stop"] += reply.stop is None and self._stop_declared
        stop = bool(reply.stop)
        if stop and not self._stop_level:
            self._stop(f"stop: requested by the PC, {self.terms.ended}")
        self._stop_level = stop
        wanted = reply.target
        if self._absolute:
            wanted = tuple([target - start for target, start in zip(wanted, self.start_pose)])
        correction = _clamp(wanted, self.correction_lower, self.correction_upper)
        self.counters["clamped"] += correction != wanted
        return correction

    def _fault(self, setpoint: tuple[float, ...]) -> str:
        """Return what supervision stops the session for, with the value and its limit; "" for nothing."""
        config = self.config
        for index, axis in enumerate(config.axes):
            if not config.lower[index] - _RANGE_SLACK <= setpoint[index] <= config.upper[index] + _RANGE_SLACK:
                asked, low, high = self._pendant(index, setpoint[index], config.lower[index], config.upper[index])
                return f"software limit {axis}: {asked}, range {low} to {high}"
            step = setpoint[index] - self.setpoint[index]
            if abs(step) > self._max_step[index]:
                limit = config.velocity[index]
                asked, most, own = self._pendant(index, abs(step) / self._period, config.velocity_factor * limit, limit)
                return f"command velocity {axis}: {asked}/s, limit {most}/s ({config.velocity_factor:g} times {own}/s)"
            change = abs(step - self._last_step[index])
            if change > self._max_step_change[index]:
                limit, factor = config.acceleration[index], config.acceleration_factor
                asked, most, own = self._pendant(index, change / self._period**2, factor * limit, limit)
                return f"command acceleration {axis}: {asked}/s², limit {most}/s² ({factor:g} times {own}/s²)"
        return ""

    def _pendant(self, index: int, *values: float) -> list[str]:
        """Return values of an axis [rad], [m] in the units of the pendant, for people."""
        factor, unit = self._people_units[index]
        return [f"{value * factor:.6g} {unit}" for value in values]

    def _stop(self, reason: str) -> None:
        if self.running:
            self.running, self.reason = False, reason

    def _count(self, name: str) -> bool:
        self.counters[name] += 1
        return False

    def _refuse(self, counter: str, kind: str, sentence: str) -> bool:
        self.refusals.on_refused(kind, sentence)
        return self._count(counter)


def _per_cycle(limits: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(limit * factor if factor else math.inf for limit in limits)


def _clamp(values: Sequence[float], lower: Sequence[float], upper: Sequence[float]) -> tuple[float, ...]:
    return tuple(min(max(value, low), high) for value, low, high in zip(values, lower, upper))


def _flat(pose: tuple[Sequence[float], Sequence[float]]) -> tuple[float, ...]:
    return (*map(float, pose[0]), *map(float, pose[1]))
