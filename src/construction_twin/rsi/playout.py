"""Playout: from stamped commands that arrive when they arrive to one target per controller cycle.

Playout time runs on the command sender's clock and advances with IPOC, never with packet arrival (design, law 1). A small
fixed delay behind the newest command absorbs the network's jitter. Standard library only; stamps in ns, angles in rad.
"""

from __future__ import annotations

from collections import deque

from construction_twin.units import CYCLE_NS

#: Cycles over which the distance to the newest command is observed before playout time is re-aligned (0.5 s).
REALIGN_WINDOW = 125


def interpolate(
    stamp: int, stamp0: int, q0: tuple[float, ...], stamp1: int, q1: tuple[float, ...]
) -> tuple[float, ...]:
    """Interpolate linearly between two stamped poses; the evaluation uses the same arithmetic.

    Parameters
    ----------
    stamp, stamp0, stamp1 : int
        [ns], ``stamp0 < stamp1``.
    q0, q1 : tuple, shape (n,)
        Joint angles [rad].

    Returns
    -------
    q : tuple, shape (n,)
        Joint angles at `stamp` [rad].
    """
    share = (stamp - stamp0) / (stamp1 - stamp0)
    return tuple([a + (b - a) * share for a, b in zip(q0, q1)])


class Playout:
    """Buffer of commands, played `delay` behind the newest.

    Clock drift between the two PCs is taken out only while the stream stands still, where moving playout time moves nothing.

    Parameters
    ----------
    delay : int
        Distance to the newest command at which playout starts [ns].
    """

    def __init__(self, delay: int):
        self.delay = delay
        self._commands: deque[tuple[int, tuple[float, ...]]] = deque()
        self.clear()

    def clear(self) -> None:
        """Forget everything; the next command starts a stream."""
        self._commands.clear()
        self._now = 0
        self._resting = 0
        self._window_cycles = 0
        self._window_lead = 0

    @property
    def newest(self) -> int:
        """Stamp of the newest command [ns]; 0 when there is none."""
        return self._commands[-1][0] if self._commands else 0

    @property
    def silence(self) -> int:
        """How far playout time has run past the newest command [ns]; 0 while commands are ahead of it."""
        return max(0, self._now - self.newest)

    def lead(self, stamp: int) -> int:
        """Return how far `stamp` [ns] lies ahead of playout time [ns]."""
        return stamp - self._now

    def push(self, stamp: int, q: tuple[float, ...]) -> None:
        """Append a command that is newer than all before."""
        if not self._commands:
            self._now = stamp - self.delay
        self._resting = self._resting + 1 if self._commands and self._commands[-1][1] == q else 0
        self._commands.append((stamp, q))

    def advance(self, elapsed: int) -> tuple[int, tuple[float, ...]]:
        """Move playout time on and return the target there.

        Before the first command's stamp the target is the first command, past the newest it is the newest.

        Parameters
        ----------
        elapsed : int
            Controller time since the last call, from IPOC [ns].

        Returns
        -------
        stamp : int
            Stamp of the target on the sender's clock [ns], between the oldest and the newest command held.
        q : tuple, shape (n,)
            Target [rad].
        """
        self._now += elapsed
        self._realign_at_rest()
        commands = self._commands
        while len(commands) > 1 and commands[1][0] <= self._now:
            commands.popleft()
        stamp0, q0 = commands[0]
        if self._now <= stamp0 or len(commands) == 1:
            return stamp0, q0
        stamp1, q1 = commands[1]
        return self._now, interpolate(self._now, stamp0, q0, stamp1, q1)

    def _realign_at_rest(self) -> None:
        self._window_lead = max(self._window_lead, self.newest - self._now)
        self._window_cycles += 1
        if self._window_cycles < REALIGN_WINDOW:
            return
        # the largest lead in the window is the one with the least network delay in it
        offset = self._window_lead - self.delay
        self._window_cycles, self._window_lead = 0, 0
        # everything still to be played must stand still too, not only the newest
        if abs(offset) > CYCLE_NS // 2 and self._resting > max(REALIGN_WINDOW, len(self._commands)):
            self._now += offset
