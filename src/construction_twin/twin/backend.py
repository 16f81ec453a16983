"""What makes a simulated pose of the commanded one: the small interface between the twin's node and what simulates.

Pure; angles in rad, prismatic joints in m, one call per cycle. What is commanded stays with `VirtualRobot`: a backend says where an
arm would be, never where it is to go.
"""

from __future__ import annotations

from typing import Protocol


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
