"""The kinematic twin: executes commands exactly, after it has assumed the arm's pose.

Pure; angles in rad, prismatic joints in m, stamps in ns.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Protocol

from construction_twin.core.follower import Follower
from construction_twin.core.limits import MotionLimits, outside_tolerance
from construction_twin.core.units import CYCLE_NS, NANOSECONDS

#: Commands without an answer that are remembered: one second.
_REMEMBERED = NANOSECONDS // CYCLE_NS
#: More commands without an answer than this are a problem: 0.1 s, after which the gate misses the twin's pose.
_LATE = 25


class GazeboTwin:
    """A `TwinBackend` whose poses come later, through `on_simulated_pose`; efforts and contacts stay with Gazebo."""

    effort: tuple[float, ...] = ()
    contacts: tuple[tuple[str, str], ...] = ()

    def __init__(self) -> None:
        self._open: deque[int] = deque(maxlen=_REMEMBERED)

    @property
    def fault(self) -> str:
        """One sentence when Gazebo is silent or late; empty: it answers."""
        waiting = len(self._open)
        if waiting == _REMEMBERED:
            return (
                "Gazebo has answered no command for 1 s: the twin has no pose; what is commanded does not depend on it"
            )
        return f"Gazebo is {waiting * CYCLE_NS // 1_000_000} ms behind what is commanded" if waiting > _LATE else ""

    def restart(self) -> None:
        """Leave all as it is: the plugin places the arm at the next stream's first command."""

    def cycle(self, commanded: tuple[float, ...]) -> None:
        """See `TwinBackend`."""

    def on_published(self, stamp: int) -> None:
        """Store the stamp of a published command."""
        self._open.append(stamp)

    def on_simulated_pose(self, stamp: int) -> bool:
        """Remove the command of a simulated pose, by stamp, and those before it; return whether it waited."""
        if stamp not in self._open:
            return False
        while self._open.popleft() != stamp:
            continue
        return True


class TwinBackend(Protocol):
    """The source of the twin's pose, called once per cycle of 4 ms.

    Attributes:
        effort: Length n. What the axes give [N m], [N]; empty: unknown.
        contacts: What touches and, by the planner, should not: pairs of names.
    """

    effort: tuple[float, ...]
    contacts: tuple[tuple[str, str], ...]

    @property
    def fault(self) -> str:
        """Deviation of the simulation, in one sentence; "": it runs as it should."""

    def restart(self) -> None:
        """Forget where the arm is: the next cycle begins at rest, at the pose that is commanded then."""

    def cycle(self, commanded: tuple[float, ...]) -> tuple[float, ...] | None:
        """Advance one cycle towards the commanded pose; return the simulated one at its end, None: it comes later."""


class KinematicBackend:
    """An arm without mass, at its commanded pose."""

    effort: tuple[float, ...] = ()
    contacts: tuple[tuple[str, str], ...] = ()
    fault = ""

    def restart(self) -> None:
        """See `TwinBackend`."""

    def cycle(self, commanded: tuple[float, ...]) -> tuple[float, ...]:
        """Return the commanded pose."""
        return commanded


#: Decimals of a measured pose whose rounding is no motion of its own: the format's default.
DECIMALS = 3
#: The motion of more cycles than this is not made up for at once [cycles]: 0.25 s.
MOST_CYCLES = 62


class MirrorTwin:
    """Follows measured poses, from a pose at rest, exactly where the limits allow it, and inside the limits elsewhere."""

    def __init__(self, limits: MotionLimits, pose: tuple[float, ...]):
        self._follower = Follower(limits, DECIMALS, pose)
        self._target = pose
        self._stamp = 0

    @property
    def arrived(self) -> bool:
        """True while the twin is where the arm was measured."""
        return not self._follower.settling

    def follow(self, stamp: int, q: tuple[float, ...]) -> tuple[float, ...] | None:
        """Follow a measured pose over the cycles since the last one; return the twin's pose, None for a stamp that is not newer."""
        if stamp <= self._stamp:
            return None
        cycles = min(max(1, round((stamp - self._stamp) / CYCLE_NS)), MOST_CYCLES) if self._stamp else 1
        last, self._target, self._stamp = self._target, q, stamp
        for cycle in range(1, cycles + 1):
            fraction = cycle / cycles
            pose = self._follower.follow(
                q if cycle == cycles else tuple([a + fraction * (b - a) for a, b in zip(last, q)])
            )
        return pose


