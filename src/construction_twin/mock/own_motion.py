"""What the mock controller does with its setpoints by itself: E-stop ramp, motion of its own program, speed limit of T1.

Pure: one step per 4 ms cycle. Angles in rad, plain tuples, standard library only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from construction_twin.core.errors import FaultError
from construction_twin.core.units import CYCLE
from construction_twin.mock.servo import Chase

#: Speed of the tool in T1 [m/s] (rsi.md section 7; the standard value, there without a source).
T1_SPEED = 0.25
#: Fraction of the velocity and acceleration limits that a program of the controller uses unless it is given a time.
JOG_FRACTION = 0.3
#: The servo is given this long to arrive at the end of a program [cycles].
_SETTLING_CYCLES = 250
#: Of the quintic rest-to-rest profile: largest velocity and acceleration of a unit way in unit time.
_PEAK_VELOCITY, _PEAK_ACCELERATION = 15.0 / 8.0, 10.0 / math.sqrt(3.0)


class EmergencyBrake:
    """The STOP ramp: all axes come to rest together, straight on, as fast as the slowest one's limit allows.

    Parameters
    ----------
    position, step : sequence of float, length n
        Setpoint [rad] and its last step [rad per cycle].
    acceleration : sequence of float, length n
        Limits [rad/s^2].
    measured : sequence of float, length n
        Where the arm is, behind the setpoint [rad].

    Attributes
    ----------
    cycles : int
        Length of the setpoint's ramp.
    distance : tuple of float, length n
        The arm's way to rest, what it is behind included [rad].
    """

    def __init__(
        self,
        position: Sequence[float],
        step: Sequence[float],
        acceleration: Sequence[float],
        measured: Sequence[float],
    ):
        self.position = tuple(position)
        self._step = tuple(step)
        budgets = [limit * CYCLE * CYCLE for limit in acceleration]
        self.cycles = math.ceil(max(abs(s) / budget for s, budget in zip(step, budgets)) - 1e-9)
        self._left = self.cycles
        fraction = (self.cycles - 1) / 2.0 if self.cycles else 0.0
        self.distance = tuple(q + s * fraction - now for q, s, now in zip(position, step, measured))

    @property
    def done(self) -> bool:
        """True at rest."""
        return self._left <= 0

    def advance(self) -> tuple[float, ...]:
        """Return the setpoint of the next cycle [rad]; at rest always the same."""
        if self._left > 0:
            self._left -= 1
            fraction = self._left / self.cycles
            self.position = tuple([q + s * fraction for q, s in zip(self.position, self._step)])
        return self.position


class Program:
    """A motion of the controller's own: from rest to rest along a straight line in joint space, in a given time.

    Parameters
    ----------
    start, goal : sequence of float, length n
        [rad]
    velocity, acceleration : sequence of float, length n
        Limits [rad/s], [rad/s^2].
    duration : float, optional
        [s]; 0 (default): as long as `JOG_FRACTION` of the limits takes.

    Raises
    ------
    ValueError
        If the limits do not allow `duration`; the text names the shortest one.
    """

    def __init__(
        self,
        start: Sequence[float],
        goal: Sequence[float],
        velocity: Sequence[float],
        acceleration: Sequence[float],
        duration: float = 0.0,
    ):
        self._start, self._goal = tuple(start), tuple(goal)
        way = [abs(b - a) for a, b in zip(start, goal)]
        quickest = _shortest(way, velocity, acceleration, 1.0)
        if duration and duration < quickest:
            raise ValueError(f"a motion of {duration:g} s exceeds the limits; give at least {quickest:.3f} s")
        self.cycles = max(1, math.ceil((duration or _shortest(way, velocity, acceleration, JOG_FRACTION)) / CYCLE))
        self._cycle = 0

    @property
    def done(self) -> bool:
        """True at the goal."""
        return self._cycle >= self.cycles

    def advance(self) -> tuple[float, ...]:
        """Return the pose of the next cycle [rad]."""
        self._cycle += 1
        if self.done:
            return self._goal
        u = self._cycle / self.cycles
        fraction = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        return tuple([a + fraction * (b - a) for a, b in zip(self._start, self._goal)])


class ToolSpeedLimit:
    """T1: the setpoint follows the corrected one within the axes' limits, and with the tool no faster than a limit.

    The steps of all axes are shortened alike, so the arm keeps its direction; then each is brought within its
    acceleration limit, so that the tool may be faster for as long as it takes to brake. What a KR C4 really does about
    fast corrections in T1 is not known (rsi.md section 14): it may as well stop RSI.

    Parameters
    ----------
    position, step : sequence of float, length n
        Present setpoint [rad] and its last step [rad per cycle].
    velocity, acceleration : sequence of float, length n
        Limits [rad/s], [rad/s^2].
    tool_position : callable
        From axis angles [rad] to the tool's position [m].
    speed : float, optional
        [m/s]
    """

    def __init__(
        self,
        position: Sequence[float],
        step: Sequence[float],
        velocity: Sequence[float],
        acceleration: Sequence[float],
        tool_position: Callable[[tuple[float, ...]], Sequence[float]],
        speed: float = T1_SPEED,
    ):
        self._chases = [Chase(q, q, s, v, a) for q, s, v, a in zip(position, step, velocity, acceleration)]
        self._tool_position = tool_position
        self._longest_step = speed * CYCLE
        self._ending = False

    @property
    def done(self) -> bool:
        """True when it was lifted and every axis has met its setpoint since."""
        return self._ending and all(chase.met for chase in self._chases)

    def lift(self) -> None:
        """Let the arm catch up within its own limits."""
        self._ending = True

    def follow(self, setpoint: Sequence[float]) -> tuple[float, ...]:
        """Return the setpoint of this cycle in place of `setpoint` [rad]."""
        steps = [chase.aim(goal) for chase, goal in zip(self._chases, setpoint)]
        if self._ending or not any(steps):
            return tuple([chase.move() for chase in self._chases])
        here = tuple([chase.position for chase in self._chases])
        there = tuple([q + s for q, s in zip(here, steps)])
        way = math.dist(self._tool_position(here), self._tool_position(there))
        if way <= self._longest_step:
            return tuple([chase.move() for chase in self._chases])
        fraction = self._longest_step / way
        return tuple([chase.move(chase.within_budget(fraction * step)) for chase, step in zip(self._chases, steps)])


class OwnMotion:
    """What `MockController` does by itself, beside following corrections; its base class.

    Attributes
    ----------
    pressed : bool
        True while the emergency stop is pressed.
    needs_person : bool
        True after an emergency stop: RSI is started again by a person only.
    deaf : bool
        True while replies are ignored.
    ramp : EmergencyBrake or None
        The last emergency stop's, until the next session.
    program : Program or None
        The program that runs.
    """

    def __init__(self) -> None:
        self.pressed = self.needs_person = self.deaf = False
        self.ramp: EmergencyBrake | None = None
        self.program: Program | None = None
        self._tool_limit: ToolSpeedLimit | None = None
        self._tool_speed = 0.0
        self._settling = 0

    def press_emergency_stop(self) -> None:
        """Brake to rest within the acceleration limits and end the RSI session; packets cease at once."""
        self.pressed = self.needs_person = True
        self.program = None
        if self.running:
            self.ramp = EmergencyBrake(self.setpoint, self._last_step, self.config.acceleration, self.measured)
            self._stop("emergency stop")

    def release_emergency_stop(self) -> None:
        """Unlock the emergency stop; nothing moves or starts by that."""
        self.pressed = False

    def ignore_replies(self, ignored: bool) -> None:
        """Take no notice of replies, or take notice again."""
        self.deaf = ignored

    def limit_tool_speed(self, speed: float) -> None:
        """Select T1: the tool moves no faster than `speed` [m/s]."""
        self._tool_speed = speed
        self._tool_limit = self._make_tool_limit(self.setpoint, self._last_step)

    def lift_tool_speed(self) -> None:
        """Select another mode: the arm catches up within its limits."""
        self._tool_speed = 0.0
        if self._tool_limit is not None:
            self._tool_limit.lift()

    def run_program(self, goal: Sequence[float], duration: float = 0.0) -> None:
        """Move to a pose without the PC, in a session or without one.

        In a session the programmed pose (ASPos) moves and corrections are added to it, so the goal is met if they stay.

        Parameters
        ----------
        goal : sequence of float, length n
            [rad]
        duration : float, optional
            [s]; 0: `JOG_FRACTION` of the limits.

        Raises
        ------
        FaultError
            If the arm cannot move by itself now.
        ValueError
            If the limits do not allow `duration`.
        JointRangeError
            If the goal lies outside the range.
        """
        if self.pressed or self.ramp is not None and not self.ramp.done:
            raise FaultError("jog", tuple(goal), "an arm at rest whose emergency stop is not pressed")
        self._check_range(goal)
        if not self.running:
            self.ramp = None
            self.start_pose, self.applied = self.setpoint, self._zero
        target = tuple([q - correction for q, correction in zip(goal, self.applied)])
        self.program = Program(self.start_pose, target, self.config.velocity, self.config.acceleration, duration)

    def _make_tool_limit(self, position: Sequence[float], step: Sequence[float]) -> ToolSpeedLimit:
        limits = self.config.velocity, self.config.acceleration
        return ToolSpeedLimit(position, step, *limits, lambda q: self._forward_kinematics(q)[0], self._tool_speed)

    def _begin_own_motion(self, pose: tuple[float, ...]) -> None:
        """A new session: at rest at `pose`, without program or ramp; T1 stays."""
        self.ramp = self.program = self._tool_limit = None
        self.needs_person = False
        if self._tool_speed:
            self._tool_limit = self._make_tool_limit(pose, self._zero)

    def _programmed_pose(self) -> tuple[float, ...]:
        """Advance the program; return the programmed pose [rad]."""
        pose = self.program.advance()
        if self.program.done:
            self.program = None
        return pose

    def _limited(self, setpoint: tuple[float, ...]) -> tuple[float, ...]:
        """Return the setpoint as T1 allows it."""
        limited = self._tool_limit.follow(setpoint)
        if self._tool_limit.done:
            self._tool_limit = None
        return limited

    def _move_without_session(self) -> None:
        """One cycle while RSI has stopped: the ramp, or a program."""
        if self.ramp is not None:
            self.setpoint = self.ramp.advance()
        elif self.program is not None:
            self.setpoint = self.start_pose = self._programmed_pose()
            self._settling = _SETTLING_CYCLES
        elif self._settling:
            self._settling -= 1
        else:
            return
        self.servo.step(self.setpoint)


def _shortest(way: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float], fraction: float) -> float:
    """Return the shortest time of a quintic motion over `way` [rad] at a fraction of the limits [s]."""
    by_velocity = max(_PEAK_VELOCITY * d / (fraction * v) for d, v in zip(way, velocity))
    by_acceleration = max(math.sqrt(_PEAK_ACCELERATION * d / (fraction * a)) for d, a in zip(way, acceleration))
    return max(by_velocity, by_acceleration)
