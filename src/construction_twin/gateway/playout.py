"""Playout: from stamped commands with jitter to one target per controller cycle.

Playout time runs on the command sender's clock and advances with stamps, never with packet arrival (docs/architecture.md, law 1).
It stays a delay behind the newest command. The delay is what the link's jitter asks for, within bounds, and is changed by whole
cycles of 4 ms: a stream on that grid is then played exactly on its stamps, except while the delay is being changed. So it is by a
controller whose cycle is 12 ms, which plays every third of them.
Clock drift shows as a delay that grows or shrinks, and is corrected in the same way. Standard library only; stamps in ns, angles in
rad.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from construction_twin.core.interpolation import Pose, interpolate
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.arrivals import Arrivals
from construction_twin.gateway.speed_governor import Governor, TargetChanges


@dataclass(frozen=True)
class SlewLimit:
    """How fast playout time may be moved.

    Played at a rate 1 + r, a motion's velocity is multiplied by 1 + r and its acceleration by (1 + r)^2, and a change of r adds
    velocity times dr/dt. How much of that the motion leaves room for in a cycle is `TargetChanges`' to say.

    Attributes:
        back, ahead: Largest shift per cycle [ns], backwards and forwards.
        change: Largest change of that shift from one cycle to the next [ns].
    """

    back: int
    ahead: int
    change: int

    @classmethod
    def of(cls, back: float, ahead: float, slope: float) -> SlewLimit:
        """Return the limit of these rates and of their largest change, `slope` [1/s]."""
        return cls(round(back * CYCLE_NS), round(ahead * CYCLE_NS), round(slope * CYCLE_NS * CYCLE_NS / 1_000_000_000))

    def of_cycle(self, cycle_ns: int) -> SlewLimit:
        """Return the same rates per cycle of another length [ns]; this one's are per cycle of 4 ms."""
        times = cycle_ns / CYCLE_NS
        return SlewLimit(round(self.back * times), round(self.ahead * times), round(self.change * times * times))


#: For clock drift, and to shrink a delay: 0.5 %, changing by 0.005 per second. At 2 rad/s that adds 0.01 rad/s^2; it takes 1.8 s
#: to move a cycle.
CALM = SlewLimit.of(0.005, 0.005, 0.005)
#: For a delay that has become too short: 5 %, changing by 0.1 per second. At 2 rad/s that adds 0.2 rad/s^2, 8 % of what axis 1 may,
#: so it changes more slowly where the motion itself brakes at its limit. It takes 1.1 s to gain 30 ms.
URGENT = SlewLimit.of(0.05, 0.005, 0.1)

#: To make up for what a speed limit has put off: 0.8 %, changing by 0.1 per second. A motion at 0.992 of its velocity and 0.98 of
#: its acceleration limits keeps inside them.
CATCH_UP = SlewLimit.of(0.05, 0.008, 0.1)


