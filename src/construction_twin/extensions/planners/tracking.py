"""Where the arm should be and where it is, for the feedback of an action. Pure.

What is compared is the measured pose with the twin's pose for the same command, where the measurement says which one it answers:
travel times of the network do not count as error, the servo's lag does. Joint vectors are in the robot's order: rad, or m.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

from construction_twin.core.units import NANOSECONDS
from construction_twin.monitor.comparison import TwinHistory

#: The twin rests when its pose has been the same for this long [ns].
REST = 20_000_000


@dataclass(frozen=True, slots=True)
class Motion:
    """A pose [rad] and its velocity [rad/s], each of length n."""

    position: tuple[float, ...]
    velocity: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Sample:
    """Desired and actual motion at one moment, that of the setpoint with this nominal stamp [ns]."""

    stamp: int
    desired: Motion
    actual: Motion

    @property
    def error(self) -> Motion:
        """Actual minus desired."""
        rows = zip(astuple(self.actual), astuple(self.desired))
        return Motion(*(tuple(x - y for x, y in zip(actual, desired)) for actual, desired in rows))


@dataclass(frozen=True, slots=True)
class _ArmPose:
    """A measured pose, the stamp of its command, 0 for unknown, and the twin's newest stamp when it came [ns]."""

    q: tuple[float, ...]
    command_stamp: int
    twin_stamp: int


class Tracking:
    """Poses of twin and arm, compared at each `sample`.

    Velocities are differences between samples: at 50 Hz a step of a measurement with three decimals of a degree is 0.05 deg/s.
    """

    def __init__(self, has_arm: bool):
        self._has_arm = has_arm
        self._twin = TwinHistory()
        self._still_since = 0
        self._arm: _ArmPose | None = None
        self._last: Sample | None = None

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Store a pose of the twin with the stamp of the command that it executes [ns]."""
        latest = self._twin.latest
        if latest == (stamp, q):
            return
        # of a twin that was started anew: nothing that came before can be compared with it
        if latest is not None and stamp <= latest[0]:
            self._twin, self._arm, self._last, latest = TwinHistory(), None, None, None
        if latest is None or latest[1] != q:
            self._still_since = stamp
        self._twin.add(stamp, q)

    def on_arm(self, q: tuple[float, ...], command_stamp: int) -> None:
        """Store a measured pose, and the stamp of the command that it answers to [ns]; 0: unknown."""
        latest = self._twin.latest
        self._arm = _ArmPose(q, command_stamp, latest[0] if latest else 0)

    @property
    def at_rest(self) -> bool:
        """Whether the twin has stood still for `REST`."""
        latest = self._twin.latest
        return latest is not None and self._rests_at(latest[0])

    @property
    def settled(self) -> bool:
        """Whether the twin is at rest and the arm's pose answers to a command since then: what it shows is where it was sent.

        A pose of which the command is not known counts when it came after the twin was seen at rest.
        """
        if not self._has_arm or not self.at_rest:
            return self.at_rest
        arm = self._arm
        if arm is None:
            return False
        return arm.command_stamp >= self._still_since if arm.command_stamp else self._rests_at(arm.twin_stamp)

    def _rests_at(self, stamp: int) -> bool:
        return stamp - self._still_since >= REST

    def sample(self) -> Sample | None:
        """Return the newest desired and actual motion; None: unknown."""
        latest, arm = self._twin.latest, self._arm if self._has_arm else None
        if latest is None or (self._has_arm and arm is None):
            return None
        stamp, desired = latest
        actual = desired if arm is None else arm.q
        # at rest the gateway goes on playing stamps that the twin has left behind, or not reached
        if arm is not None and arm.command_stamp and (found := self._twin.at(arm.command_stamp)):
            stamp, desired = arm.command_stamp, found[0]
        last = self._last
        if last is not None and stamp <= last.stamp:
            return last
        if last is None:
            rest = (0.0,) * len(desired)
            self._last = Sample(stamp, Motion(desired, rest), Motion(actual, rest))
        else:
            seconds = (stamp - last.stamp) / NANOSECONDS
            self._last = Sample(stamp, _motion(last.desired, desired, seconds), _motion(last.actual, actual, seconds))
        return self._last


def _motion(before: Motion, q: tuple[float, ...], seconds: float) -> Motion:
    """Return the motion at a pose that was reached within some seconds."""
    return Motion(q, tuple((b - a) / seconds for a, b in zip(before.position, q)))
