"""Which commands are played: those of the armed session, in order, in time, inside the limits. Standard library only; rad, ns."""

from __future__ import annotations

from construction_twin.core.errors import MotionRefused, PayloadError
from construction_twin.core.limits import MotionCheck, outside_tolerance
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.command_stream import Command, CommandStream
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.player import Player
from construction_twin.gateway.states import Event
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties


class StreamBroken(Exception):
    """The stream cannot go on, though nothing is wrong with the command itself.

    Attributes:
        event: ``STREAM_SILENT``, ``SPEED_IGNORED`` or ``REPLIES_LOST``: what the gateway brakes for.
        reason: Why, in one sentence.
    """

    def __init__(self, event: Event, reason: Sentence):
        super().__init__(reason)
        self.event, self.reason = event, reason


class CommandIntake:
    """From messages on `command` to what the player plays."""

    def __init__(self, config: GatewayConfig, codec: JointStringCodec, player: Player):
        self._config = config
        self._limits = config.limits
        self._player = player
        self._stream = CommandStream(config, codec)
        self._check = MotionCheck(self._limits, config.decimals)

    @property
    def session(self) -> str:
        """Id of the session that may command; "" for none."""
        return self._stream.session

    def begin(self, session: str) -> None:
        """Start over with another session; "" for none."""
        self._stream.begin(session)

    def read(self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int) -> Command:
        """Read a command; PayloadError when it is not one."""
        if isinstance(properties, PayloadError):
            raise properties
        return self._stream.read(payload, properties, now)

    def start(self, held: tuple[float, ...], stamp: int, q: tuple[float, ...], waited: int, now: int) -> None:
        """Take the first command of a stream.

        Args:
            held: Shape (n,). The pose that the gateway holds [rad].
            stamp: [ns]
            q: Shape (n,). [rad]
            waited: Time since the last telegram [ns].
            now: [ns]

        Raises:
            MotionRefused: When it is out of range, or away from the pose that is held (``start``).
        """
        self._limits.check_range(q)
        tolerances = self._config.start_tolerances
        off = outside_tolerance(q, held, tolerances)
        if off is not None:
            raise self._limits.refused("start", off, q[off] - held[off], tolerances[off])
        self._check.start(stamp, q)
        self._player.learn_from_stall(self.session if self._config.properties else None, now)
        self._push(stamp, q, waited)

    def take(self, stamp: int, q: tuple[float, ...], waited: int) -> None:
        """Take a command that follows another.

        Args:
            stamp: [ns]
            q: Shape (n,). [rad]
            waited: Time since the last telegram [ns].

        Raises:
            MotionRefused: ``lead`` or a reason of `MotionCheck`.
            StreamBroken: When too much of the stream is missing, the sender does not obey the speed limit, or replies do not
                arrive.
        """
        player = self._player
        # the time since the last telegram is subtracted: playout time advances only with telegrams
        lead = player.lead(stamp) - waited / NANOSECONDS
        if lead > self._config.max_age:
            # a clock that was set, or a sender faster than time: it would be played in slow motion, and never fall silent
            raise MotionRefused("lead", "", lead, self._config.max_age, "s")
        hole = player.hole(stamp)
        if hole:
            # too long to guess what the motion was in between
            raise StreamBroken(Event.STREAM_SILENT, Sentence("gateway.stream.hole", seconds=hole))
        behind = player.backlog
        if behind > self._config.speed_limit_backlog:
            backlog = {"behind": behind, "most": self._config.speed_limit_backlog}
            if player.stood:
                found = Sentence("gateway.stream.replies", count=player.stood, **backlog)
                raise StreamBroken(Event.REPLIES_LOST, found)
            found = Sentence("gateway.stream.speed", fraction=player.fraction, **backlog)
            raise StreamBroken(Event.SPEED_IGNORED, found)
        self._check.accept(stamp, q)
        self._push(stamp, q, waited)

    def _push(self, stamp: int, q: tuple[float, ...], waited: int) -> None:
        self._stream.last_stamp = stamp
        self._player.push(stamp, q, waited)
