"""Playout: from stamped commands with jitter to one target per controller cycle.

Everything lies on one axis, that of the sender's stamps:

        played                      held in the buffer                      still on their way
    ──o───────o───────o───────o───────o───────o───────o───────o───────o ─ ─ ─ o ─ ─ ─ o ─ ─ ─►  stamp
              │    ▲  │                                               │
        _before    │  _commands[0]                              newest: _commands[-1]
                  now ◄────────────────── delay ──────────────────────►
                   │
                   ├ now - elapsed: `_advanced_from`, whereto time goes back when the reply does not arrive
                   ├ now + put_off: where it would be without speed limit and standstills; lead and overdue count from there
                   └ now + remaining: where `PlayoutRate` is bringing it, a little each cycle

Playout time, now, advances with the controller's stamps, never with packet arrival (docs/architecture.md, law 1). It stays a delay
behind the newest command. The delay is what the link's jitter asks for, within bounds, and is changed by whole cycles of 4 ms: a
stream on that grid is then played exactly on its stamps, except while the delay is being changed. So it is by a controller whose
cycle is 12 ms, which plays every third of them. Clock drift shows as a delay that grows or shrinks, and is corrected in the same
way. stamps in ns, angles in rad.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.core.interpolation import Pose, interpolate
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.playout_rate import PlayoutRate

#: Length of the pieces whose extremes are kept [ns].
PIECE = NANOSECONDS
#: Pieces that count for the jitter: what is not seen again for 20 s is forgotten.
JITTER_PIECES = 20
_FAR = 1 << 63


class Arrivals:
    """Observes how far the newest command is ahead of the controller's clock, as every telegram finds it.

    Only changes of this difference of two clocks mean anything: at its largest a command travelled fastest, at its smallest one
    came late. The end of a stream is not lateness: the smallest counts only once a command follows.
    """

    def __init__(self, assumed: int) -> None:
        #: Jitter to assume for the window's length: that of the configuration, then that of the stream before.
        self.learned = assumed
        self.restart()

    def restart(self) -> None:
        """Begin with another stream; what was seen of the link counts for another window."""
        self._highs: deque[int] = deque(maxlen=JITTER_PIECES)
        self._lows: deque[int] = deque(maxlen=JITTER_PIECES)
        self._piece_ends = PIECE
        self._started = self._changed = False
        self.high = self.low = 0
        self._high = self._low = 0

    @property
    def jitter(self) -> int:
        """The jitter to expect."""
        return max(self.observed, self.learned)

    @property
    def observed(self) -> int:
        """Lateness of the window's latest command against its quickest."""
        return self.high - self.low

    def remember(self) -> None:
        """Keep the jitter for the next stream."""
        self.learned = self.jitter

    def learn(self, jitter: int) -> None:
        """Add a jitter observed elsewhere."""
        if jitter > self.learned:
            self.learned, self._changed = jitter, True

    def on_telegram(self, lead: int, clock: int) -> bool:
        """Observe the newest command's lead over the clock, 0 at the stream's first one [ns]; return whether extremes changed."""
        if not self._started:
            self._started = True
            self.high = self.low = self._high = self._low = lead
            return True
        if lead > self._high:
            self._high = lead
            if lead > self.high:
                self.high, self._changed = lead, True
        if clock >= self._piece_ends:
            self._close_piece(clock)
        changed, self._changed = self._changed, False
        return changed

    def on_command(self, lead: int) -> None:
        """Observe a command's arrival: how far what was there reached beyond the controller's clock at the last telegram [ns]."""
        if self._started and lead < self._low:
            self._low = lead
            if lead < self.low:
                self.low, self._changed = lead, True

    def _close_piece(self, clock: int) -> None:
        self._highs.append(self._high)
        self._lows.append(self._low)
        if len(self._highs) == JITTER_PIECES:
            self.learned = 0
        self._piece_ends = clock + PIECE
        self.high, self.low = max(self._highs), min(self._lows)
        # worse than anything: the next telegram and the next command set them
        self._high, self._low = -_FAR, _FAR
        self._changed = True


