"""One execution of a plan: which setpoint went out when, where on the path that was, how fast it is played, how it comes to rest.

Pure. Stamps in ns, angles in rad, m for prismatic joints.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from construction_twin.core.errors import ExecutionError
from construction_twin.core.limits import outside_tolerance
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.execution.path_progress import Progress
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan


@dataclass(frozen=True)
class StoppingPath:
    """How far the joints move until they rest, and in which time [s]: each joint there and back [rad], [m]."""

    joints: tuple[float, ...]
    time: float

    def text(self, robot: RobotModel) -> str:
        """Return time and distance of the joints that move most, one revolute and one prismatic, for people: deg and mm."""
        most = []
        for linear, unit in ((False, "rad"), (True, "m")):
            joints = [index for index, one in enumerate(robot.linear) if one is linear]
            if joints:
                joint = max(joints, key=lambda index: self.joints[index])
                most.append((Quantity(self.joints[joint], unit), robot.joint_names[joint]))
        (turn, revolute), (slide, carriage) = most[0], most[-1]
        if len(most) == 1:
            return Sentence("{time:.3f} s and at most {turn:.3} of {joint}", time=self.time, turn=turn, joint=revolute)
        return Sentence(
            "{time:.3f} s and at most {turn:.3} of {joint}, {slide:.3} of {carriage}",
            time=self.time,
            turn=turn,
            joint=revolute,
            slide=slide,
            carriage=carriage,
        )


def distance_along(poses: Iterable[Sequence[float]]) -> StoppingPath:
    """Return the distance along setpoints that follow each other by one cycle, from the pose when the stop was asked for."""
    poses = iter(poses)
    last = next(poses)
    joints, cycles = [0.0] * len(last), 0
    for pose in poses:
        joints = [moved + abs(b - a) for moved, a, b in zip(joints, last, pose)]
        last, cycles = pose, cycles + 1
    return StoppingPath(tuple(joints), cycles * CYCLE)


@dataclass(frozen=True)
class StoppingForecast:
    """Where a stop will end, stated before it has.

    Attributes:
        setpoints: From the last setpoint before the stop to rest.
        arm: What the arm does, `lag` behind [s]: the same, and the setpoints before it that it has not reached yet.
    """

    setpoints: StoppingPath
    arm: StoppingPath
    lag: float

    def text(self, robot: RobotModel) -> str:
        """Return one clause for the answer to `stop`."""
        path = self.setpoints.text(robot)
        if self.lag <= 0.0:
            return Sentence("setpoints come to rest after {path}", path=path)
        return Sentence(
            "setpoints come to rest after {path}; the arm, {lag:.3f} s behind, after {arm}",
            path=path,
            lag=self.lag,
            arm=self.arm.text(robot),
        )


#: A plan may start this far from the present pose [rad], and has moved when it is further from its start; rounding, not motion.
START_TOLERANCE = 1e-6
#: Setpoints that are remembered: 3 s. What the arm has not reached yet belongs to the forecast of a stop.
HISTORY = 750
#: Newest setpoints of which one may be the last that passed a gate: 1 s. The monitor is heard within 0.5 s, or it counts as silent.
RECENT = 250
#: Setpoints that a forecast computes in one go: about 1 ms of Python.
SETPOINTS_AT_ONCE = 4


class Playback:
    """A plan that is played, paused, held and stopped, one setpoint per cycle, always on its path.

    Attributes:
        start: Nominal stamp of the first setpoint [ns]; 0 before it.
        goal_stamp: Nominal stamp of the setpoint that reached the end of the trajectory [ns], or of the present segment; 0 before
            it.
    """

    def __init__(self, plan: Plan, robot: RobotModel):
        self.plan = plan
        self.start = 0
        self.goal_stamp = 0
        self._progress = Progress(plan.trajectory, robot.acceleration, robot.jerk)
        self._begins = True
        #: Time along the trajectory at which it was seen to have moved first [ns].
        self._moved_at = math.inf
        if plan.segments:
            # it stands at its beginning until the first segment is entered
            self._progress.bound(0.0)
        #: Stamp and time along the trajectory of the last setpoints [ns].
        self._history: deque[tuple[int, float]] = deque(maxlen=HISTORY)

    @property
    def elapsed(self) -> float:
        """Time along the trajectory [s]."""
        return self._progress.elapsed

    @property
    def moved(self) -> bool:
        """True from the setpoint on that left the start of the plan, or reached the end of a segment that stays there."""
        return self._progress.elapsed_ns >= self._moved_at

    @property
    def rate(self) -> float:
        """Present fraction of the planned speed, 0 to 1."""
        return self._progress.rate if self.start else 0.0

    @property
    def steady(self) -> bool:
        """True when the rate is what was asked for."""
        return self._progress.steady

    @property
    def at_rest(self) -> bool:
        """True when at rest, with no ramp planned."""
        return self._progress.at_rest

    def advance(self, stamp: int, rate: float) -> tuple[float, ...]:
        """Return the setpoint [rad] for a cycle; the rate changes smoothly to `rate`, see `Progress.advance`."""
        if self._begins:
            self.start = self.start or stamp
            self._begins = False
            setpoint = self._progress.begin(rate)
        else:
            setpoint = self._progress.advance(rate)
        self._remember(stamp, setpoint)
        return setpoint

    def arrive(self) -> None:
        """Rest at the end of a segment, which was reached."""
        self._progress.stand()

    def enter(self, end: float) -> None:
        """Go on with the next setpoint, from rest, until the time along the trajectory at which the next segment ends [s]."""
        self._progress.bound(end)
        self.goal_stamp, self._begins = 0, True

    def brake(self, stamp: int) -> tuple[float, ...]:
        """Return the setpoint [rad] for a cycle in which it brakes as hard as the acceleration limits allow."""
        setpoint = self._progress.brake()
        self._remember(stamp, setpoint)
        return setpoint

    def knows(self, stamp: int) -> bool:
        """Return whether a setpoint of this execution had this nominal stamp [ns]; of those too long ago nothing is known."""
        return any(known == stamp for known, _ in islice(reversed(self._history), RECENT))

    def rest_where(self, stamp: int) -> None:
        """Stand, from the next setpoint on, where the setpoint with this nominal stamp [ns] was: one that it `knows`."""
        self._progress.rest_at(next(elapsed for known, elapsed in self._history if known == stamp))
        self.goal_stamp = 0

    def _remember(self, stamp: int, setpoint: tuple[float, ...]) -> None:
        elapsed = self._progress.elapsed_ns
        self._history.append((stamp, elapsed))
        if elapsed < self._moved_at and elapsed > 0.0:
            start = self.plan.trajectory.positions[0]
            if self._progress.finished or outside_tolerance(start, setpoint, START_TOLERANCE) is not None:
                # the next segment begins at the end of this one, which the last step may pass by a part of a cycle
                self._moved_at = min(elapsed, self._progress.elapsed * NANOSECONDS)
        if self.goal_stamp == 0 and self._progress.finished:
            self.goal_stamp = stamp

    def braking(self, lag: float) -> StopForecaster:
        """Return what is needed to forecast a stop that begins now; nothing is computed yet.

        `lag`: how long the arm trails the setpoints [s]; 0 where it is not known. Of more than is remembered nothing is forecast.
        """
        if lag < 0.0:
            raise ExecutionError(Sentence("a lag of {lag:.3f} s, expected 0 or more: a clock was set", lag=lag))
        if len(self._history) == HISTORY and lag > (HISTORY - 1) * CYCLE:
            lag = 0.0
        cycles = min(-int(-lag * NANOSECONDS // CYCLE_NS), len(self._history) - 1)
        in_flight = [elapsed for _, elapsed in list(self._history)[len(self._history) - 1 - cycles :]]
        return StopForecaster(self._progress.copy(), in_flight, lag)


class StopForecaster:
    """The forecast of a stop, on a copy, which is used up: it needs no lock and holds up no cycle.

    `in_flight`: times along the trajectory of the setpoints that the arm has not reached yet [ns], the newest last.
    """

    def __init__(self, progress: Progress, in_flight: Sequence[float], lag: float):
        self._progress = progress
        self._in_flight = in_flight
        self._lag = lag

    def forecast(self, pause: Callable[[], None] = lambda: None) -> StoppingForecast:
        """Brake the copy to rest; return the distance it took. The execution itself takes the same, unless it is held before.

        `pause` is called every few setpoints: a thread that computes without a break keeps the one with the setpoints waiting.
        """
        progress, sample = self._progress, self._progress.trajectory.sample
        before = []
        for number, elapsed in enumerate(self._in_flight, start=1):
            before.append(tuple(sample(elapsed / NANOSECONDS)[0].tolist()))
            if number % SETPOINTS_AT_ONCE == 0:
                pause()
        poses = [before[-1]]
        while not (progress.at_rest or progress.finished):
            poses.append(progress.brake())
            if len(poses) % SETPOINTS_AT_ONCE == 0:
                pause()
        arm = distance_along(before[:-1] + poses)
        # a cycle more: the arm may be anywhere between two setpoints
        return StoppingForecast(distance_along(poses), replace(arm, time=arm.time + CYCLE), self._lag)


#: An arm that trails by so much is waited for, and is no longer when it trails by less than `KEEPS_UP` [s]. The gateway ends a
#: motion of which it had to put off 2 s.
TRAILS, KEEPS_UP = 1.0, 0.5


class PlayRate:
    """The newest limit on a plan's speed, and whether the arm is waited for.

    Attributes:
        waits: For an arm that trails, because replies to it are lost, or because the gateway slows it.
        fraction: 0 to 1; 0: it stands still until the limit is raised.
        standing: Whether the plan has come to rest because of either.
    """

    def __init__(self):
        self.fraction = 1.0
        self.standing = self.waits = False
        self.reason = ""

    @property
    def rate(self) -> float:
        """What the plan is played at, as a fraction of its planned speed."""
        return 0.0 if self.waits else self.fraction

    def trail(self, lag: float) -> bool:
        """Take how long the arm trails [s]; return whether that is news. What is not known, or no such time, changes nothing."""
        if not 0.0 <= lag < math.inf:
            return False
        waits = lag >= (KEEPS_UP if self.waits else TRAILS)
        changed = waits is not self.waits
        self.waits = waits
        return changed

    def take(self, fraction: float, reason: str) -> bool:
        """Take a limit and why it is there; return whether that is news. ExecutionError, and no change, when it is no fraction."""
        if fraction == self.fraction and reason == self.reason:
            return False
        # written so that a nan does not pass
        if not 0.0 <= fraction <= 1.0:
            raise ExecutionError(
                f"a rate of {fraction} was asked for; expected a fraction of the planned speed, 0 to 1"
            )
        self.fraction, self.reason = fraction, reason
        return True

    def sentence(self, cause: str) -> str:
        """Return what a playing plan does, and why: always of the present limit. `cause` is why it plays."""
        if self.standing and self.fraction == 0.0:
            return Sentence("stands still on the path, goes on by itself: {reason}", reason=self.reason)
        if self.waits:
            return Sentence(
                "waits on the path until the arm has caught up, goes on by itself: the arm trails by more than {trails:g} s, "
                "because replies to it are lost or it is slowed down",
                trails=TRAILS,
            )
        if self.fraction < 1.0:
            return Sentence(
                "{cause}; at {percent:.0f}% of the planned speed: {reason}",
                cause=cause,
                percent=100.0 * self.fraction,
                reason=self.reason,
            )
        return cause
