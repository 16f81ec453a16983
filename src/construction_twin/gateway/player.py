"""From buffered commands to positions: playout and follower of one gateway. Standard library only; rad and ns."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from construction_twin.core.follower import Follower
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.playout import Playout, PlayoutBounds
from construction_twin.gateway.playout_rate import PlayoutRate
from construction_twin.gateway.stop_report import Braking


@dataclass(frozen=True, slots=True)
class _Stall:
    """A stream that was given up: whose, how late its next command was then [ns], and when [ns]."""

    session: str
    shortfall: int
    since: int


class Player:
    """Plays a command stream, and brakes where it has run dry."""

    def __init__(self, config: GatewayConfig, counters: Counter[str]):
        self._config = config
        self._counters = counters
        rate = PlayoutRate(config.limits, config.decimals, config.cycle_ns)
        self._playout = Playout(PlayoutBounds.of(config), rate)
        self._longest_hole = round(config.silence * NANOSECONDS)
        self._stalled: _Stall | None = None
        #: Fraction of the velocity limits at which the arm may move.
        self.fraction = 1.0
        #: Stands at the position last sent; None without an origin.
        self.follower: Follower | None = None
        #: Stamp of the target last played [ns]; 0 for none.
        self.stamp = 0
        self._stamp_before = 0
        #: How many times the arm has stood for want of replies since it trailed its stream by nothing.
        self.stood = 0
        #: Braking since the stream ran dry; None while it has not.
        self.braking: Braking | None = None

    @property
    def overdue(self) -> int:
        """How long the next command is overdue [ns]; 0 while there is one. A speed limit does not make it later."""
        return self._playout.overdue

    @property
    def backlog(self) -> float:
        """How much motion a speed limit, or replies that did not arrive, have put off [s], in the sender's time."""
        return self._playout.backlog / NANOSECONDS

    def limit(self, fraction: float) -> None:
        """Play so slowly that every joint keeps to this fraction of its velocity limit, 0 to 1."""
        self.fraction = fraction
        self._playout.rate.limit(fraction)
        if self.follower is not None:
            self.follower.limit(fraction)

    def place(self, position: tuple[float, ...]) -> Follower:
        """Stand at `position` [rad], at rest; return the follower there."""
        config = self._config
        self.follower = Follower(config.limits, config.decimals, position, config.period)
        self.follower.limit(self.fraction)
        return self.follower

    def remove(self) -> None:
        """Stand nowhere: there is no origin."""
        self.follower = None

    def clear(self) -> None:
        """Forget the stream; what was learned about the link stays."""
        self._playout.clear()
        self.stamp = self._stamp_before = self.stood = 0
        self.braking = None

    def lead(self, stamp: int) -> float:
        """Return how far `stamp` [ns] lies ahead of playout time [s]."""
        return self._playout.lead(stamp) / NANOSECONDS

    def hole(self, stamp: int) -> float:
        """Return how much of the stream is missing before `stamp` [ns], if that is too much to bridge; else 0 [s].

        How much that is does not depend on the delay: a playout that has run dry meanwhile knows no more of what is missing.
        """
        hole = stamp - self._playout.newest
        return hole / NANOSECONDS if hole > self._longest_hole else 0.0

    def push(self, stamp: int, q: tuple[float, ...], waited: int) -> None:
        """Take a command that passed every check: stamp [ns], pose [rad], time since the last telegram [ns]."""
        if not self._playout.push(stamp, q, waited):
            self._counters["commands_late"] += 1

    def play(self, follower: Follower, elapsed: int, measured: tuple[float, ...]) -> tuple[float, ...]:
        """Move `follower`, the present one, on by `elapsed` [ns] and return the position to send [rad].

        `measured` is where the arm is [rad]; () when it is not known.
        """
        self._stamp_before = self.stamp
        self.stamp, target = self._playout.advance(elapsed)
        if self._playout.silence:
            # the rest of the motion is unknown
            self._counters["cycles_without_command"] += 1
            return self._brake(follower, elapsed, measured)
        self.braking = None
        position = follower.follow(target)
        if follower.settling:
            self._counters["settling"] += 1
        return position

    def stand(self, pause: int, taken_back: bool) -> None:
        """Go on from where HOLDON keeps the arm, while a stream is followed, after a pause without a reply; see `Playout.stand`."""
        self._playout.stand(pause, taken_back)
        if taken_back:
            self.stamp = self._stamp_before
        self.stood = self.stood + 1 if self._playout.backlog else 0

    def _brake(self, follower: Follower, elapsed: int, measured: tuple[float, ...]) -> tuple[float, ...]:
        if self.braking is None:
            self.braking = Braking(follower, measured)
        if not follower.at_rest:
            self.braking.elapsed += elapsed
        return follower.brake()

    def give_up(self, session: str, now: int) -> None:
        """Note that the stream of `session` is given up because of its silence; call it before `clear`."""
        self._stalled = _Stall(session, self._playout.shortfall, now)

    def learn_from_stall(self, session: str | None, now: int) -> None:
        """Take note of a command that comes after its stream was given up: the stream did not end, it was held up.

        The next stream begins with a delay that absorbs this, as far as the bounds allow. `session`: None where commands have none.
        """
        stall = self._stalled
        if stall is None or session not in (None, stall.session):
            return
        self._playout.learn(stall.shortfall + now - stall.since)
        self._stalled = None

    def report(self) -> dict:
        """Return what `status` says about the playout."""
        return self._playout.report()