#: The first command may differ this much from the pose taken over (docs/architecture.md, law 5): revolute
#: joints [rad], prismatic ones [m].
START_TOLERANCE, START_TOLERANCE_LINEAR = math.radians(0.05), 0.0005
#: A first command, or one behind a silence, that is older by more than this than what was before it is of a clock that was set back
#: meanwhile [ns]: an executor that is started again begins on ROS time. Less is the way of a message.
ANOTHER_CLOCK = NANOSECONDS // 20
#: After this long without a command the held pose is repeated by the clock [ns]; executor.TWIN_TIMEOUT must be longer.
SILENCE = NANOSECONDS // 4


class VirtualRobot:
    """A robot at its commanded pose.

    Args:
        home: Shape (n,). Pose to start at [rad], [m]; None waits for `assume_pose`: a twin of a physical arm makes no pose up.
        linear: Shape (n,). Which joints are linear; default: none.
    """

    def __init__(self, home: tuple[float, ...] | None, linear: Sequence[bool] = ()):
        tolerances = tuple(START_TOLERANCE_LINEAR if slides else START_TOLERANCE for slides in linear)
        self._tolerance = tolerances if any(linear) else START_TOLERANCE
        self.pose: tuple[float, ...] | None = home
        self.stamp = 0
        self._executing = False
        self._mirror: MirrorTwin | None = None

    @property
    def mirrors(self) -> bool:
        """True while the arm leads and the twin follows it."""
        return self._mirror is not None

    def restart(self) -> None:
        """Forget the pose and wait for the next `assume_pose`."""
        self.pose, self.stamp, self._executing, self._mirror = None, 0, False, None

    def begin_mirror(self, limits: MotionLimits) -> None:
        """Follow the arm from the held pose on, if there is one, and refuse commands until `end_mirror`."""
        if self.pose is not None and self._mirror is None:
            self._mirror, self._executing = MirrorTwin(limits, self.pose), False

    def end_mirror(self) -> None:
        """Stand still at the present pose; commands count again."""
        self._mirror = None

    def follow(self, stamp: int, q: tuple[float, ...]) -> bool:
        """Follow the arm's measured pose [rad] with its stamp [ns]; return whether the twin, which mirrors, took a step."""
        pose = self._mirror and self._mirror.follow(stamp, q)
        if not pose:
            return False
        self.pose = pose
        return True

    def assume_pose(self, q: tuple[float, ...]) -> bool:
        """Assume the physical arm's pose [rad] if none is held; return whether it was assumed."""
        if self.pose is not None:
            return False
        self.pose = q
        return True

    def begin_stream(self) -> None:
        """Accept the next command as a stream's first one, whatever its stamp, at the present pose."""
        self.stamp, self._executing = 0, False

    def execute(self, stamp: int, q: tuple[float, ...]) -> bool:
        """Execute a command; return whether it was: newer than the last, and the first one at the pose that is held."""
        if self.pose is None or stamp <= self.stamp or self._mirror is not None:
            return False
        if not self._executing and outside_tolerance(q, self.pose, self._tolerance) is not None:
            return False
        self.pose, self.stamp, self._executing = q, stamp, True
        return True


class TwinClock:
    """Chooses the stamps of the twin's poses: those of its commands, without commands the clock's.

    Stamps increase: one that is older than what was published is not published. After a restart they may go on on an earlier clock.
    """

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Reset: the clock may be another."""
        self._published = 0
        self._last_command: int | None = None

    def is_set_back(self, stamp: int, last: int, now: int) -> bool:
        """Return whether a command received at `now` begins a stream on a clock that was set back; `last`: stamp before [ns]."""
        if self._last_command is None:
            return stamp < self._published - ANOTHER_CLOCK
        return now - self._last_command >= SILENCE and stamp < last - ANOTHER_CLOCK

    def on_command(self, stamp: int, now: int) -> bool:
        """Store stamp and reception of an executed command [ns]; return whether to publish its pose with its stamp."""
        self._last_command = now
        return self._is_newer(stamp)

    def on_cycle(self, now: int) -> bool:
        """Return whether to publish the held pose with the stamp `now` [ns]: no command came yet, or the stream fell silent."""
        return (self._last_command is None or now - self._last_command >= SILENCE) and self._is_newer(now)

    def idle(self, now: int) -> int:
        """Return the time until `on_cycle` may publish [ns], at most `SILENCE`; `restart` ends it early."""
        return 0 if self._last_command is None else min(max(self._last_command + SILENCE - now, 0), SILENCE)

    def _is_newer(self, stamp: int) -> bool:
        if stamp <= self._published:
            return False
        self._published = stamp
        return True
