"""The bridge's decisions: joint strings, control messages, reports, and the answer to a person's request for a session.

Pure: events in; messages, reports and answers out. Times are arguments [ns].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from construction_twin.core.errors import ExpiredError, PayloadError
from construction_twin.core.freshness import Moment, is_newer, parse_moment, staleness
from construction_twin.core.records import SPACED, to_json
from construction_twin.core.reports import LinkReport, ToolReport
from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.core.travel_time import TravelTime
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.gateway_status import GatewayAnswer, GatewayStatus, cut, without_counts
from construction_twin.link.observations import SHOWN_AFTER, ArmCheck, LinkState
from construction_twin.link.supervisor import BareSupervisor, LinkSupervisor
from construction_twin.link.tool_link import ToolLink
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import (
    OFFLINE,
    PROTOCOL,
    BridgeStatus,
    CommandProperties,
    Control,
    StateProperties,
    read_state_properties,
    refuse_properties,
)

#: Longest wait of a failed request for the gateway's answer that nothing of it is in force [ns].
WITHDRAWAL = NANOSECONDS
#: Between two reports of an unchanged link [ns].
_REPEAT = NANOSECONDS
#: Between two messages of an unchanged speed limit, and of any [ns].
LIMIT_PERIOD, LIMIT_PAUSE = NANOSECONDS // 5, NANOSECONDS // 50
PLC_HALTED = Sentence(
    "no more strings are sent to the PLC, and the plan is dropped: a lawful PLC brakes on silence; a person arms again, by name"
)
#: A sequence number may be this far ahead: one second of states.
MAX_JUMP = 250
#: So many messages in a row must follow one that does not fit before it becomes the new reference.
CONFIRMATIONS = 3
_NO_PROPERTIES = StateProperties(0, 0, 0)


class StateCheck:
    """Checks the states of one gateway: sequence and travel time.

    A new sequence, or a new clock, is believed after `CONFIRMATIONS` states of it in a row.

    Args:
        max_age: By how much longer than the quickest one of its run a state may travel [s].

    Attributes:
        lost: States missing in the sequence.
    """

    def __init__(self, max_age: float):
        self.lost = 0
        self._limit = round(max_age * NANOSECONDS)
        self._travel = TravelTime()
        self.restart()

    def restart(self) -> None:
        """Restart for another gateway and its clock."""
        self._last = self._before = self._misfits = 0
        self._travel.restart()

    def accept(self, seq: int, stamp: int, received: int) -> None:
        """Check a state by its number, the gateway's stamp and the time of reception, each on its own clock [ns].

        Raises:
            PayloadError: ``sequence``; ``stale``; ``early``: a travel time shorter than the quickest by more than `max_age`.
        """
        last, jump, excess, misfit = self._last, seq - self._last, self._travel.excess(stamp, received), None
        in_order = not last or 0 < jump <= MAX_JUMP
        if not in_order:
            misfit = PayloadError("sequence", f"seq {seq} after {last}")
        elif excess < -self._limit:
            misfit = PayloadError("early", f"state travelled {-excess / NANOSECONDS:.3f} s less than the quickest one")
        again = misfit and (in_order or seq == self._before + 1)  # out of sequence it must continue the state before
        self._misfits, self._before = self._misfits + 1 if again else int(misfit is not None), seq
        if in_order:
            self._last, self.lost = seq, self.lost + (jump - 1 if last else 0)
        if misfit and self._misfits <= CONFIRMATIONS:
            raise misfit
        if jump <= 0:
            self._travel.restart()
        elif not in_order:
            self.lost += jump - 1 - CONFIRMATIONS
        self._last, self._misfits = seq, 0
        if (excess := self._travel.record(stamp, received)) > self._limit:
            raise PayloadError("stale", f"state is {excess / NANOSECONDS:.3f} s older than the freshest one")


class JointStrings:
    """Commands and poses as joint strings with their user properties; one thread sends, another one receives."""

    def __init__(self, codec: JointStringCodec, properties: bool, bare: bool, max_age: float):
        self._codec = codec
        self.properties = properties and not bare
        self._read_properties = refuse_properties if bare else read_state_properties
        self.check = StateCheck(max_age)
        self.sent = self.received = 0

    def encode_command(
        self, q: tuple[float, ...], session: str, stamp: int
    ) -> tuple[bytes, list[tuple[str, str]] | None]:
        """Return payload and user properties of the next command [rad]; PayloadError where the wire cannot carry it."""
        payload = self._codec.encode(q)
        self.sent += 1
        return payload, CommandProperties(session, self.sent, stamp).pairs() if self.properties else None

    def decode_state(
        self, payload: bytes, pairs: list[tuple[str, str]], retained: bool, now: int
    ) -> tuple[tuple[float, ...], StateProperties]:
        """Return the arm's pose [rad] and what stands beside it, or raise PayloadError."""
        if retained:
            raise PayloadError("retained", "retained state: its age is unknown")
        q = self._codec.decode(payload)
        # where the link carries properties, a pose without them is not the gateway's
        properties = self._read_properties(pairs) if pairs or self.properties else None
        if properties is not None:
            self.check.accept(properties.seq, properties.stamp, now)
        self.received += 1
        return q, properties or _NO_PROPERTIES


