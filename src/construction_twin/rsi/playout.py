"""Playout: from stamped commands that arrive when they arrive to one target per controller cycle.

Playout time runs on the command sender's clock and advances with IPOC, never with packet arrival (design, law 1). It stays a delay
behind the newest command. The delay is what the link's jitter asks for, within bounds, and is changed by whole cycles: a cycle of a
stream on the 4 ms grid is then played exactly on a command's stamp, except while the delay is being changed. Clock drift shows as a
delay that grows or shrinks, and is taken out in the same way. Standard library only; stamps in ns, angles in rad.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.rsi.arrivals import Arrivals
from construction_twin.rsi.interpolation import Pose, interpolate
from construction_twin.rsi.slew import CALM, URGENT, Slew
from construction_twin.units import CYCLE_NS, NANOSECONDS

#: Part of the delay that is not for jitter: a command waits up to a cycle for its telegram, and the cubic needs the command after
#: the one it leads to.
MARGIN = 3 * CYCLE_NS
#: The delay may be this much longer than wanted before it is shortened, so that it does not follow every change of the jitter.
SLACK_CYCLES = 2


@dataclass(frozen=True)
class PlayoutBounds:
    """Delays of the playout [ns].

    Attributes
    ----------
    start : int
        At the beginning of the first stream, and at least this for 20 s. The delay is always this plus or minus whole cycles.
    shortest, longest : int
        Bounds, ``shortest <= start <= longest``.
    """

    start: int
    shortest: int
    longest: int

    @classmethod
    def of(cls, config) -> PlayoutBounds:
        """Return the delays of a `GatewayConfig`."""
        names = ("playout_delay", "playout_delay_min", "playout_delay_max")
        return cls(*(round(getattr(config, name) * NANOSECONDS) for name in names))

    def delay(self, jitter: int) -> int:
        """Return the delay that absorbs a jitter, within the bounds; both [ns]."""
        wanted = max(jitter + MARGIN, self.shortest)
        cycles = min(-((self.start - wanted) // CYCLE_NS), (self.longest - self.start) // CYCLE_NS)
        return self.start + cycles * CYCLE_NS


class Playout:
    """Buffer of commands, played a delay behind the newest.

    Parameters
    ----------
    bounds : PlayoutBounds
    """

    def __init__(self, bounds: PlayoutBounds):
        self.bounds = bounds
        self._commands: deque[tuple[int, Pose]] = deque()
        self._arrivals = Arrivals(max(0, bounds.start - MARGIN))
        self._slew = Slew()
        self.clear()

    def clear(self) -> None:
        """Forget the stream; the next command starts another. What was learned about the link stays."""
        self._arrivals.remember()
        self._arrivals.restart()
        self._slew.clear()
        self._pace = CALM
        self._commands.clear()
        self._before: tuple[int, Pose] | None = None
        self._newest = 0
        self._now = 0
        self._clock = 0
        self._resting = 0
        self.delay = self.bounds.delay(self._arrivals.learned)

    @property
    def newest(self) -> int:
        """Stamp of the newest command [ns]; 0 when there is none."""
        return self._newest

    @property
    def silence(self) -> int:
        """How far playout time has run past the newest command [ns]; 0 while commands are ahead of it."""
        return max(0, self._now - self._newest)

    @property
    def shortfall(self) -> int:
        """How late the next command already is against the quickest ones [ns]."""
        return self._arrivals.high - (self._newest - self._clock)

    def lead(self, stamp: int) -> int:
        """Return how far `stamp` [ns] lies ahead of playout time [ns]."""
        return stamp - self._now

    def push(self, stamp: int, q: Pose, waited: int = 0) -> bool:
        """Append a command that is newer than all before.

        Parameters
        ----------
        stamp : int
            [ns]
        q : tuple, shape (n,)
            [rad]
        waited : int, optional
            Time from the last telegram to this arrival [ns]; only the drift's estimate uses it.

        Returns
        -------
        in_time : bool
            False when its moment has passed: it will not be played, only help to interpolate.
        """
        commands = self._commands
        if not commands:
            self._now = stamp - self.delay
            self._newest = stamp
        self._resting = self._resting + 1 if commands and commands[-1][1] == q else 0
        commands.append((stamp, q))
        self._arrivals.note_command(self._newest - self._clock, stamp - self._clock - waited)
        self._newest = stamp
        return stamp > self._now

    def learn(self, jitter: int) -> None:
        """Take a jitter [ns] that no command of this stream shows: the next one begins with a delay that absorbs it.

        One beyond the longest delay is no jitter, but a cut: no delay would have helped.
        """
        if jitter > self.bounds.longest:
            return
        self._arrivals.learn(jitter)
        if not self._commands:
            self.delay = self.bounds.delay(self._arrivals.learned)

    def advance(self, elapsed: int) -> tuple[int, Pose]:
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
        self._clock += elapsed
        if self._arrivals.note_telegram(self._newest - self._clock, self._clock):
            self._choose_delay()
        if self._slew.moving:
            self._move()
        now, commands = self._now, self._commands
        while len(commands) > 1 and commands[1][0] <= now:
            self._before = commands.popleft()
        start = commands[0]
        if now <= start[0] or len(commands) == 1:
            return start
        return now, interpolate(now, start, commands[1], self._before, commands[2] if len(commands) > 2 else None)

    def report(self) -> dict:
        """Return what the playout does, for the status: ms, ppm, and the rate's deviation in percent."""
        drift = self._arrivals.drift_ppm()
        return {
            "delay_ms": self.delay / 1e6,
            "jitter_ms": self._arrivals.observed / 1e6,
            "lead_ms": (self._newest - self._now) / 1e6,
            "to_move_ms": self._slew.remaining / 1e6,
            "rate_percent": 100.0 * self._slew.rate,
            "drift_ppm": None if drift is None else round(drift, 1),
        }

    @property
    def _rests(self) -> bool:
        """True when all that is held, and what came before it, is one pose."""
        return self._resting > len(self._commands)

    def _choose_delay(self) -> None:
        """Set out for another delay behind the quickest commands when this one is too short, or much too long."""
        arrivals, slew = self._arrivals, self._slew
        # a command waits up to a cycle for the telegram at which it is first seen
        at_end = arrivals.high + CYCLE_NS + self._clock - self._now - slew.remaining
        wanted = self.bounds.delay(arrivals.jitter)
        cycles = round((at_end - wanted) / CYCLE_NS)
        if cycles < 0 or cycles >= (1 if self._rests else SLACK_CYCLES):
            if not slew.moving or cycles <= -SLACK_CYCLES:
                # a move that has begun is not slowed down to another pace: it would shoot past
                self._pace = URGENT if cycles <= -SLACK_CYCLES else CALM
            slew.remaining += cycles * CYCLE_NS
            at_end -= cycles * CYCLE_NS
        self.delay = at_end

    def _move(self) -> None:
        if self._rests:
            # moving the time of what stands still moves nothing
            self._now += self._slew.remaining
            self._slew.clear()
        else:
            self._now += self._slew.step(self._pace)
