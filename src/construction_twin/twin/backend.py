"""What makes a simulated pose of the commanded one: the small interface between the twin's node and what simulates.

Pure; angles in rad, prismatic joints in m, one call per cycle. What is commanded stays with `VirtualRobot`: a backend says where an
arm would be, never where it is to go.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE_NS, NANOSECONDS

#: Commands without an answer that are remembered: one second.
_REMEMBERED = NANOSECONDS // CYCLE_NS
#: More commands without an answer than this are a problem: 0.1 s, after which the gate misses the twin's pose.
_LATE = 25


class GazeboTwin:
    """A `twin.backend.TwinBackend` whose poses come later, through `answer`; efforts and contacts stay with Gazebo."""

    effort: tuple[float, ...] = ()
    contacts: tuple[tuple[str, str], ...] = ()

    def __init__(self) -> None:
        self._open: deque[int] = deque(maxlen=_REMEMBERED)

    @property
    def problem(self) -> str:
        """One sentence when Gazebo is silent or late; empty: it answers."""
        waiting = len(self._open)
        if waiting == _REMEMBERED:
            return Sentence("physics.gazebo.silent")
        return Sentence("physics.gazebo.late", late=waiting * CYCLE_NS // 1_000_000) if waiting > _LATE else ""

    def restart(self) -> None:
        """Forget nothing: the plugin puts the arm where the first command is that is away from the one before."""

    def cycle(self, commanded: tuple[float, ...]) -> None:
        """Return None: the pose is told when Gazebo has simulated the cycle."""

    def told(self, stamp: int) -> None:
        """Remember a command that was published."""
        self._open.append(stamp)

    def answer(self, stamp: int) -> bool:
        """Take the stamp of a simulated pose; return whether it is that of a command that was not answered yet.

        Gazebo may skip commands: those before it are not answered any more.
        """
        if stamp not in self._open:
            return False
        while self._open.popleft() != stamp:
            continue
        return True


class TwinBackend(Protocol):
    """An arm that is told where to be, once per cycle of 4 ms.

    Attributes:
        effort: Length n. What the axes give [N m], [N]; empty: that is not simulated.
        contacts: What touches and, by the planner, should not: pairs of names.
    """

    effort: tuple[float, ...]
    contacts: tuple[tuple[str, str], ...]

    @property
    def problem(self) -> str:
        """One sentence about what is simulated otherwise than it should be; empty: nothing is."""
        ...

    def restart(self) -> None:
        """Forget where the arm is: the next cycle begins at rest, at the pose that is commanded then."""

    def cycle(self, commanded: tuple[float, ...]) -> tuple[float, ...] | None:
        """Advance one cycle towards the commanded pose; return the simulated one at its end, both of shape (n,).

        None: another program simulates, and answers later.
        """
        ...


class KinematicBackend:
    """An arm without mass: it is where it was told to be."""

    effort: tuple[float, ...] = ()
    contacts: tuple[tuple[str, str], ...] = ()
    problem = ""

    def restart(self) -> None:
        """Forget nothing: there is nothing to forget."""

    def cycle(self, commanded: tuple[float, ...]) -> tuple[float, ...]:
        """Return the commanded pose."""
        return commanded