class PendingRequest:
    """A person's request for a session, from the call to the answer.

    Attributes:
        lifts: Why the link waited for a person at the call.
        number: 0: not yet made.
    """

    def __init__(self, supervisor: LinkSupervisor, now: int, timeout: float):
        self._supervisor, self._timeout = supervisor, timeout
        self._deadline = now + round(timeout * NANOSECONDS)
        self._before, self._halts = supervisor.session, supervisor.halts
        self._answer: tuple[bool, str] | None = None
        self.lifts = supervisor.reason
        self.number = 0

    def answer(self, now: int, ending: bool) -> tuple[bool, str] | None:
        """Return whether the link is armed, and one sentence; None: ask again. A failed request is withdrawn."""
        if self._answer is None:
            self._answer = self._outcome(ending or now >= self._deadline)
            self._deadline = now + WITHDRAWAL if self._answer else self._deadline
        # who asks again at once must know of the stop with which it is withdrawn
        supervisor = self._supervisor
        if supervisor.withdraws and supervisor.state is LinkState.NEEDS_RESET and now < self._deadline and not ending:
            return None
        return self._answer

    def _outcome(self, late: bool) -> tuple[bool, str] | None:
        supervisor = self._supervisor
        has_begun = supervisor.session != self._before
        if supervisor.halts != self._halts:
            return False, Sentence("not armed: halt was called meanwhile: {why}", why=supervisor.sentence)
        if has_begun and supervisor.state is LinkState.ARMED and not supervisor.inputs.status.fault:
            return True, Sentence("armed, {reason}", reason=supervisor.reason)
        if has_begun and supervisor.state is LinkState.NEEDS_RESET:
            sentence = Sentence("not armed: {why}", why=supervisor.sentence)
        elif late:
            sentence = Sentence("not armed within {timeout:g} s: {why}", timeout=self._timeout, why=supervisor.sentence)
        else:
            return None
        supervisor.withdraw(self.number, sentence)
        return False, sentence