#: Part of the delay that is not for jitter: the newest command is up to 4 ms old, and the cubic needs the one behind its end.
MARGIN = 3 * CYCLE_NS
#: The delay may be this much longer than wanted before it is shortened, so that it does not follow every change of the jitter.
SLACK_CYCLES = 2


@dataclass(frozen=True)
class PlayoutBounds:
    """Delays of the playout: the first stream's, from which others differ by whole cycles, and its bounds."""

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
    """Buffer of commands, played a delay behind the newest."""

    def __init__(self, bounds: PlayoutBounds, rate: PlayoutRate):
        self.bounds = bounds
        self.rate = rate
        # stamp and pose; tuples are quicker than records, which counts in a cycle of 4 ms
        self._commands: deque[tuple[int, Pose]] = deque()
        self._before: tuple[int, Pose] | None = None
        self._arrivals = Arrivals(max(0, bounds.start - MARGIN))
        self.clear()

    def clear(self) -> None:
        """Clear the stream, and keep the learned jitter."""
        self._arrivals.remember()
        self._arrivals.restart()
        self.rate.clear()
        self._commands.clear()
        self._before = None
        #: Stamp of the newest command; 0 for none.
        self.newest = 0
        self._now = 0
        # playout time before the last advance: that one is taken back when the reply it was for does not arrive
        self._advanced_from = 0
        self._clock = 0
        self._resting = 0
        self.delay = self.bounds.delay(self._arrivals.learned)

    @property
    def silence(self) -> int:
        """How far playout time has run past the newest command."""
        return max(0, self._now - self.newest)

    @property
    def overdue(self) -> int:
        """How far playout time would have run past the newest command without a speed limit."""
        return max(0, self._now + self.rate.put_off - self.newest)

    @property
    def backlog(self) -> int:
        """Motion that a speed limit or a standstill has put off, in the sender's time; rest to come does not count."""
        commands = self._commands
        if not self.rate.put_off or not commands:
            return 0
        moving, last = 0, commands[0]
        for command in commands:
            if command[1] != last[1]:
                moving += command[0] - max(last[0], self._now)
            last = command
        return min(self.rate.put_off, max(0, moving))

    @property
    def shortfall(self) -> int:
        """Lateness of the next command against the quickest ones."""
        return self._arrivals.high - (self.newest - self._clock)

    def lead_time(self, stamp: int) -> int:
        """Return how far a stamp lies ahead of playout time, without what a speed limit has put off."""
        return stamp - self._now - self.rate.put_off

    def push(self, stamp: int, q: Pose, waited: int = 0) -> bool:
        """Append a command, `waited` after the last telegram [ns]; return False when its moment has passed."""
        commands = self._commands
        if not commands:
            # the next telegram adds all of its cycle, of which so much was over; in whole steps of the grid
            self._now = self._advanced_from = stamp - self.delay - waited // CYCLE_NS * CYCLE_NS
            self.newest = stamp
        self._resting = self._resting + 1 if commands and commands[-1][1] == q else 0
        if self.rate.put_off and self._resting > 3 and len(commands) > 3:
            # of a delayed rest only the first and last command are kept: a limit of 0 may hold for hours
            self._resting -= 1
            commands[-2] = commands[-1]
            commands[-1] = stamp, q
        else:
            commands.append((stamp, q))
        self._arrivals.on_command(self.newest - self._clock)
        self.newest = stamp
        return stamp > self._now

    def learn(self, jitter: int) -> None:
        """Add a jitter from before this stream; one beyond the longest delay is a cut."""
        if jitter > self.bounds.longest:
            return
        self._arrivals.learn(jitter)
        if not self._commands:
            self.delay = self.bounds.delay(self._arrivals.learned)

    def advance(self, elapsed: int) -> tuple[int, Pose]:
        """Move playout time on; return the target there with its stamp: the first command before its own, the newest behind."""
        commands, rate = self._commands, self.rate
        while len(commands) > 1 and commands[1][0] <= self._now:
            self._before = commands.popleft()
        if rate.put_off:
            self._skip_rest()
        before = self._advanced_from = self._now
        self._clock += elapsed
        if self._arrivals.on_telegram(self.newest - self._clock, self._clock):
            self._choose_delay(before + elapsed)
        if rate.steady and elapsed == rate.cycle_ns:
            self._now += elapsed
        else:
            self._now += rate.advance(elapsed, commands, before >= commands[0][0], self._is_at_rest, self._pose_ahead)
        stamp, target = self._pose_at(self._now)
        rate.record_target(target)
        return stamp, target

    def status_fields(self) -> dict:
        """Return the fields of the status: ms, and the rate's deviation in percent."""
        return {
            "delay_ms": self.delay / 1e6,
            "jitter_ms": self._arrivals.observed / 1e6,
            "lead_ms": (self.newest - self._now) / 1e6,
            "to_move_ms": self.rate.remaining / 1e6,
            "put_off_ms": self.rate.put_off / 1e6,
            "rate_percent": 100.0 * (self.rate.shift / self.rate.cycle_ns),
        }

    @property
    def _is_at_rest(self) -> bool:
        """True when all commands held, and the one before them, are one pose."""
        return self._resting > len(self._commands)

    def _choose_delay(self, now: int) -> None:
        """Begin to move to another delay when this one is too short, or much too long."""
        # the newest command is up to 4 ms old when a telegram finds it
        at_end = self._arrivals.high + CYCLE_NS + self._clock - now - self.rate.remaining
        wanted = self.bounds.delay(self._arrivals.jitter)
        cycles = round((at_end - wanted) / CYCLE_NS)
        if cycles < 0 or cycles >= (1 if self._is_at_rest else SLACK_CYCLES):
            self.rate.move(cycles * CYCLE_NS, urgent=cycles <= -SLACK_CYCLES)
            at_end -= cycles * CYCLE_NS
        self.delay = at_end

    def restart_from_rest(self, pause: int, taken_back: bool) -> None:
        """Begin anew after a standstill of `pause` [ns]; `taken_back`: the last target did not arrive."""
        put_off = pause
        if taken_back:
            put_off += self._now - self._advanced_from
            self._now = self._advanced_from
        self._clock += pause
        self.rate.restart_from_rest(put_off)

    def _pose_ahead(self, advance: int) -> Pose:
        """Return the pose at an advance [ns] of the present cycle, without moving on."""
        return self._pose_at(self._advanced_from + advance)[1]

    def _pose_at(self, stamp: int) -> tuple[int, Pose]:
        """Return stamp and pose at a stamp [ns] not far ahead of the oldest command, between the oldest and the newest one."""
        commands, before = self._commands, self._before
        index = 0
        while index + 1 < len(commands) and commands[index + 1][0] <= stamp:
            before = commands[index]
            index += 1
        start = commands[index]
        if stamp <= start[0] or index + 1 == len(commands):
            return start
        after = commands[index + 2] if index + 2 < len(commands) else None
        return stamp, interpolate(stamp, start, commands[index + 1], before, after)

    def _skip_rest(self) -> None:
        """Skip a rest that has been put off: while every stamp has the same pose, playout time can be set without a motion."""
        commands = self._commands
        while self.rate.put_off and len(commands) > 2 and self._before is not None and self._now >= commands[0][0]:
            if not self._before[1] == commands[0][1] == commands[1][1] == commands[2][1]:
                return
            hop = min(self.rate.put_off, commands[1][0] - self._now)
            self._now += hop
            self.rate.skip(hop)
            if self._now < commands[1][0]:
                return
            self._before = commands.popleft()
