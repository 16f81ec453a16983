"""One execution of a plan: setpoints, place on the path, rate, braking.

Stamps in ns, angles in rad, m for prismatic joints. Time along the trajectory is called elapsed time; its rate against the clock
lies between 0 and 1. However it changes, the second difference of every joint's setpoints stays within its acceleration limit.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from construction_twin.core.limits import outside_tolerance
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory


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


#: Halvings with which a single step on the path is brought into every joint's acceleration limit.
HALVINGS = 10
#: Fraction of the jerk limits that a ramp may use; a plan uses all of it without a ramp.
JERK_FRACTION = 1.5
#: Fraction of the acceleration limits that a ramp may use: what rounding can add stays far below the rest.
ACCELERATION_FRACTION = 1.0 - 1e-9
#: Lengths of a ramp that are tried [cycles], from 32 ms to 3 s.
RAMP_CYCLES = (8, 10, 12, 15, 19, 24, 30, 37, 46, 58, 72, 90, 112, 140, 175, 220, 275, 340, 425, 530, 660, 750)
#: Longest smooth ramp up and down [cycles]: a person who pauses a plan expects it to rest soon.
LONGEST_RAMP, LONGEST_PAUSE = 750, 112
#: Most by which the rate, and its slope, change from one cycle to the next where no smooth ramp exists.
LARGEST_CHANGE = 0.05
LARGEST_CURVATURE = 0.005


@dataclass(frozen=True)
class _RampStep:
    """One cycle of a ramp: the step [ns], and rate and slope of the rate [1/cycle] at its end."""

    step: float
    rate: float
    slope: float


class Progress:
    """Where an execution is on its trajectory, one setpoint per cycle; at rate 1 these are its samples on the 4 ms grid.

    Args:
        trajectory: At rest at both ends, and inside the acceleration limits on any grid of 4 ms.
        acceleration, jerk: Length n. Limits [rad/s^2], [rad/s^3].
    """

    def __init__(self, trajectory: Trajectory, acceleration: Sequence[float], jerk: Sequence[float]):
        self.trajectory = trajectory
        #: Upper bound of the time along the trajectory [s]: the end of the present segment, or of the plan.
        self._bound = trajectory.duration
        self._difference_limit = np.array(acceleration) * CYCLE**2
        self._jerk_limit = np.array(jerk) * CYCLE**3
        # in nanoseconds, because whole cycles of them are exact
        self._elapsed = 0.0
        self._last = _RampStep(0.0, 0.0, 0.0)
        self._goal = 0.0
        self._ramp: deque[_RampStep] = deque()
        start = trajectory.positions[0]
        #: The last three setpoints, the newest last.
        self._poses = (start, start, start)

    @property
    def elapsed(self) -> float:
        """Time along the trajectory [s]."""
        return min(self._elapsed / NANOSECONDS, self._bound)

    @property
    def at_rest(self) -> bool:
        """True when at rest, with no ramp planned."""
        return self._last.step == 0.0 and not self._ramp

    @property
    def finished(self) -> bool:
        """True at the end of the trajectory, or at the time that bounds it."""
        return self.elapsed >= self._bound

    @property
    def rate(self) -> float:
        """Present rate, 0 to 1."""
        return self._last.rate

    @property
    def steady(self) -> bool:
        """True at the requested rate."""
        return not self._ramp and self._last.rate == self._goal

    def rest_at(self, elapsed: float) -> None:
        """Rest exactly at a time along the trajectory [ns], where the gate has stopped the joints."""
        self._elapsed, self._last, self._goal = elapsed, _RampStep(0.0, 0.0, 0.0), 0.0
        self._ramp.clear()
        pose = self._ahead(0.0)
        self._poses = (pose, pose, pose)

    def rest(self) -> None:
        """Rest from the next setpoint on, at a rest of the trajectory."""
        self._last, self._goal = _RampStep(0.0, 0.0, 0.0), 0.0
        self._ramp.clear()

    def bound(self, time: float) -> None:
        """Limit the time along the trajectory to this [s]; at rest, `begin` follows."""
        self._elapsed, self._bound = self.elapsed * NANOSECONDS, time

    def begin(self, rate: float) -> tuple[float, ...]:
        """Return the present setpoint [rad] and leave rest at `rate`, without a ramp."""
        self._goal, self._last = rate, _RampStep(rate * CYCLE_NS, rate, 0.0)
        return tuple(self._poses[2].tolist())

    def advance(self, rate: float) -> tuple[float, ...]:
        """Advance by one cycle, on a smooth ramp from the present rate to `rate`; return the setpoint, shape (n,) [rad].

        The ramp is the shortest found on which every joint stays within its acceleration limit and `JERK_FRACTION` of its jerk
        limit; a ramp down from which none leads up again is ended first. Where there is none, or none that comes to rest soon
        enough, the rate changes as far as the acceleration limits allow, its slope as gently as the jerk limits ask for.
        """
        if rate != self._goal:
            ramp = self._plan_ramp(rate, LONGEST_RAMP if rate >= self._last.rate else LONGEST_PAUSE)
            if ramp is not None:
                self._ramp, self._goal = ramp, rate
            elif not self._ramp or rate < self._last.rate:
                self._ramp.clear()
                self._goal = rate
        if self._ramp:
            return self._advance_by(self._ramp.popleft())
        target = self._goal * CYCLE_NS
        step = target if self._last.step == target else self._step_towards(target)
        return self._advance_by(
            _RampStep(step, step / CYCLE_NS, (step - self._last.step) / CYCLE_NS if step != target else 0.0)
        )

    def brake(self) -> tuple[float, ...]:
        """Brake by one cycle as hard as the acceleration limits allow, whatever the jerk; return the setpoint [rad]."""
        self._ramp.clear()
        self._goal = 0.0
        step = self._nearest_allowed(0.0)
        return self._advance_by(_RampStep(step, step / CYCLE_NS, 0.0))

    def _advance_by(self, cycle: _RampStep) -> tuple[float, ...]:
        self._elapsed += cycle.step
        self._last = cycle
        pose = self._ahead(0.0)
        self._poses = (*self._poses[1:], pose)
        return tuple(pose.tolist())

    def _ahead(self, step: float) -> np.ndarray:
        elapsed = (self._elapsed + step) / NANOSECONDS
        return self.trajectory.sample(min(elapsed, self._bound))[0]

    # -- single steps

    def _step_towards(self, target: float) -> float:
        """Return the next step [ns], as far towards `target` as acceleration limits and a gentle change of the slope allow."""
        rest, slope = (target - self._last.step) / CYCLE_NS, self._last.slope
        speed = np.abs(self.trajectory.sample(self.elapsed)[1]) * CYCLE
        curvature = min(LARGEST_CURVATURE, float((self._jerk_limit / np.maximum(speed, 1e-12)).min()))
        if abs(rest) <= curvature:
            return self._nearest_allowed(target)
        # the largest change that can still be taken back, by `curvature` in each cycle, until the target is reached
        most = (math.sqrt(curvature * curvature + 8.0 * curvature * abs(rest)) - curvature) / 2
        wanted = math.copysign(min(most, LARGEST_CHANGE), rest)
        change = min(max(wanted, slope - curvature), slope + curvature)
        return self._nearest_allowed(min(max(self._last.step + change * CYCLE_NS, 0.0), float(CYCLE_NS)))

    def _nearest_allowed(self, step: float) -> float:
        """Return the step [ns] nearest to `step` that the joints can take; an unchanged one they can, as on the path."""
        if self._allowed(step):
            return step
        refused, accepted = step, self._last.step
        for _ in range(HALVINGS):
            middle = (refused + accepted) / 2
            refused, accepted = (refused, middle) if self._allowed(middle) else (middle, accepted)
        return accepted

    def _allowed(self, step: float) -> bool:
        """Return whether the joints can go there in one cycle, by gate's and gateway's second difference."""
        difference = self._ahead(step) - 2.0 * self._poses[2] + self._poses[1]
        return bool((np.abs(difference) <= self._difference_limit).all())

    # -- ramps

    def _plan_ramp(self, goal: float, longest: int) -> deque[_RampStep] | None:
        """Return the shortest ramp to `goal` found by bisection of `RAMP_CYCLES`, within the joints' limits; None: none found."""
        best, shorter, longer = None, -1, bisect_right(RAMP_CYCLES, longest)
        while longer - shorter > 1:
            middle = (shorter + longer) // 2
            ramp = self._ramp_of(goal, RAMP_CYCLES[middle])
            if ramp is None:
                shorter = middle
            else:
                best, longer = ramp, middle
        return best

    def _ramp_of(self, goal: float, cycles: int) -> deque[_RampStep] | None:
        """Return the ramp of that many cycles, a cubic that ends flat at the goal; None when a setpoint on it fails."""
        start, lift, slope = self._last.rate, goal - self._last.rate, self._last.slope * cycles
        rate = Polynomial((start, slope, 3.0 * lift - 2.0 * slope, slope - 2.0 * lift))
        x = np.arange(cycles + 1) / cycles
        rates = rate(x)
        if rates.min() < -1e-12 or rates.max() > 1.0 + 1e-12:
            return None
        steps = np.clip(np.diff(rate.integ()(x)) * cycles, 0.0, 1.0) * CYCLE_NS
        if not self._smooth(np.concatenate((steps, np.full(3, goal * CYCLE_NS)))):
            return None
        rates, slopes = np.clip(rates, 0.0, 1.0), rate.deriv()(x) / cycles
        rates[-1], slopes[-1] = goal, 0.0
        return deque(map(_RampStep, steps.tolist(), rates[1:].tolist(), slopes[1:].tolist()))

    def _smooth(self, steps: np.ndarray) -> bool:
        """Return whether the setpoints of these steps [ns] stay inside the limits, from the last three on."""
        elapsed = (self._elapsed + np.cumsum(steps)) / NANOSECONDS
        poses = np.vstack((*self._poses, self.trajectory.sample_many(np.minimum(elapsed, self._bound))[0]))
        differences = np.diff(poses, 2, axis=0)[1:]
        if (np.abs(differences) > ACCELERATION_FRACTION * self._difference_limit).any():
            return False
        return bool((np.abs(np.diff(poses, 3, axis=0)) <= JERK_FRACTION * self._jerk_limit).all())


