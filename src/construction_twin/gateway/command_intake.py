"""The check of commands: those of the armed session, in order, in time, inside the limits, are played. rad, ns."""

from __future__ import annotations

from construction_twin.core.errors import MotionRefused, PayloadError
from construction_twin.core.limits import MotionCheck, outside_tolerance
from construction_twin.core.sentences import Sentence
from construction_twin.core.travel_time import TravelTime
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.player import Player
from construction_twin.gateway.states import Event
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties

#: The grid of unstamped commands moves by one part in so many of its distance to each arrival: it follows drift within minutes.
ARRIVAL_SMOOTHING = 16_384
#: The same once it has rested for so many commands (1 s): nothing depends on the grid then, and a sender of 4.1 ms stays in reach.
REST_SMOOTHING, RESTING = 128, 250
#: Sequence numbers behind the newest of which it is remembered whether they were taken.
REMEMBERED = 64
#: Sequence numbers that one command may be ahead of the last one taken: more than are sent while a stream survives.
FARTHEST = 10_000
_ALL = (1 << REMEMBERED) - 1


class CommandStream:
    """The commands of one session."""

    def __init__(self, config: GatewayConfig, codec: JointStringCodec):
        self._config, self._codec = config, codec
        # a sender that has been silent for longer has been given up
        self._longest_wait = round((config.playout_delay_max + config.silence) * NANOSECONDS)
        self._travel_time = TravelTime()
        self.begin("")

    def begin(self, session: str) -> None:
        """Start over with another session; "" for none."""
        self.session = session
        #: Stamp of the last command that was taken [ns].
        self.last_stamp = 0
        # the newest number; bit k: the number k below it was taken
        self._sequence = self._received = 0
        self._travel_time.restart()
        self._rest: tuple[tuple[float, ...], int] = (), 0  # last unstamped pose, and how many equal ones followed it

    def read(
        self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int
    ) -> tuple[int, tuple[float, ...], int]:
        """Read a joint string; return its stamp (on our clock where it carries none), its pose, and the commands lost before it."""
        if isinstance(properties, PayloadError):
            raise properties
        if not self._config.properties:
            q = self._codec.decode(payload)
            return self._arrival_stamp(now, q), q, 0
        if properties is None:
            raise PayloadError("properties", "command without session, seq and stamp")
        if properties.session != self.session:
            raise PayloadError("session", f"command of session {properties.session!r}; armed is {self.session!r}")
        step = properties.seq - self._sequence
        if step <= -REMEMBERED or properties.seq < 1:
            raise PayloadError("sequence", f"seq {properties.seq} after {self._sequence}")
        if step > FARTHEST and self.last_stamp:
            # the count of lost commands would mean nothing
            raise PayloadError("sequence", f"seq {properties.seq} after {self._sequence}: no stream loses so many")
        if step <= 0:
            found = "duplicate" if self._received >> -step & 1 else "reordered"
            raise PayloadError(found, f"seq {properties.seq} after {self._sequence}: {found}")
        q = self._codec.decode(payload)
        # a late command leaves the quickest travel time unchanged: recording it before the check is safe
        late = self._travel_time.record(properties.stamp, now) / NANOSECONDS
        if late > self._config.max_age:
            raise PayloadError("stale", f"command is {late:.3f} s older than the freshest")
        self._sequence = properties.seq
        self._received = 1 if step >= REMEMBERED else (self._received << step | 1) & _ALL
        return properties.stamp, q, step - 1

    def _arrival_stamp(self, now: int, q: tuple[float, ...]) -> int:
        """Return a stamp for a command without one: the sender's 4 ms grid, begun anew after a gap in which it was given up.

        A lost command leaves the grid a cycle late until the stream rests; in motion it is a step, which the motion check refuses.
        """
        self._rest = q, self._rest[1] + 1 if q == self._rest[0] else 0
        expected = self.last_stamp + CYCLE_NS
        distance, smoothing = now - expected, ARRIVAL_SMOOTHING if self._rest[1] < RESTING else REST_SMOOTHING
        return now if abs(distance) > self._longest_wait else expected + distance // smoothing


class StreamBroken(Exception):
    """End of a stream at a valid command, by one of the events ``STREAM_SILENT``, ``SPEED_IGNORED``, ``REPLIES_LOST``."""

    def __init__(self, event: Event, reason: Sentence):
        super().__init__(reason)
        self.event = event


class CommandIntake:
    """Checks commands and pushes them to the player. `waited` is the time since the last telegram [ns]."""

    def __init__(self, config: GatewayConfig, codec: JointStringCodec, player: Player):
        self._config, self._limits, self._player = config, config.limits, player
        self.stream = CommandStream(config, codec)
        self._longest_gap = round(config.silence * NANOSECONDS)
        self._check = MotionCheck(self._limits, config.decimals)

    def begin_stream(self, held: tuple[float, ...], stamp: int, q: tuple[float, ...], waited: int, now: int) -> None:
        """Push the first command of a stream; MotionRefused when it is out of range, or away from the pose `held` (``start``)."""
        self._limits.check_range(q, q)
        tolerances = self._config.start_tolerances
        off = outside_tolerance(q, held, tolerances)
        if off is not None:
            raise self._limits.refusal("start", off, q[off] - held[off], tolerances[off])
        self._check.start(stamp, q)
        self._player.learn_from_stall(self.stream.session if self._config.properties else None, now)
        self._push(stamp, q, waited)

    def on_command(self, stamp: int, q: tuple[float, ...], waited: int) -> None:
        """Push a command that follows another; MotionRefused (``lead``, or a reason of `MotionCheck`) or StreamBroken."""
        player, playout = self._player, self._player.playout
        # the time since the last telegram is subtracted: playout time advances only with telegrams
        lead = (playout.lead_time(stamp) - waited) / NANOSECONDS
        if lead > self._config.max_age:
            # a clock that was set, or a sender faster than time: it would be played in slow motion, and never fall silent
            raise MotionRefused("lead", "", lead, self._config.max_age, "s")
        gap = stamp - playout.newest
        if gap > self._longest_gap:
            # too long to guess what the motion was in between, whatever the delay is
            why = Sentence("{seconds:.3f} s of the stream are missing", seconds=gap / NANOSECONDS)
            raise StreamBroken(Event.STREAM_SILENT, why)
        behind = playout.backlog / NANOSECONDS
        if behind > self._config.speed_limit_backlog:
            event, cause = Event.SPEED_IGNORED, Sentence("speed limit {limit:g} not obeyed", limit=player.fraction)
            if player.standstills:
                event = Event.REPLIES_LOST
                cause = Sentence("{count} standstills, replies did not arrive in time", count=player.standstills)
            most = self._config.speed_limit_backlog
            why = Sentence(
                "arm {behind:.3f} s behind its stream, allowed {most:g} s: {cause}",
                behind=behind,
                most=most,
                cause=cause,
            )
            raise StreamBroken(event, why)
        self._check.accept(stamp, q)
        self._push(stamp, q, waited)

    def _push(self, stamp: int, q: tuple[float, ...], waited: int) -> None:
        self.stream.last_stamp = stamp
        self._player.push(stamp, q, waited)
