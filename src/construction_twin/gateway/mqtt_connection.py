"""What the gateway receives and publishes on MQTT: commands, control and stops in; states, status and answers out. `now` in ns."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from functools import partial

from paho.mqtt import client as paho

from construction_twin.core.errors import PayloadError
from construction_twin.core.histogram import Histogram
from construction_twin.core.rate_limit import LineLimiter
from construction_twin.core.records import SPACED, to_json
from construction_twin.core.sentences import Sentence, templates_of
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.states import State
from construction_twin.gateway.stop_file import StopFile
from construction_twin.mqtt import requests
from construction_twin.mqtt.client import Broker, ConnectionLog, last_will, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import (
    PROTOCOL,
    VERBS,
    CommandProperties,
    ControlAnswer,
    Topics,
    account_of,
    identity_of,
    parse_control,
    parse_intervention,
    read_command_properties,
)
from construction_twin.mqtt.polled_client import PolledClient

log = logging.getLogger("rsi_gateway")

_STATUS_PERIOD = NANOSECONDS
#: Without a telegram for this long no controller waits for an answer [ns].
QUIET = NANOSECONDS // 20


class MqttConnection:
    """One gateway's connection to the broker, served in the pause behind an answer to the controller.

    Args:
        polled: Makes a client that the loop serves.
        run_guarded: Runs a part and catches its unexpected exception: paho would repeat a message whose callback raised.

    Attributes:
        now: Of the loop's present turn.
        failure: The sentence of the gateway's failure; "" for none.
        ending: True: a broker that is gone is no error.
    """

    def __init__(
        self,
        gateway: Gateway,
        broker: Broker,
        topics: Topics,
        polled: Callable[..., PolledClient],
        run_guarded: Callable,
        stops: StopFile | None,
        reply_time: Histogram,
    ):
        self.now = 0
        self.failure = ""
        self.ending = False
        self._due_at = self._received_at = 0
        self._gateway = gateway
        self._topics = topics
        self._run_guarded = run_guarded
        self._stops = stops
        self._reply_time = reply_time
        # a last will may come late, when another run or connection speaks already: it names its own
        self._number = 1
        will = last_will(gateway.run, self._number)
        client = make_client(broker, unique_id(topics.robot, "gateway"), topics.status, will)
        self._connection = ConnectionLog(broker, self._log_connection)
        client.on_connect = partial(run_guarded, self._on_connect)
        client.on_disconnect = partial(run_guarded, self._on_disconnect)
        client.on_stream(topics.command, partial(run_guarded, self._on_command))
        client.message_callback_add(topics.control, partial(run_guarded, self._on_control))
        client.message_callback_add(topics.stop_by("+"), partial(run_guarded, self._on_stop))
        client.connect_async(broker.host, broker.port, broker.keepalive)
        self.polled = polled(client, on_failure=self._connection.failed)
        self._client = client
        self._lines = LineLimiter()
        self._speed_answer: tuple = ()

    # -- received

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected(client, properties)
        log.info("connected to the broker")
        topics = [(self._topics.command, 0), (self._topics.control, 1), (self._topics.stop_by("+"), 1)]
        client.subscribe(subscriptions(topics))
        info = self.publish_status()
        # the client repeats what was not acknowledged before: an older status behind this one would be retained
        self._due_at = 0
        if info is not None:
            self._connection.watch_publish(client, self._topics.status, info.mid)

    def _log_connection(self, sentence: str) -> None:
        log.log(logging.INFO if self.ending else logging.ERROR, "%s", sentence)

    def _on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        self._connection.lost(reason_code)
        self._number += 1
        client.will_set(self._topics.status, last_will(self._gateway.run, self._number), qos=1, retain=True)

    def _on_command(self, payload: bytes, pairs: list[tuple[str, str]], retained: bool) -> None:
        if retained:
            self._refuse_retained("command")
            return
        properties: CommandProperties | PayloadError | None
        try:
            properties = read_command_properties(pairs) if pairs else None
        except PayloadError as error:
            properties = error
        self._gateway.on_command(payload, properties, self.now)

    def _refuse_retained(self, name: str) -> None:
        why = f"a message on {name} with the retain flag: its age is unknown"
        self._gateway.refusals.count_message("retained", why)

    def _on_control(self, client, userdata, message: paho.MQTTMessage) -> None:
        if message.retain:
            self._refuse_retained("control")
            return
        try:
            control = parse_control(bytes(message.payload))
        except PayloadError as error:
            self._gateway.refusals.count_message(error.reason, error)
            self.log_line(logging.WARNING, f"refused on {error.reason}", str(error))
            return
        done = self._gateway.on_control(control, self.now)
        ok, reason = done.ok, done.reason
        if not reason:
            return
        if control.verb == "speed_limit":
            # repeated several times a second: only what is new is worth a line and an answer
            before, self._speed_answer = self._speed_answer, (control.session, ok, reason)
            if self._speed_answer == before:
                return
        verb = control.verb if control.verb in VERBS else "unknown verb"
        answer = ControlAnswer(control.id, control.verb, ok, reason, control.session)
        of_stop = control.verb == "stop"
        self._answer(self._topics.control_ack, partial(to_json, answer, SPACED, translatable=True), of_stop)
        level, kind = (logging.INFO, verb) if ok else (logging.WARNING, f"refused {verb}")
        self._gateway.side_effects.run("the log", self.log_line, level, kind, f"session {control.session}: {reason}")

    def _on_stop(self, client, userdata, message: paho.MQTTMessage) -> None:
        account, payload = "", bytes(message.payload)
        try:
            account = account_of(message.topic)
            if not account:
                # an answer: this gateway's, or the executor's
                return
            stop = parse_intervention(account, payload, message.retain)
        except PayloadError as error:
            done = self._gateway.refuse_stop(account, error, self.now)
            line = logging.WARNING, f"refused on {error.reason}", str(error)
        else:
            done = self._gateway.on_stop(stop, self.now)
            line = logging.INFO, "stop by a person", f"account {account}: {done.reason or 'again'}"
        if done.reason:
            known = {"account": account, "ok": done.ok, "reason": done.reason, "by": requests.GATEWAY}
            self._answer(
                self._topics.stop_ack, lambda: requests.STOP.payload(**identity_of(payload), **known), of_stop=True
            )
        self._gateway.side_effects.run("the log", self.log_line, *line)

    # -- sent

    def _answer(self, topic: str, payload: Callable[[], bytes], of_stop: bool) -> None:
        """Publish the status, then an answer, whose reader must not act on an older status."""
        effects = self._gateway.side_effects
        effects.run("the status", partial(self._send_status, self._document) if of_stop else self.publish_status)
        effects.run("the answer", lambda: self._client.publish(topic, payload(), qos=1))

    def publish_state(self, now: int) -> None:
        """Publish the pose of the last telegram."""
        if not self.polled.connected:
            return
        message = self._gateway.state_message(now)
        if message is None:
            return
        payload, properties = message
        beside = properties.pairs() if self._gateway.config.properties else None
        self._client.send_stream(self._topics.state, payload, beside)

    def publish_status(self, final: bool = False) -> paho.MQTTMessageInfo | None:
        """Publish the status; where it cannot be made the gateway has failed, and publishes what is certain."""
        return self._send_status(lambda: self._run_guarded(self._document) or self._document_of_failure(), final)

    def is_status_due(self, answered: bool) -> bool:
        """Return whether to send the periodic status: in the pause after an answer, because it takes part of a cycle to make."""
        if answered:
            self._received_at = self.now
        return self.now >= self._due_at and (answered or self.now - self._received_at >= QUIET)

    def _send_status(self, document: Callable[[], dict], final: bool = False) -> paho.MQTTMessageInfo | None:
        self._due_at = self.now + _STATUS_PERIOD
        if self._stops is not None:
            self._stops.save(self._gateway.stopped or self.failure)
        if not self.polled.connected:
            return None
        status = document() | {"connection": self._number}
        if final:
            status |= {"state": "offline", "reason": Sentence("gateway stopped")}
        status["said"] = templates_of(status)
        return self._client.publish(self._topics.status, json.dumps(status), qos=1, retain=True)

    def _document(self) -> dict:
        status = self._gateway.status() | {"reply_us": self._reply_time.summary()}
        # the gateway's own state may be what has failed
        return status | {"state": State.FAILED.value, "reason": self.failure, "fault": True} if self.failure else status

    def _document_of_failure(self) -> dict:
        gateway, config = self._gateway, self._gateway.config
        return {
            "state": State.FAILED.value,
            "reason": self.failure,
            "session": "",
            "fault": True,
            "fault_number": gateway.fault_number,
            "mode": gateway.mode.value,
            "run": gateway.run,
            "protocol": PROTOCOL,
            "hash": config.hash,
            "decimals": config.decimals,
            "properties": config.properties,
        }

    def log_line(self, level: int, kind: str, text: str) -> None:
        """Log a line, limited in rate by its kind."""
        more = self._lines.admit(kind, self.now)
        if more is not None:
            log.log(level, "%s: %s%s", kind, text, more)