#: A plan may start this far from the present pose [rad], and has moved when it is further from its start; rounding, not motion.
START_TOLERANCE = 1e-6
#: Newest setpoints of which one may be the last that passed a gate: 1 s. A monitor without a message for 0.5 s counts as silent.
RECENT = 250


class Playback(Progress):
    """A plan that is played, paused, held and stopped, one setpoint per cycle, always on its path.

    Attributes:
        start: Nominal stamp of the first setpoint [ns]; 0 before it.
        goal_stamp: Of the setpoint that reached the end of the trajectory, or of the present segment [ns]; 0 before it.
    """

    def __init__(self, plan: Plan, robot: RobotModel):
        super().__init__(plan.trajectory, robot.acceleration, robot.jerk)
        self.plan = plan
        self.start = 0
        self.goal_stamp = 0
        self._begins = True
        #: Time along the trajectory at which it was seen to have moved first [ns].
        self._moved_at = math.inf
        if plan.segments:
            # it stands at its beginning until the first segment is entered
            self.bound(0.0)
        #: Stamp and time along the trajectory of the last setpoints [ns].
        self._history: deque[tuple[int, float]] = deque(maxlen=RECENT)

    @property
    def moved(self) -> bool:
        """True from the setpoint on that left the start of the plan, or reached the end of a segment that stays there."""
        return self._elapsed >= self._moved_at

    def play(self, stamp: int, rate: float) -> tuple[float, ...]:
        """Return the setpoint [rad] for a cycle; the rate changes smoothly to `rate`, see `Progress.advance`."""
        if self._begins:
            self.start = self.start or stamp
            self._begins = False
            return self._remember(stamp, self.begin(rate))
        return self._remember(stamp, self.advance(rate))

    def stop(self, stamp: int) -> tuple[float, ...]:
        """Return the setpoint [rad] for a cycle in which it brakes as hard as the acceleration limits allow."""
        return self._remember(stamp, self.brake())

    def enter(self, end: float) -> None:
        """Continue from rest to the end of the next segment, a time along the trajectory [s]."""
        self.bound(end)
        self.goal_stamp, self._begins = 0, True

    def has_stamp(self, stamp: int) -> bool:
        """Return whether a recent setpoint of this execution had this nominal stamp [ns]."""
        return any(known == stamp for known, _ in self._history)

    def rest_at_stamp(self, stamp: int) -> None:
        """Rest, from the next setpoint on, at the setpoint of a nominal stamp [ns], if `has_stamp`."""
        self.rest_at(next(elapsed for known, elapsed in self._history if known == stamp))
        self.goal_stamp = 0

    def _remember(self, stamp: int, setpoint: tuple[float, ...]) -> tuple[float, ...]:
        elapsed = self._elapsed
        self._history.append((stamp, elapsed))
        if elapsed < self._moved_at and elapsed > 0.0:
            start = self.plan.trajectory.positions[0]
            if self.finished or outside_tolerance(start, setpoint, START_TOLERANCE) is not None:
                # the next segment begins at the end of this one, which the last step may pass by a part of a cycle
                self._moved_at = min(elapsed, self.elapsed * NANOSECONDS)
        if self.goal_stamp == 0 and self.finished:
            self.goal_stamp = stamp
        return setpoint
