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

    Attributes
    ----------
    stamp : int
        Of the setpoint that both belong to [ns].
    desired, actual : Motion
    """

    stamp: int
    desired: Motion
    actual: Motion

    @property
    def error(self) -> Motion:
        """Actual minus desired."""
        return self.actual.minus(self.desired)


class Tracking:
    """Keeps what twin and arm report, and answers with one Sample each time it is asked.

    Velocities and accelerations are differences between the moments it was asked at: of 20 ms at 50 Hz, in which one step of a
    measurement with three decimals of a degree is 0.05 deg/s.

    Parameters
    ----------
    has_arm : bool
        Without a physical arm, the twin's pose is the actual one, too.
    """

    def __init__(self, has_arm: bool):
        self._has_arm = has_arm
        self._twin = TwinHistory()
        self._still_since = 0
        self._arm: tuple[int, tuple[float, ...]] | None = None
        self._last: Sample | None = None

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Take a pose of the twin with the stamp of the command that it executes [ns]."""
        latest = self._twin.latest
        if latest is None or latest[1] != q:
            self._still_since = stamp
        self._twin.add(stamp, q)

    def on_arm(self, q: tuple[float, ...], command_stamp: int) -> None:
        """Take a measured pose, and the stamp of the command that it answers to [ns]; 0: not known."""
        self._arm = command_stamp, q

    @property
    def at_rest(self) -> bool:
        """Whether the twin has stood still for `REST`."""
        latest = self._twin.latest
        return latest is not None and latest[0] - self._still_since >= REST

    def sample(self) -> Sample | None:
        """Return the newest desired and actual motion; None while one of them is not known."""
        pair = self._pair()
        if pair is None:
            return None
        stamp, desired, actual = pair
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

    def _pair(self) -> tuple[int, tuple[float, ...], tuple[float, ...]] | None:
        latest = self._twin.latest
        if latest is None:
            return None
        if not self._has_arm:
            return latest[0], latest[1], latest[1]
        if self._arm is None:
            return None
        command_stamp, actual = self._arm
        found = self._twin.at(command_stamp) if command_stamp else None
        # at rest the gateway goes on playing stamps that the twin has left behind, or not reached
        return (command_stamp, found[0], actual) if found else (latest[0], latest[1], actual)


def _moved(before: Motion, q: tuple[float, ...], seconds: float) -> Motion:
    velocity = tuple((b - a) / seconds for a, b in zip(before.position, q))
    return Motion(q, velocity, tuple((b - a) / seconds for a, b in zip(before.velocity, velocity)))
