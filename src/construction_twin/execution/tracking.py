"""Where the arm should be and where it is, for the feedback of an action. Pure.

What is compared is the measured pose with the twin's pose for the same command, where the measurement says which one it answers:
travel times of the network do not count as error, the servo's lag does. Joint vectors are in the robot's order: rad, or m.
"""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.units import NANOSECONDS
from construction_twin.monitor.comparison import TwinHistory

#: The twin rests when its pose has been the same for this long [ns].
REST = 20_000_000


def _difference(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(x - y for x, y in zip(a, b))


@dataclass(frozen=True, slots=True)
class Motion:
    """A pose with its derivatives: `position` [rad], `velocity` [rad/s], `acceleration` [rad/s^2], each of length n."""

    position: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]

    def minus(self, other: Motion) -> Motion:
        """Return the difference to another one."""
        return Motion(
            _difference(self.position, other.position),
            _difference(self.velocity, other.velocity),
            _difference(self.acceleration, other.acceleration),
        )


@dataclass(frozen=True, slots=True)
class Sample:
    """Desired and actual motion at one moment.

    Attributes:
        stamp: Of the setpoint that both belong to [ns].
    """

    stamp: int
    desired: Motion
    actual: Motion

    @property
    def error(self) -> Motion:
        """Actual minus desired."""
        return self.actual.minus(self.desired)


@dataclass(frozen=True, slots=True)
class _ArmPose:
    """A measured pose, the stamp of its command, 0 for unknown, and the twin's newest stamp when it came [ns]."""

    q: tuple[float, ...]
    command_stamp: int
    twin_stamp: int


@dataclass(frozen=True, slots=True)
class _Pair:
    """Where the arm should be and where it is, and the stamp of the setpoint that both belong to [ns]."""

    stamp: int
    desired: tuple[float, ...]
    actual: tuple[float, ...]


class Tracking:
    """Keeps what twin and arm report, and answers with one Sample each time it is asked.

    Velocities and accelerations are differences between the moments it was asked at: of 20 ms at 50 Hz, in which one step of a
    measurement with three decimals of a degree is 0.05 deg/s.
    """

    def __init__(self, has_arm: bool):
        self._has_arm = has_arm
        self._twin = TwinHistory()
        self._still_since = 0
        self._arm: _ArmPose | None = None
        self._last: Sample | None = None

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Take a pose of the twin with the stamp of the command that it executes [ns].

        A stamp that is not newer is of a twin that was started anew: nothing that came before can be compared with it.
        """
        latest = self._twin.latest
        if latest == (stamp, q):
            return
        if latest is not None and stamp <= latest[0]:
            self._twin, self._arm, self._last, latest = TwinHistory(), None, None, None
        if latest is None or latest[1] != q:
            self._still_since = stamp
        self._twin.add(stamp, q)

    def on_arm(self, q: tuple[float, ...], command_stamp: int) -> None:
        """Take a measured pose, and the stamp of the command that it answers to [ns]; 0: not known."""
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
        """Return the newest desired and actual motion; None while one of them is not known."""
        pair = self._pair()
        if pair is None:
            return None
        stamp, desired, actual = pair.stamp, pair.desired, pair.actual
        last = self._last
        if last is not None and stamp <= last.stamp:
            return last
        if last is None:
            rest = (0.0,) * len(desired)
            self._last = Sample(stamp, Motion(desired, rest, rest), Motion(actual, rest, rest))
        else:
            seconds = (stamp - last.stamp) / NANOSECONDS
            self._last = Sample(stamp, _moved(last.desired, desired, seconds), _moved(last.actual, actual, seconds))
        return self._last

    def _pair(self) -> _Pair | None:
        latest = self._twin.latest
        if latest is None:
            return None
        if not self._has_arm:
            return _Pair(latest[0], latest[1], latest[1])
        if self._arm is None:
            return None
        stamp = self._arm.command_stamp
        found = self._twin.at(stamp) if stamp else None
        # at rest the gateway goes on playing stamps that the twin has left behind, or not reached
        return _Pair(stamp, found[0], self._arm.q) if found else _Pair(latest[0], latest[1], self._arm.q)


def _moved(before: Motion, q: tuple[float, ...], seconds: float) -> Motion:
    velocity = tuple((b - a) / seconds for a, b in zip(before.position, q))
    return Motion(q, velocity, tuple((b - a) / seconds for a, b in zip(before.velocity, velocity)))
