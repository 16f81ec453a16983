"""From buffered commands to positions: playout and follower of one gateway, and its braking. rad, m, ns."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

from construction_twin.core.follower import Follower
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.playout import Playout, PlayoutBounds
from construction_twin.gateway.playout_rate import PlayoutRate


class Braking:
    """Braking of a follower from its present step on, as the arm will carry it out.

    Args:
        measured: Shape (n,). Pose of the arm, whose servos lag [rad], [m]; empty where it does not follow.

    Attributes:
        distance: Shape (n,). From that pose to rest [rad], [m].
        time: Until the corrections rest [s].
        moved, took: Distance and time [s] as they were in the end; () and None until then.
    """

    def __init__(self, follower: Follower, measured: tuple[float, ...]):
        distances, cycles = follower.braking()
        self._start = measured or follower.position
        self.distance = tuple(
            [distance + abs(q - at) for distance, q, at in zip(distances, follower.position, self._start)]
        )
        self.time = cycles * follower.cycle
        self._elapsed = 0
        self.moved: tuple[float, ...] = ()
        self.took: float | None = None

    def advance(self, follower: Follower, elapsed: int) -> None:
        """Record a step that took `elapsed` [ns] of the controller's time."""
        if self.took is None:
            self._elapsed += elapsed
            if follower.at_rest:
                self.moved = tuple([abs(end - start) for start, end in zip(self._start, follower.position)])
                self.took = self._elapsed / NANOSECONDS


class StopReport:
    """The last stop of one gateway."""

    def __init__(self, linear: tuple[bool, ...]):
        self._linear = linear
        # a cause of `states.CAUSES`; the account whose stop it was, if one's
        self._cause = self._by = ""
        self._braking: Braking | None = None

    def begin(
        self, cause: str, follower: Follower, measured: tuple[float, ...], under_way: Braking | None, by: str
    ) -> None:
        """State the distance to rest; call it when braking begins, or with the braking that was `under_way` before."""
        self._cause, self._by, self._braking = cause, by, under_way or Braking(follower, measured)

    def advance(self, follower: Follower, elapsed: int) -> None:
        """Record a step of braking that took `elapsed` [ns] of the controller's time."""
        if self._braking is not None:
            self._braking.advance(follower, elapsed)

    def status_fields(self) -> dict:
        """Return what the status says: deg, mm for linear axes, and s."""
        braking = self._braking
        return {
            "cause": self._cause,
            "by": self._by,
            "distance_deg": self._in_display_units(braking.distance) if braking else [],
            "time_s": braking.time if braking else 0.0,
            "moved_deg": self._in_display_units(braking.moved) if braking else [],
            "took_s": braking.took if braking else None,
        }

    def _in_display_units(self, distances: tuple[float, ...]) -> list[float]:
        # rounded up: the arm never goes further than stated
        return [
            math.ceil(1e6 * (1e3 * distance if linear else math.degrees(distance))) / 1e6
            for distance, linear in zip(distances, self._linear)
        ]


class SubCycleInterpolator:
    """Spreads the steps of whole cycles over the telegrams within them.

    A shorter cycle of the controller is noticed after some telegrams only: a whole step in each would be several times the speed.
    """

    def __init__(self, cycle_ns: int):
        self._cycle = cycle_ns
        #: Controller time interpolated in the present step [ns]; 0: all of it.
        self.interpolated = 0
        self._before: tuple[float, ...] = ()

    def restart(self) -> None:
        """Begin with a whole step."""
        self.interpolated = 0

    def position(
        self, elapsed: int, now: tuple[float, ...], step: Callable[[], tuple[float, ...]]
    ) -> tuple[float, ...]:
        """Return where to be after `elapsed` more time [ns]; the present step ends at `now`, `step` takes the next one."""
        begun = self.interpolated > 0
        self.interpolated += elapsed
        if not begun:
            self._before, now = now, step()
        while self.interpolated > self._cycle:
            self._before, now = now, step()
            self.interpolated -= self._cycle
        part = self.interpolated / self._cycle
        if self.interpolated == self._cycle:
            self.interpolated = 0
            return now
        return tuple([start + part * (end - start) for start, end in zip(self._before, now)])


