"""Bare mode: the link to a PLC that knows only the joint string, armed by a person who takes the responsibility by name.

Pure; time is an argument [ns]. The PLC says two words, `ready` and `offline`, and its pose; it is asked nothing.
"""

from __future__ import annotations

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.link.gateway_status import NO_STATUS, GatewayStatus
from construction_twin.link.observations import ABSENT, LinkObservations, LinkState
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.mqtt.messages import OFFLINE, PLC

#: What is not checked with a bare PLC, one sentence each; `docs/broker.md` says what follows from it.
NOT_CHECKED = (
    Sentence("configuration: whether the PLC has the same joint ranges, speeds and accelerations, is not compared"),
    Sentence("session: the PLC takes strings from every client that may write on `command`"),
    Sentence("sequence: strings that are lost, doubled or reordered are not noticed, in neither direction"),
    Sentence("age: a string that travelled too long counts as new, in both directions"),
    Sentence("answers: a stop is not confirmed; why the PLC stopped, and how far the arm goes on, is not known"),
    Sentence("speed limit: it is not sent to the PLC; the executor alone obeys it"),
    Sentence("controller: what stands behind the PLC (RSI, servo, brakes) is not known"),
    Sentence("comparison: the gate compares at the present moment, so the whole round trip counts as lag"),
)
#: How a person arms; with --robot where the robot is not the command's default.
ARM_COMMAND = "rosrun construction_twin twin arm --responsible NAME"
#: Longest name of a person.
_LONGEST_NAME = 64


class BareObservations(LinkObservations):
    """What is known of broker, bare PLC, arm and command stream."""

    #: Whether `offline` was said since this was set to False.
    offline_received = False

    def on_status(self, status: GatewayStatus, now: int) -> str:
        """Take what was said on `status`; an `offline` counts, however soon `ready` follows: the PLC has stopped."""
        problem = super().on_status(status, now)
        self.offline_received |= status.state == OFFLINE
        return problem

    def why_not_believed(self, status: GatewayStatus, now: int) -> str:
        """Return an empty sentence: what is said there is either the PLC's word, or a gateway's, which ends it."""
        return ""

    def obstacle(self, now: int, mirrors: bool) -> tuple[LinkState, str] | None:
        """Return what is missing for a link that commands, or in mirror mode for one that follows, and one sentence."""
        if not self._connected:
            return LinkState.DISCONNECTED, Sentence("not connected to the broker")
        if self.status.kind != PLC and self.status.state != OFFLINE:
            return LinkState.MISMATCH, Sentence(
                "rsi_gateway answers on the broker, no bare PLC: start with gateway_kind:=rsi, or stop that gateway"
            )
        if self.status is NO_STATUS:
            return LinkState.GATEWAY_OFFLINE, Sentence("no PLC has said `ready` on its `status` topic, retained")
        if self.offline_received or self.status.state == OFFLINE:
            return LinkState.GATEWAY_OFFLINE, Sentence("the PLC says `offline`: it takes no strings; see to the PLC")
        if not self.pose_is_fresh(now):
            why = self.why_no_pose(now) or Sentence("no joint string comes on its `state` topic")
            return LinkState.NO_CONTROLLER, Sentence("the PLC says `ready`, but {why}", why=why)
        return None


class BareSupervisor(LinkSupervisor):
    """Arms in a person's name alone, and asks nothing of the PLC; takes no configuration's hash into account."""

    kind, sends_control = PLC, False
    not_checked = NOT_CHECKED
    inputs: BareObservations
    _observations = BareObservations

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        # the first one that is armed must be another, so that twin and gate start over with it
        self.session = self._new_id()

    def poll(self, now: int) -> None:
        """Update the state; there is never anything to send."""
        super().poll(now)
        self.inputs.offline_received = False

    def _enter(self, state: LinkState, reason: str) -> None:
        super()._enter(state, reason)
        # it ends with the session
        if state not in (LinkState.RESYNC, LinkState.ARMED):
            self.responsible = ""

    def _update_state(self, now: int) -> None:
        if self.mirrors:
            super()._update_state(now)
        elif self.state in (*ABSENT, LinkState.MIRROR):
            self._enter(
                LinkState.NEEDS_RESET,
                Sentence("a bare PLC is armed by a person, by name: {command}", command=ARM_COMMAND),
            )

    def _choose_message(self, now: int) -> None:
        # a stream in motion may pass the arm's pose; no gateway would refuse what begins at speed
        known = self.inputs
        together = known.within_tolerance(now) and known.at_rest(now) and known.stream_rests(now)
        if self.state is LinkState.RESYNC and together:
            topics = ", ".join(sentence.partition(":")[0] for sentence in self.not_checked)
            armed = Sentence(
                "bare PLC, session {session}; {name} is responsible for what is not checked: {topics}",
                session=self.session,
                name=self.responsible,
                topics=topics,
            )
            self._enter(LinkState.ARMED, armed)

    def request_arm(self, now: int, person: str = "") -> None:
        """Begin a session in the name of the person who is responsible for what is not checked; ReviewError where it cannot."""
        name = person.strip()
        if not name or len(name) > _LONGEST_NAME or not name.isprintable():
            raise ReviewError(
                Sentence(
                    "a bare PLC is armed in a person's name, {name} is none: {command}",
                    name=repr(name[:_LONGEST_NAME]),
                    command=ARM_COMMAND,
                )
            )
        if self.state in (LinkState.RESYNC, LinkState.ARMED):
            raise ReviewError(
                Sentence(
                    "{name} is responsible already: {reason}; halt ends it", name=self.responsible, reason=self.reason
                )
            )
        if self.state is not LinkState.NEEDS_RESET:
            raise ReviewError(Sentence("cannot arm: {why}", why=self.sentence))
        if unrest := self.inputs.why_not_at_rest(now):
            raise ReviewError(Sentence("cannot arm: {why}", why=unrest))
        self.responsible = name
        self.requests += 1
        taken = Sentence("{name} has taken the responsibility; twin and arm take the same pose", name=name)
        self._begin_session(taken)

    def withdraw(self, request: int, reason: str) -> None:
        """Give up arming, because the poses do not meet in time: it must not happen later, when the person is gone."""
        if request == self.requests and self.state is LinkState.RESYNC:
            self.halt(reason)

    def _after_mirror(self) -> str:
        return Sentence("mirror mode has ended; a person arms the PLC again: {command}", command=ARM_COMMAND)

    def request_reset(self, now: int) -> None:
        """Raise ReviewError: a person's name is needed; it says why nothing could be armed either."""
        refusal = Sentence("cannot reset a bare PLC without a name: {command}", command=ARM_COMMAND)
        if self.state in (LinkState.RESYNC, LinkState.ARMED):
            name = self.responsible
            refusal = Sentence("{refusal}; first end what {name} has armed, with halt", refusal=refusal, name=name)
        elif problem := self.inputs.why_not_at_rest(now) if self.state is LinkState.NEEDS_RESET else self.reason:
            refusal = Sentence("{refusal}; now it could not either: {problem}", refusal=refusal, problem=problem)
        raise ReviewError(refusal)
