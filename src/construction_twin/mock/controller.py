"""A mock KR C4 with RSI, as a pure core: no clock, no socket, one call per controller cycle.

Angles are those of the controller's axes (their own sense of rotation and zero), in rad, order of `MockConfig.axes`.

Timing, exactly
---------------
`begin_cycle` opens cycle k and returns packet k; `receive` takes what arrives during cycle k; the next `begin_cycle`
closes it: the valid reply k, or the HOLDON rule when there is none, becomes the setpoint of cycle k, the servo moves during
cycle k, and packet k + 1 reports where it ended. With `IdealServo(3)` the AIPos of packet k + 3 equals start + AK of
reply k. Before the first valid reply the setpoint is the start pose.

What it does: IPOC +4 ms per packet from a large start value; a reply is valid only with the IPOC of the open cycle;
`Delay`; `Timeout`; blocks, channels, HOLDON per channel, SENTYPE and ONLYSEND as an Ethernet XML declares them; `#ABSOLUTE`
corrections clamped by AXISCORR, supervised by AXISCORRMON; soft limits; supervision of command velocity and acceleration; the
STOP object in mode ExitMoveCorr, on the rising edge of `Stop`; ASPos and RSol constant, but for a program of its own; an E-stop
with its ramp; T1. What it does not: brake for any other reason. A stopped arm stands where it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from construction_twin.core.errors import ConfigurationError, FaultError, TelegramError
from construction_twin.core.motion_errors import JointRangeError
from construction_twin.core.units import CYCLE
from construction_twin.mock.encoders import Encoders
from construction_twin.mock.own_motion import OwnMotion
from construction_twin.mock.servo import Servo
from construction_twin.rsi.controller_codec import RobotEncoder, SensorDecoder
from construction_twin.rsi.ethernet_xml import check_axes
from construction_twin.rsi.layout import STOP, AxisUnit, RsiLayout

#: Milliseconds the controller's clock advances from packet to packet at `#IPO_FAST`.
IPOC_STEP = 4
#: Slack of the soft limits [rad]: start + (limit - start) need not round to the limit.
_RANGE_SLACK = 1e-9

#: Position [m] and A, B, C [rad] of the tool in the base, from axis angles [rad].
ForwardKinematics = Callable[[tuple[float, ...]], tuple[Sequence[float], Sequence[float]]]


@dataclass(frozen=True)
class MockConfig:
    """What is set on the controller. Tuples are in the order of `axes`; rad throughout.

    Attributes
    ----------
    axes : tuple of str, length n
        Axis names in the telegrams.
    start_pose : tuple of float
        Pose in which the first session starts [rad], inside the soft limits.
    lower, upper : tuple of float
        Soft limits [rad].
    velocity, acceleration : tuple of float
        Limits that the supervision is a multiple of [rad/s], [rad/s^2].
    layout : RsiLayout, optional
        The Ethernet configuration; a reply that does not fit it does not count. Default: `RsiLayout.plain`.
    units : tuple of AxisUnit, optional
        How each axis is written in the telegrams; default: deg, and no axis linear.
    precision : int
        Decimals of sent values, 1 to 32. Real controllers default to 1 and run with 4; 6 keeps an evaluation exact.
    timeout : int
        Cycles without a valid reply after which RSI stops.
    cumulative_delay : bool
        True: `Delay` counts all missed cycles of the session; False: consecutive ones.
    correction_lower, correction_upper : tuple of float, or None
        AXISCORR: bounds of the correction [rad], <= 0 and >= 0; clamps without an error. None: soft limit - start pose.
    correction_monitor : tuple of float, or None
        AXISCORRMON: RSI stops when the clamped correction is larger [rad]. None: the larger of the two bounds.
    velocity_factor : float
        RSI stops when the setpoint moves faster than this times `velocity`; 0 switches it off.
    acceleration_factor : float
        The same for `acceleration`. One missed reply at speed v already is an acceleration of v / 4 ms, hundreds of times
        the limit: the default lets pass what `velocity_factor` lets pass from rest. 0 switches it off.
    first_ipoc : int
        IPOC of the first packet [ms].
    restart_gap : int
        How far the controller's clock has gone on when the next session starts [ms].
    """

    axes: tuple[str, ...]
    start_pose: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    layout: RsiLayout | None = None
    units: tuple[AxisUnit, ...] = ()
    precision: int = 6
    timeout: int = 100
    cumulative_delay: bool = False
    correction_lower: tuple[float, ...] | None = None
    correction_upper: tuple[float, ...] | None = None
    correction_monitor: tuple[float, ...] | None = None
    velocity_factor: float = 2.0
    acceleration_factor: float = 400.0
    first_ipoc: int = 4_208_163_634
    restart_gap: int = 10_000

    def __post_init__(self) -> None:
        if self.layout is None:
            object.__setattr__(self, "layout", RsiLayout.plain(self.axes))
        check_axes(self.layout, self.axes, "Ethernet XML")
        count = len(self.axes)
        for name in ("start_pose", "lower", "upper", "velocity", "acceleration", *_BOUNDS):
            values = getattr(self, name)
            if values is not None and (len(values) != count or not all(map(math.isfinite, values))):
                raise ConfigurationError(name, values, f"{count} finite numbers, one per axis")
        for name, allowed in (("timeout", self.timeout >= 1), ("first_ipoc", self.first_ipoc >= 0)):
            if not allowed:
                raise ConfigurationError(name, getattr(self, name), "a larger number")
        for name, sign in (("correction_lower", -1), ("correction_upper", 1), ("correction_monitor", 1)):
            if any(sign * value < 0.0 for value in getattr(self, name) or ()):
                raise ConfigurationError(name, getattr(self, name), f"numbers {'<=' if sign < 0 else '>='} 0")


_BOUNDS = ("correction_lower", "correction_upper", "correction_monitor")


class MockController(OwnMotion):
    """One mock controller; see the module for what it does and when.

    Parameters
    ----------
    config : MockConfig
    servo : Servo
    forward_kinematics : callable
        From axis angles [rad] to the tool's position [m] and A, B, C [rad], for RIst and RSol.

    Attributes
    ----------
    running : bool
        False when RSI has stopped; then nothing is sent and nothing is accepted.
    reason : str
        Why it stopped; empty while running.
    flag : bool
        The ETHERNET object's `$FLAG`: the link was interrupted (timeout).
    session : int
        Number of the RSI session, from 1.
    ipoc : int
        IPOC of the last packet [ms].
    delay : int
        What `Delay` reports.
    stat : int
        AXISCORR's `Stat`: 0 inactive, 1 correcting, plus 2 << 2 i (lower) or 4 << 2 i (upper) when axis i is clamped. The
        layout is ours: rsi.md gives none.
    start_pose, setpoint, measured : tuple of float, length n
        Programmed pose of the session, present setpoint, measured axes [rad].
    encoders : Encoders
        Between the measured axes and what is reported.
    reported, true : tuple of float, length n
        What the last packet reports of the axes, and where they really are, which only a fault of an encoder tells apart [rad].
    applied : tuple of float, length n
        Correction in effect, after clamping [rad].
    correction_lower, correction_upper, correction_monitor : tuple of float, length n
        Bounds in force in this session [rad].
    counters : dict of str to int
        Totals since construction, see `COUNTERS`.
    """

    #: packets sent; valid replies; missed cycles; replies to an earlier packet of the session; replies to no packet;
    #: further replies to a packet; unusable replies; replies for another SENTYPE; cycles with a clamped correction; replies
    #: while stopped; replies ignored on purpose
    COUNTERS = (
        "packets",
        "replies",
        "missed",
        "late_replies",
        "mismatched",
        "duplicates",
        "malformed",
        "wrong_sentype",
        "clamped",
        "unexpected",
        "ignored",
    )

    def __init__(self, config: MockConfig, servo: Servo, forward_kinematics: ForwardKinematics):
        super().__init__()
        self.config = config
        self.servo = servo
        self.encoders = Encoders(len(config.axes))
        self.reported: tuple[float, ...] = config.start_pose
        self._forward_kinematics = forward_kinematics
        layout = config.layout
        self._encoder = RobotEncoder(config.axes, config.precision, layout.send, config.units)
        self._decoder = None
        if not layout.onlysend:
            self._decoder = SensorDecoder(layout.sentype, config.axes, layout.receive, config.units)
        holdon = dict(zip(layout.receive, layout.holdon))
        axis_of = {channel: channel.partition(".")[2] for channel in holdon}
        #: Per axis, whether a missed reply keeps its correction.
        self._holdon = tuple(any(holdon[c] for c in holdon if axis_of[c] == axis) for axis in config.axes)
        self._stop_holdon = holdon.get(STOP, False)
        self._max_step = _per_cycle(config.velocity, config.velocity_factor * CYCLE)
        self._max_step_change = _per_cycle(config.acceleration, config.acceleration_factor * CYCLE * CYCLE)
        self.counters = dict.fromkeys(self.COUNTERS, 0)
        self.session = 0
        self.ipoc = 0
        self._start_session(config.start_pose, config.first_ipoc)

    @property
    def measured(self) -> tuple[float, ...]:
        """Measured axis positions [rad], shape (n,)."""
        return self.servo.measured

    @property
    def true(self) -> tuple[float, ...]:
        """Where the axes really are [rad], shape (n,)."""
        return tuple([angle - slip for angle, slip in zip(self.measured, self.encoders.slip)])

    def restart(self, pose: Sequence[float] | None = None) -> None:
        """Start a new RSI session, ending the present one if there is one.

        Parameters
        ----------
        pose : sequence of float, length n, optional
            Start pose [rad]; default: what the encoders report, brought inside the soft limits.

        Raises
        ------
        FaultError
            If the emergency stop is pressed.
        JointRangeError
            If `pose` lies outside the soft limits.
        """
        if self.pressed:
            raise FaultError(
                "restart", "the emergency stop is pressed", "a released one: inject `estop` with `on` false"
            )
        if pose is None:
            pose = _clamp(self.reported, self.config.lower, self.config.upper)
        self._check_range(pose)
        self._start_session(tuple(pose), self.ipoc + self.config.restart_gap)

    def begin_cycle(self) -> bytes | None:
        """Close the open cycle, move the servo, open the next one.

        Returns
        -------
        packet : bytes or None
            The datagram to send; None when RSI has stopped.
        """
        if self.running and self._open:
            self._close_cycle()
            self.ipoc += IPOC_STEP * self.running
        elif not self.running:
            self._move_without_session()
        measured = self.measured
        self.reported = self.encoders.read(measured) if self.encoders.active else measured
        if not self.running:
            return None
        self._open = True
        self._reply = None
        self.counters["packets"] += 1
        pose = _flat(self._forward_kinematics(self.reported))
        return self._encoder.encode(self.ipoc, self.reported, self.start_pose, pose, self._start_tool, self.delay)

    def receive(self, data: bytes) -> bool:
        """Take one datagram that arrived during the open cycle.

        Parameters
        ----------
        data : bytes

        Returns
        -------
        valid : bool
            True when it is the reply of this cycle; everything else is counted by its kind and has no effect.
        """
        if not self.running or self._decoder is None:
            return self._count("unexpected")
        if self.deaf:
            return self._count("ignored")
        try:
            telegram = self._decoder.parse(data)
        except TelegramError as error:
            return self._count("wrong_sentype" if error.reason == "sentype" else "malformed")
        if telegram.ipoc != self.ipoc or not self._open:
            behind = self.ipoc - telegram.ipoc
            earlier = behind > 0 and behind % IPOC_STEP == 0 and telegram.ipoc >= self._first_ipoc
            return self._count("late_replies" if earlier else "mismatched")
        if self._reply is not None:
            return self._count("duplicates")
        self._reply = telegram
        self.counters["replies"] += 1
        return True

    def _start_session(self, pose: tuple[float, ...], ipoc: int) -> None:
        config = self.config
        self._check_range(pose)
        self.session += 1
        self.running, self.reason, self.flag = True, "", False
        self.ipoc = self._first_ipoc = ipoc
        self.delay = self.stat = 0
        self.start_pose = self.setpoint = pose
        self.applied = self._zero = (0.0,) * len(pose)
        self._last_step = self._zero
        self._stop_level = False
        below = tuple(min(0.0, low - q) for low, q in zip(config.lower, pose))
        above = tuple(max(0.0, high - q) for high, q in zip(config.upper, pose))
        self.correction_lower, self.correction_upper = (
            config.correction_lower or below,
            config.correction_upper or above,
        )
        largest = tuple(max(-low, high) for low, high in zip(self.correction_lower, self.correction_upper))
        self.correction_monitor = config.correction_monitor or largest
        self._open, self._reply = False, None
        self._start_tool = _flat(self._forward_kinematics(pose))
        self.servo.reset(pose)
        self.encoders.absorb()
        self._begin_own_motion(pose)

    def _check_range(self, pose: Sequence[float]) -> None:
        for axis, value, lower, upper in zip(self.config.axes, pose, self.config.lower, self.config.upper):
            if not lower - _RANGE_SLACK <= value <= upper + _RANGE_SLACK:
                raise JointRangeError(axis, value, lower, upper)

    def _close_cycle(self) -> None:
        if self.program is not None:
            self.start_pose = self._programmed_pose()
            self._start_tool = _flat(self._forward_kinematics(self.start_pose))
        if self._decoder is None:
            self.setpoint = self.start_pose
            # ONLYSEND: RSI_MOVECORR is not called, nothing is expected, nothing is corrected
            self.servo.step(self.setpoint)
            return
        correction = self._missed_reply() if self._reply is None else self._valid_reply()
        setpoint = tuple(start + value for start, value in zip(self.start_pose, correction))
        if self._tool_limit is not None:
            setpoint = self._limited(setpoint)
        fault = self._fault(correction, setpoint)
        if fault:
            self._stop(fault)
        if not self.running:
            return
        self._last_step = tuple(new - old for new, old in zip(setpoint, self.setpoint))
        self.applied, self.setpoint = correction, setpoint
        self.servo.step(setpoint)

    def _missed_reply(self) -> tuple[float, ...]:
        self.counters["missed"] += 1
        self.delay += 1
        if self.delay >= self.config.timeout:
            self.flag = True
            self._stop(f"timeout: {self.delay} cycles without a valid reply")
        self._stop_level = self._stop_level and self._stop_holdon
        return tuple(value if held else 0.0 for value, held in zip(self.applied, self._holdon))

    def _valid_reply(self) -> tuple[float, ...]:
        if not self.config.cumulative_delay:
            self.delay = 0
        stop = bool(self._reply.stop)
        if stop and not self._stop_level:
            self._stop("stop: requested by the PC, RSI_MOVECORR ended")
        self._stop_level = stop
        wanted = self._reply.correction
        correction = _clamp(wanted, self.correction_lower, self.correction_upper)
        self.stat = 1
        for index, (asked, given) in enumerate(zip(wanted, correction)):
            if asked != given:
                self.stat |= (2 if asked < given else 4) << 2 * index
        self.counters["clamped"] += self.stat > 1
        return correction

    def _fault(self, correction: tuple[float, ...], setpoint: tuple[float, ...]) -> str:
        config = self.config
        for index, axis in enumerate(config.axes):
            if abs(correction[index]) > self.correction_monitor[index]:
                return f"correction monitor {axis}"
            if not config.lower[index] - _RANGE_SLACK <= setpoint[index] <= config.upper[index] + _RANGE_SLACK:
                return f"software limit {axis}"
            step = setpoint[index] - self.setpoint[index]
            if abs(step) > self._max_step[index]:
                return f"command velocity {axis}"
            if abs(step - self._last_step[index]) > self._max_step_change[index]:
                return f"command acceleration {axis}"
        return ""

    def _stop(self, reason: str) -> None:
        if self.running:
            self.running, self.reason, self.stat = False, reason, 0

    def _count(self, name: str) -> bool:
        self.counters[name] += 1
        return False


def _per_cycle(limits: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(limit * factor if factor else math.inf for limit in limits)


def _clamp(values: Sequence[float], lower: Sequence[float], upper: Sequence[float]) -> tuple[float, ...]:
    return tuple(min(max(value, low), high) for value, low, high in zip(values, lower, upper))


def _flat(pose: tuple[Sequence[float], Sequence[float]]) -> tuple[float, ...]:
    return (*map(float, pose[0]), *map(float, pose[1]))