class Player:
    """Plays a command stream, and brakes where it has run dry."""

    def __init__(self, config: GatewayConfig, counters: Counter[str]):
        self._config = config
        self._counters = counters
        rate = PlayoutRate(config.limits, config.decimals, config.cycle_ns)
        self.playout = Playout(PlayoutBounds.of(config), rate)
        self.interpolator = SubCycleInterpolator(config.cycle_ns)
        # session, lateness of the next command [ns] and time [ns] of the stream that was given up
        self._stalled: tuple[str, int, int] | None = None
        self.fraction = 1.0
        #: Stands at the position last sent; None without an origin.
        self.follower: Follower | None = None
        #: Stamp of the target last played [ns]; 0 for none.
        self.stamp = 0
        self._stamp_before = 0
        #: How often the arm has stood for want of replies since its last lag of 0.
        self.standstills = 0
        #: Since the stream ran dry; None: it has not.
        self.braking: Braking | None = None

    def limit(self, fraction: float) -> None:
        """Play so slowly that every joint keeps to this fraction of its velocity limit, 0 to 1."""
        self.fraction = fraction
        self.playout.rate.limit(fraction)
        if self.follower is not None:
            self.follower.limit(fraction)

    def place(self, position: tuple[float, ...]) -> Follower:
        """Stand at `position` [rad], at rest; return the follower there."""
        config = self._config
        self.follower = Follower(config.limits, config.decimals, position, config.period)
        self.follower.limit(self.fraction)
        return self.follower

    def clear(self) -> None:
        """Clear the stream, and keep the learned jitter."""
        self.playout.clear()
        self.stamp = self._stamp_before = self.standstills = 0
        self.braking = None

    def push(self, stamp: int, q: tuple[float, ...], waited: int) -> None:
        """Buffer a checked command: stamp [ns], pose [rad], time since the last telegram [ns]."""
        if not self.playout.push(stamp, q, waited):
            self._counters["commands_late"] += 1

    def play(self, follower: Follower, elapsed: int, measured: tuple[float, ...]) -> tuple[float, ...]:
        """Move `follower` on by `elapsed` [ns]; return the position to send [rad]. `measured`: where the arm is, () for unknown."""
        self._stamp_before = self.stamp
        self.stamp, target = self.playout.advance(elapsed)
        if self.playout.silence:
            # the rest of the motion is unknown
            self._counters["cycles_without_command"] += 1
            return self._brake(follower, elapsed, measured)
        self.braking = None
        position = follower.follow(target)
        if follower.settling:
            self._counters["settling"] += 1
        return position

    def restart_from_rest(self, pause: int, taken_back: bool) -> None:
        """Go on from where HOLDON keeps the arm, while a stream is followed, after a pause without a reply."""
        self.playout.restart_from_rest(pause, taken_back)
        if taken_back:
            self.stamp = self._stamp_before
        self.standstills = self.standstills + 1 if self.playout.backlog else 0

    def _brake(self, follower: Follower, elapsed: int, measured: tuple[float, ...]) -> tuple[float, ...]:
        if self.braking is None:
            self.braking = Braking(follower, measured)
        position = follower.brake()
        self.braking.advance(follower, elapsed)
        return position

    def on_stream_given_up(self, session: str, now: int) -> None:
        """Record that the stream of `session` was given up for its silence; call it before `clear`."""
        self._stalled = session, self.playout.shortfall, now

    def learn_from_stall(self, session: str | None, now: int) -> None:
        """Lengthen the next stream's delay by the lateness of a command of the stream given up."""
        if self._stalled is None or session not in (None, self._stalled[0]):
            return
        _, shortfall, since = self._stalled
        self.playout.learn(shortfall + now - since)
        self._stalled = None