class Slew:
    """Carries a shift out, cycle by cycle, beginning and ending at rate zero; limits are per cycle."""

    def __init__(self, cycle_ns: int = CYCLE_NS) -> None:
        self._cycle = cycle_ns
        self.clear()

    def clear(self) -> None:
        """Stand still, with nothing left to do."""
        #: What remains to be shifted [ns].
        self.remaining = 0
        #: The shift of the last cycle [ns].
        self.shift = 0

    @property
    def moving(self) -> bool:
        """True while something is shifted."""
        return bool(self.remaining or self.shift)

    @property
    def rate(self) -> float:
        """Present deviation of playout time's rate from 1."""
        return self.shift / self._cycle

    def step(self, limit: SlewLimit) -> int:
        """Return the shift of this cycle [ns], at most `limit` allows; the sum of all is exactly what was asked for."""
        distance = abs(self.remaining)
        # the largest shift after which slowing down still ends in time
        cycles = (math.isqrt(1 + 8 * distance // limit.change) - 1) // 2
        wanted = (distance + limit.change * cycles * (cycles + 1) // 2) // (cycles + 1)
        wanted = min(wanted, limit.ahead) if self.remaining > 0 else -min(wanted, limit.back)
        shift = min(max(wanted, self.shift - limit.change), self.shift + limit.change)
        self.remaining -= shift
        self.shift = shift
        return shift

    def replace(self, shift: int) -> None:
        """Carry out another shift [ns] in place of the last step's; what it leaves remains."""
        self.remaining += self.shift - shift
        self.shift = shift


#: Part of the delay that is not for jitter: the newest command is up to 4 ms old when a telegram finds it, and the cubic needs the
#: command after the one it leads to.
MARGIN = 3 * CYCLE_NS
#: The delay may be this much longer than wanted before it is shortened, so that it does not follow every change of the jitter.
SLACK_CYCLES = 2


@dataclass(frozen=True)
class PlayoutBounds:
    """Delays of the playout [ns].

    Attributes:
        start: At the beginning of the first stream, and at least this for 20 s. The delay is always this plus or minus whole
            cycles.
        shortest, longest: Bounds, ``shortest <= start <= longest``.
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

    Args:
        governor: Slows playout time while a speed limit asks for it; None: nothing can.
        cycle_ns: The controller's cycle [ns]. Commands come every 4 ms whatever it is, and what depends on them counts in 4 ms: the
            margin, and the delay's grid.
    """

    def __init__(self, bounds: PlayoutBounds, governor: Governor | None = None, cycle_ns: int = CYCLE_NS):
        self.bounds = bounds
        self._governor = governor
        self._governed = False
        # stamp and pose; plain tuples, and no records: they are made and unpacked in every cycle of 4 ms
        self._commands: deque[tuple[int, Pose]] = deque()
        # the last one that was played
        self._before: tuple[int, Pose] | None = None
        self._arrivals = Arrivals(max(0, bounds.start - MARGIN))
        self._cycle_ns = cycle_ns
        self._slew = Slew(cycle_ns)
        self._calm, self._urgent, self._catch_up = [limit.of_cycle(cycle_ns) for limit in (CALM, URGENT, CATCH_UP)]
        self.clear()

    def clear(self) -> None:
        """Forget the stream; the next command starts another. What was learned about the link stays."""
        self._arrivals.remember()
        self._arrivals.restart()
        self._slew.clear()
        self._slew_limit = self._calm
        self._commands.clear()
        self._before = None
        self._newest = 0
        self._now = 0
        # playout time before the last advance: that one is taken back when the reply it was for does not arrive
        self._advanced_from = 0
        self._clock = 0
        self._resting = 0
        self._put_off = 0
        if self._governor is not None:
            self._governor.restart()
            self._governor.changes.clear()
            self._governed = self._governor.active
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
    def overdue(self) -> int:
        """How far playout time would have run past the newest command [ns] if no speed limit had slowed it; not below 0.

        A sender that falls silent is noticed no later because the arm trails it.
        """
        return max(0, self._now + self._put_off - self._newest)

    @property
    def backlog(self) -> int:
        """How much motion, in the sender's time, a speed limit or a standstill has put off [ns]; rest to come does not count."""
        commands = self._commands
        if not self._put_off or not commands:
            return 0
        moving, last = 0, commands[0]
        for command in commands:
            if command[1] != last[1]:
                moving += command[0] - max(last[0], self._now)
            last = command
        return min(self._put_off, max(0, moving))

    def limit(self, fraction: float) -> None:
        """Allow every joint this fraction of its velocity limit, 0 to 1; the path stays the same."""
        if self._governor is not None:
            self._governor.limit(fraction)
            self._governed = self._governor.active

    @property
    def shortfall(self) -> int:
        """How late the next command already is against the quickest ones [ns]."""
        return self._arrivals.high - (self._newest - self._clock)

    def lead(self, stamp: int) -> int:
        """Return how far `stamp` [ns] lies ahead of playout time [ns], without what a speed limit has put off."""
        return stamp - self._now - self._put_off

    def push(self, stamp: int, q: Pose, waited: int = 0) -> bool:
        """Append a command that is newer than all before, `waited` after the last telegram [ns].

        Returns:
            False when its moment has passed: it will not be played, only help to interpolate.
        """
        commands = self._commands
        if not commands:
            # the next telegram adds all of its cycle, of which so much was over; in whole steps of the grid
            self._now = self._advanced_from = stamp - self.delay - waited // CYCLE_NS * CYCLE_NS
            self._newest = stamp
        self._resting = self._resting + 1 if commands and commands[-1][1] == q else 0
        if self._put_off and self._resting > 3 and len(commands) > 3:
            # of a delayed rest only the first and last command are kept: a limit of 0 may hold for hours
            self._resting -= 1
            commands[-2] = commands[-1]
            commands[-1] = stamp, q
        else:
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

        Args:
            elapsed: Controller time since the last call, from its stamps [ns].

        Returns:
            stamp: Stamp of the target on the sender's clock [ns], between the oldest and the newest command held.
            q: Shape (n,). Target [rad].
        """
        commands = self._commands
        while len(commands) > 1 and commands[1][0] <= self._now:
            self._before = commands.popleft()
        if self._put_off:
            self._skip_rest()
        before = self._advanced_from = self._now
        self._now += elapsed
        self._clock += elapsed
        if self._arrivals.note_telegram(self._newest - self._clock, self._clock):
            self._choose_delay()
        governor = self._governor
        if governor is not None and elapsed != self._cycle_ns:
            # what comes after missed telegrams cannot be compared with what was before them
            governor.changes.clear()
        steady = self._slew.shift
        if self._slew.moving:
            self._move()
        if self._governed and governor is not None:
            self._hold_back(governor, before, elapsed)
        # what the governor held back it has brought into the limits itself
        if governor is not None and self._slew.shift != steady and self._now == before + elapsed + self._slew.shift:
            self._keep_room(governor.changes, steady)
        stamp, target = self._at(self._now)
        if governor is not None:
            governor.changes.note(target)
        return stamp, target

    def report(self) -> dict:
        """Return what the playout does, for the status: ms, ppm, and the rate's deviation in percent."""
        drift = self._arrivals.drift_ppm()
        return {
            "delay_ms": self.delay / 1e6,
            "jitter_ms": self._arrivals.observed / 1e6,
            "lead_ms": (self._newest - self._now) / 1e6,
            "to_move_ms": self._slew.remaining / 1e6,
            "put_off_ms": self._put_off / 1e6,
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
        # the newest command is up to 4 ms old when a telegram finds it
        at_end = arrivals.high + CYCLE_NS + self._clock - self._now - slew.remaining
        wanted = self.bounds.delay(arrivals.jitter)
        cycles = round((at_end - wanted) / CYCLE_NS)
        if cycles < 0 or cycles >= (1 if self._rests else SLACK_CYCLES):
            if not slew.moving or cycles <= -SLACK_CYCLES:
                # a move that has begun is not slowed down to another limit: it would overshoot
                self._slew_limit = self._urgent if cycles <= -SLACK_CYCLES else self._calm
            slew.remaining += cycles * CYCLE_NS
            at_end -= cycles * CYCLE_NS
        self.delay = at_end

    def _move(self) -> None:
        if self._rests:
            # at rest every stamp has the same pose: playout time can be set at once
            self._now += self._slew.remaining
            self._slew.clear()
        else:
            self._now += self._slew.step(self._slew_limit)
        if self._put_off:
            self._put_off = max(0, min(self._put_off, self._slew.remaining))

    def _keep_room(self, changes: TargetChanges, steady: int) -> None:
        """Let the rate of playout time change only as far as the motion itself leaves room for; `steady` is the last shift [ns]."""
        unmoved, wanted = self._now - self._slew.shift, self._slew.shift
        shift = changes.fit(wanted, steady, lambda moved: self._target(unmoved + moved))
        if shift != wanted:
            self._slew.replace(shift)
            self._now = unmoved + shift

    def _hold_back(self, governor: Governor, before: int, elapsed: int) -> None:
        """Take back what of a cycle's advance the speed limit does not allow; it is made up for as a delay that is too long."""
        commands = self._commands
        if before < commands[0][0] or self._rests:
            governor.restart()
        else:
            wanted = self._now - before
            advance = governor.advance(commands, wanted, elapsed, lambda step: self._target(before + step))
            if advance < wanted:
                self._now = before + advance
                self._slew.remaining += wanted - advance
                self._put_off += wanted - advance
                self._slew_limit = self._catch_up
        self._governed = governor.active

    def stand(self, pause: int, taken_back: bool) -> None:
        """Begin anew from a standstill: the arm was not told to move on.

        What is not played now is put off, and the motion starts again on its path, with a rate that rises from 0.

        Args:
            pause: Controller time that the arm has stood for [ns].
            taken_back: True: the last target was not reached either, because it did not arrive.
        """
        put_off = pause
        if taken_back:
            put_off += self._now - self._advanced_from
            self._now = self._advanced_from
        self._clock += pause
        self._slew.remaining += put_off
        self._put_off += put_off
        self._slew_limit = self._catch_up
        if self._governor is not None:
            self._governor.stand()
            self._governed = True

    def _target(self, stamp: int) -> Pose:
        """Return the pose at a stamp [ns] not far ahead of playout time, without moving on."""
        return self._at(stamp)[1]

    def _at(self, stamp: int) -> tuple[int, Pose]:
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
        while self._put_off and len(commands) > 2 and self._before is not None and self._now >= commands[0][0]:
            if not self._before[1] == commands[0][1] == commands[1][1] == commands[2][1]:
                return
            hop = min(self._put_off, commands[1][0] - self._now)
            self._now += hop
            self._put_off -= hop
            self._slew.remaining -= hop
            if self._now < commands[1][0]:
                return
            self._before = commands.popleft()