class Bridge:
    """The link of one robot: its supervisor, the tool behind the gateway, the speed limit, and reports of them.

    Args:
        timeout: Longest wait of a person's request for the link to be armed [s].
        waits: `waits_for` of the process before this one.
        arm: Compares the arm with its model.

    Attributes:
        played: Id of the plan that the executor plays, or has played last: only its switches are armed.
        waits_for: Why only a person leads on, for the process after this one; "": nobody is waited for.
    """

    def __init__(
        self,
        config: GatewayConfig,
        bare: bool,
        timeout: float,
        strings: JointStrings,
        new_id: Callable[[], str],
        waits: str = "",
        arm: ArmCheck | None = None,
    ):
        self.supervisor = BareSupervisor(config, new_id) if bare else LinkSupervisor(config, new_id, waits, arm)
        self.played = ""
        self._strings, self._timeout, self._new_id = strings, timeout, new_id
        self._tool = ToolLink(new_id)
        self._published_tool: ToolReport | None = None
        # the last stop that is known, and from when on a view surely shows it
        self._stop: object = None
        self._stop_shown_from: Moment | None = None
        self.waits_for = waits
        self._values: dict[str, str] = {}
        self._published: tuple[LinkState, str, str] | None = None
        self._published_at = 0
        # session and speed limit that were sent last, when, and how many were; and the one that is still to be sent
        self._limit, self._limit_at, self._limits = ("", 1.0), 0, 0
        self._next_limit: float | None = None

    # -- the gateway

    def poll(self, now: int, present: Moment) -> Control | None:
        """Update the link; return the control message that is due."""
        supervisor = self.supervisor
        control = supervisor.poll(now)
        self._record_stops(present)
        # the first sentence stays while a person is waited for: figures may waver in those that follow
        waits = supervisor.waits_for
        self.waits_for = waits and (self.waits_for or waits)
        return control or self._limit_due(now)

    def on_speed_limit(self, limit: float, now: int) -> Control | None:
        """Return the message for the speed limit in force; None: sent lately, or `poll` sends it."""
        is_sent = (self.supervisor.session, limit) == self._limit and now - self._limit_at < LIMIT_PERIOD
        self._next_limit = None if is_sent else limit
        return self._limit_due(now)

    def _limit_due(self, now: int) -> Control | None:
        limit = self._next_limit
        if not self._takes_control:
            self._next_limit = None
        elif limit is not None and now - self._limit_at >= LIMIT_PAUSE:
            # numbered, because the gateway takes none that is not newer than all before
            self._limit, self._limit_at, self._limits = (self.supervisor.session, limit), now, self._limits + 1
            self._next_limit = None
            return Control(str(self._limits), self.supervisor.session, "speed_limit", limit)
        return None

    @property
    def _takes_control(self) -> bool:
        return self.supervisor.state is LinkState.ARMED and self.supervisor.sends_control

    def on_status(self, status: GatewayStatus, now: int) -> None:
        """Store the gateway's status, or a bare PLC's word; PayloadError where it is ignored."""
        if problem := self.supervisor.inputs.on_status(status, now):
            raise PayloadError("status", problem)
        self._tool.on_status(status)
        self._values = status.text_values()
        if status.state == OFFLINE:
            self._strings.check.restart()

    def on_answer(self, answer: GatewayAnswer, now: int) -> None:
        """Act on the answer to a control message; PayloadError where a speed limit is refused."""
        self.supervisor.on_answer(answer, now)
        self._tool.on_answer(answer)
        if answer.verb == "speed_limit" and not answer.ok:
            refused = Sentence("gateway refused the speed limit: {reason}", reason=cut(answer.reason))
            raise PayloadError("speed_limit", refused)

    # -- the tool

    def void_switches(self) -> Control | None:
        """Return the message that makes every armed switch void."""
        return self._tool.void(self.supervisor.session) if self.supervisor.sends_control else None

    def switch(self, plan: str, id: str, output: str, value: bool, stamp: int) -> Control | None:
        """Return the message for a switch of a plan at a stamp [ns]; None where it is refused here."""
        obstacle = "" if self._takes_control else self._link_sentence
        if not obstacle and (not plan or plan != self.played):
            plans = {"plan": repr(plan), "present": repr(self.played)}
            obstacle = Sentence("switch of plan {plan}, but the executor plays {present}", **plans)
        return self._tool.switch(id, output, value, stamp, self.supervisor.session, obstacle)

    def on_gate(self, is_open: bool) -> Control | None:
        """Return the message that voids what is armed where the gate has closed."""
        return self._tool.on_gate(is_open, self.supervisor.session) if self.supervisor.sends_control else None

    def changed_tool_report(self) -> ToolReport | None:
        """Return the report on `tool` where it has changed."""
        obstacle = ""
        if not self.supervisor.sends_control:
            obstacle = Sentence("a bare PLC has no tool here: no switch is possible")
        elif self.supervisor.state in (LinkState.DISCONNECTED, LinkState.GATEWAY_OFFLINE, LinkState.MISMATCH):
            obstacle = self._link_sentence
        before, self._published_tool = self._published_tool, self._tool.state_report(obstacle)
        return None if self._published_tool == before else self._published_tool

    @property
    def _link_sentence(self) -> Sentence:
        supervisor = self.supervisor
        return Sentence("the link is {state}: {reason}", state=supervisor.state.name, reason=supervisor.reason)

    # -- what a person asks for

    def ask(self, verb: str, person: str, moment: str | None, now: int, present: Moment) -> PendingRequest:
        """Ask for a session: `reset` starts over from the arm's pose, `arm` where nothing needs to move for it.

        Args:
            moment: That the person's screen had shown; None: asked at the robot's computers.

        Raises:
            ExpiredError: The moment is too old, or older than the last stop.
            PayloadError: ``act``, ``moment``.
            ReviewError: It is not possible now.
        """
        self._record_stops(present)
        if moment is not None:
            shown_at = parse_moment(moment)
            if problem := staleness(shown_at, present):
                raise ExpiredError(Sentence("this is {problem}", problem=problem))
            if not is_newer(shown_at, self._stop_shown_from):
                raise ExpiredError(
                    Sentence("this is void: the arm was stopped after what the screen had shown; ask anew")
                )
        asked = PendingRequest(self.supervisor, now, self._timeout)
        if verb == "reset":
            self.supervisor.request_reset(now)
        elif verb == "arm":
            self.supervisor.request_arm(now, person)
        else:
            raise PayloadError("act", Sentence("{act} is nothing that is done here", act=repr(verb)))
        asked.number = self.supervisor.requests
        return asked

    def _record_stops(self, present: Moment) -> None:
        stop = (*self.supervisor.known_stop, self.supervisor.halts)
        if stop != self._stop:
            self._stop, self._stop_shown_from = stop, replace(present, at=present.at + SHOWN_AFTER)

    def mirror(self, leads: bool, now: int) -> tuple[str, PendingRequest | None]:
        """Begin or end mirror mode; return one sentence, and the session request that follows, None for none."""
        supervisor = self.supervisor
        asked, before = PendingRequest(supervisor, now, self._timeout), supervisor.requests
        sentence = supervisor.begin_mirror(now) if leads else supervisor.end_mirror(now)
        asked.number = supervisor.requests
        return sentence, asked if asked.number != before else None

    def halt(self) -> Control | None:
        """End the right to command; return the stop for the gateway. A bare PLC brakes on silence."""
        session, tells = self.supervisor.session, self.supervisor.sends_control
        self.supervisor.halt(Sentence("stopped at the gateway on request; call reset") if tells else PLC_HALTED)
        return Control(self._new_id(), session, "stop") if tells else None

    # -- reports

    def reason(self, connection: str) -> str:
        """Return the supervisor's sentence, and what keeps the connection down or the arm still."""
        supervisor = self.supervisor
        if supervisor.state is LinkState.DISCONNECTED and connection:
            return Sentence("{state}: {reason}", state=supervisor.reason, reason=connection)
        # the status of a gateway that is gone is out of date
        if supervisor.state in (LinkState.DISCONNECTED, LinkState.GATEWAY_OFFLINE):
            return supervisor.reason
        return join_sentences(supervisor.reason, supervisor.inputs.status.controller_sentence)

    def report_due(self, now: int, connection: str) -> tuple[bool, bool]:
        """Return whether a report of the link is due, and whether more than figures have changed."""
        supervisor = self.supervisor
        news = supervisor.state, without_counts(self.reason(connection)), supervisor.session
        changed = news != self._published
        if not changed and now - self._published_at < _REPEAT:
            return False, False
        self._published, self._published_at = news, now
        return True, changed

    def status(self) -> bytes:
        """Return the message on `bridge/status`."""
        supervisor = self.supervisor
        bare = (supervisor.responsible, supervisor.not_checked) if supervisor.not_checked else (None, None)
        name = supervisor.state.name.lower()
        return to_json(BridgeStatus(name, supervisor.reason, supervisor.session, PROTOCOL, *bare), separators=SPACED)

    @property
    def _gateway_values(self) -> dict[str, object]:
        return {**self.supervisor.inputs.status.counters, **self._values}

    def state_report(self, connection: str, refused: Mapping[str, int], stamp: int) -> LinkReport:
        """Return the report on `link`; `refused`: how often inputs were refused, by reason."""
        supervisor, status = self.supervisor, self.supervisor.inputs.status
        reply = status.reply_us
        counters = self._gateway_values | {
            "decimals": "" if status.decimals is None else status.decimals,
            "reply_us_max": reply.max,
            "states_lost": self._strings.check.lost,
        }
        states_refused = sum(count for name, count in refused.items() if name.startswith("stat"))  # state_..., status
        return LinkReport(
            supervisor.state.name,
            self.reason(connection),
            gateway_state=status.state,
            gateway_counters={key: str(value) for key, value in sorted(counters.items())},
            commands_refused=sum(refused.values()) - states_refused,
            states_refused=states_refused,
            responsible=supervisor.responsible,
            not_checked=tuple(supervisor.not_checked),
            gateway_kind=supervisor.kind,
            session=supervisor.session,
            tool_pose=supervisor.inputs.arm.text,
            state=supervisor.state.value,
            stamp=stamp,
            commands_sent=self._strings.sent,
            reply_us_bins=tuple(reply.bins),
            reply_us_counts=tuple(reply.counts),
        )

    def values(self) -> dict[str, object]:
        """Return the values for `/diagnostics`."""
        supervisor, strings = self.supervisor, self._strings
        values: dict[str, object] = {"session": supervisor.session}
        values |= {"commands sent": strings.sent, "states received": strings.received}
        values |= {f"gateway {key}": value for key, value in sorted(self._gateway_values.items())}
        if arm := supervisor.inputs.arm.text:
            values["tool pose"] = arm
        if difference := supervisor.inputs.arm.difference:
            values |= {"tool pose off [mm]": difference[0] * 1e3, "tool pose off [deg]": math.degrees(difference[1])}
        if supervisor.not_checked:
            values["responsible"] = supervisor.responsible or "no person: not armed"
            parts = [sentence.partition(": ") for sentence in supervisor.not_checked]
            values |= {f"not checked: {topic}": what for topic, _, what in parts}
        if not strings.properties:
            values["comparison"] = "instant: the link carries no MQTT 5 properties"
        return values
