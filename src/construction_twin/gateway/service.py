"""rsi_gateway: MQTT <-> robot controller on the cell PC. Runs without ROS: ``python -m construction_twin.gateway --help``.

One thread, one select loop: the controller's datagrams first, then MQTT. An unexpected exception ends neither loop nor answers:
`GatewayService.guarded` hands the arm to the last resort, which brakes. Standard library and paho-mqtt only.
"""

from __future__ import annotations

import json
import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from paho.mqtt import client as paho

from construction_twin.controller.port import Encoder
from construction_twin.core.errors import PayloadError
from construction_twin.core.histogram import Histogram
from construction_twin.core.rate_limit import LineLimiter
from construction_twin.core.records import SPACED, dumped
from construction_twin.core.sentences import Sentence, told
from construction_twin.core.udp import receive
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.inbox import DRAIN_LIMIT, TelegramInbox
from construction_twin.gateway.states import State
from construction_twin.gateway.status import StatusClock
from construction_twin.gateway.stop_file import StopFile
from construction_twin.mqtt import requests
from construction_twin.mqtt.client import Broker, make_client, offline_word, subscriptions, unique_id
from construction_twin.mqtt.failures import ConnectionReport
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

_STATUS_PERIOD = 1.0
#: The slowest axis comes to rest from full speed in less than 1 s; a controller that went silent is not waited for [s].
_LONGEST_BRAKING = 3.0
#: The end of the program is sent for this long: a few telegrams, in case one of them is lost [s].
_LAST_STOP = 0.1
#: What is quoted of an exception in `status` [characters].
_LONGEST_FAILURE = 300

_Result = TypeVar("_Result")
#: Until the failure's own sentence is made: nothing is computed while it is taken note of.
_FAILED = Sentence("the gateway has failed")


class GatewayService:
    """Sockets around a Gateway.

    Args:
        sock: Bound UDP socket.
        controller: Only datagrams from this IPv4 address are read; None reads any.
        run, commissioning, measures: See `Gateway`.
        stops: Keeps a stop beyond this run; None: it is forgotten.
    """

    def __init__(
        self,
        config: GatewayConfig,
        sock: socket.socket,
        broker: Broker,
        topics: Topics,
        run: str,
        controller: str | None = None,
        commissioning: bool = False,
        measures: bool = True,
        stops: StopFile | None = None,
    ):
        self.gateway = Gateway(config, run, commissioning, measures, stops.found if stops is not None else "")
        self._stops = stops
        self.reply_time = Histogram.of_microseconds()
        #: What failed, in one sentence; "" while nothing has.
        self.failure = ""
        self._sock = sock
        self._inbox = TelegramInbox(self.gateway, self._receive, time.monotonic_ns, controller)
        self._topics = topics
        make = config.make
        self._encoder = make.encoder(config) if config.layout.answered else None
        self._last_resort = make.last_resort(config)
        self._parse = make.reader(config).parse
        # the datagram read last, and its source
        self._datagram: tuple[bytes, tuple] | None = None
        self._thread_failure: BaseException | None = None
        # what failed, until it has been told
        self._cause: BaseException | None = None
        self._selector = selectors.DefaultSelector()
        self._selector.register(sock, selectors.EVENT_READ, None)
        # a last will may come late, when another run, or this one over another connection, speaks already: it says whose it is
        self._number = 1
        client = make_client(broker, unique_id(topics.robot, "gateway"), topics.status, offline_word(run, self._number))
        self._connection = ConnectionReport(broker, self._say_connection)
        # guarded here, because paho would handle a message again whose callback raised
        client.on_connect = partial(self.guarded, self._on_connect)
        client.on_disconnect = partial(self.guarded, self._on_disconnect)
        client.on_stream(self._topics.command, partial(self.guarded, self._on_command))
        client.message_callback_add(self._topics.control, partial(self.guarded, self._on_control))
        client.message_callback_add(self._topics.stop_by("+"), partial(self.guarded, self._on_stop))
        client.connect_async(broker.host, broker.port, broker.keepalive)
        self._mqtt = PolledClient(client, self._selector, self._connection.failed)
        self._state_properties = broker.protocol == "5"
        self._status = StatusClock(_STATUS_PERIOD)
        self._lines = LineLimiter()
        self._speed_answer: tuple = ()
        self._held_channels: tuple[bool, ...] = ()
        # state and reason in the log, whether a silent source and a clock that is off are
        self._logged: tuple[State | None, str, bool, bool] = None, "", False, False
        self._running = True

    def run(self) -> None:
        """Serve until `stop` is called; then bring the arm to rest before answering ends, because HOLDON would stop it dead.

        Where a reply can, the controller's program is ended too: a controller left alone would report a timeout.
        """
        try:
            while self._running:
                self._turn()
            self.guarded(self.gateway.end, Sentence("the gateway is ending"), True)
            self._last_resort.ending = self.gateway.config.layout.stop
            deadline = time.monotonic() + _LONGEST_BRAKING
            while self._braking and time.monotonic() < deadline:
                self._turn()
            deadline = time.monotonic() + _LAST_STOP
            while self._ends and time.monotonic() < deadline:
                self._turn()
        finally:
            self.guarded(self._tell_failure)
            self.guarded(self._publish_status, True)
            self.guarded(self._mqtt.close)
            if self._stops is not None:
                self.guarded(self._stops.close)
            self._sock.close()

    def stop(self) -> None:
        """Make `run` brake and return; safe in a signal handler."""
        self._running = False

    @property
    def _braking(self) -> bool:
        return not self._last_resort.at_rest if self.failure else self.gateway.state is State.BRAKING

    @property
    def _ends(self) -> bool:
        return self._last_resort.ends if self.failure else self.gateway.ends

    # -- failure

    def guarded(self, part: Callable[..., _Result], *arguments: object) -> _Result | None:
        """Return what a part of the gateway returns; None after an unexpected exception, when the gateway has failed.

        The gateway loop's only handler for every exception: without it one error in a status message would end the answers, and the
        controller would stop the arm dead from full speed.
        """
        try:
            return part(*arguments)
        except Exception as error:  # noqa: BLE001 (the arm brakes and holds, whatever it is)
            self._fail(error)
            return None

    def on_thread_failure(self, arguments: threading.ExceptHookArgs) -> None:
        """Take an exception that ended another thread, as `threading.excepthook`; the loop takes it in its next turn."""
        if arguments.exc_value is not None:
            self._thread_failure = arguments.exc_value
        # to stderr as well: the thread that has ended may be the one that writes the log
        threading.__excepthook__(arguments)

    def _fail(self, error: BaseException) -> None:
        if self.failure:
            # said once; whatever else fails after that changes nothing any more
            self.gateway.counters["failures"] += 1
            return
        self._last_resort.take_over()
        self.failure = _FAILED
        self.gateway.counters["failures"] += 1
        # told after the next reply: the controller waits neither for a sentence nor for a log line
        self._cause = error

    def _tell_failure(self) -> None:
        error, self._cause = self._cause, None
        if error is None:
            return
        frame = error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        where = f" in {frame.tb_frame.f_code.co_name}" if frame is not None else ""
        what = f"{type(error).__name__}{where}: {error}"[:_LONGEST_FAILURE]
        self.failure = Sentence(
            "{what}; the gateway has failed: it brakes, holds and takes no command; see its log, start it again",
            what=what,
        )
        # a thread of its own, because a traceback is formatted from source files, and a disk may take longer than a cycle
        threading.Thread(
            target=log.critical, args=("%s", self.failure), kwargs={"exc_info": error}, daemon=True
        ).start()
        self.gateway.fail(self.failure)

    def _rescue(self) -> None:
        """Answer the controller as the last resort, then report the arm's pose as far as that works."""
        resort = self._last_resort
        newest, waiting = None, self._datagram
        self._datagram = None
        for _ in range(DRAIN_LIMIT):
            if waiting is not None:
                stamp = resort.stamp_of(*waiting)
                if stamp is not None and (newest is None or resort.is_newer(stamp, newest[0])):
                    newest = stamp, *waiting
            try:
                data, _, source = receive(self._sock)
            except OSError:
                # nothing more waits, or the system reports what became of an earlier reply
                break
            waiting = data, source
        if newest is None:
            return
        stamp, data, source = newest
        lost = resort.note_missed(stamp, data)
        reply = resort.answer(stamp)
        if reply is not None:
            self._answer(reply, source)
        self.gateway.observe(self._parse(data), resort.target, lost)
        self._publish_state()

    # -- the loop

    def _turn(self) -> None:
        events: list | None = []
        if not self.failure:
            self.guarded(self._work)
        else:
            events = self.guarded(self._wait)
        if self.failure:
            self.guarded(self._rescue)
            self.guarded(self._tell_failure)
            if events is None:
                # a selector that fails must neither take the whole processor nor silence MQTT
                time.sleep(0.001)
            if self._mqtt.connected if events is None else self._is_readable(events):
                self.guarded(self._mqtt.read)
            self.guarded(self._mqtt.service, time.monotonic())
            self.guarded(self._report_failure)

    def _wait(self) -> list:
        # what TLS has decrypted already makes no socket readable
        return self._selector.select(0.0 if self._mqtt.pending else 0.05)

    def _work(self) -> None:
        events = self._wait()
        if self._thread_failure is not None:
            raise self._thread_failure
        answered = self._serve_controller()
        if self._is_readable(events):
            self._mqtt.read()
        now = time.monotonic()
        self._mqtt.service(now)
        self.gateway.poll(time.monotonic_ns())
        if self.gateway.take_change():
            self._log_change()
            self._publish_status()
        elif self._status.is_due(now, answered):
            self._publish_status()
        if self.gateway.side_effects.unwritten:
            # a thread of its own, as of a failure: a traceback is formatted from source files
            told = log.error, self.gateway.side_effects.take()
            threading.Thread(target=self.gateway.side_effects.write, args=told, daemon=True).start()

    def _is_readable(self, events: list) -> bool:
        return any(key.data is self._mqtt and mask & selectors.EVENT_READ for key, mask in events)

    def _report_failure(self) -> None:
        if self.gateway.take_change() or self._status.is_due(time.monotonic(), True):
            self._publish_status()

    def _log_change(self) -> None:
        gateway = self.gateway
        limit_silent, clock_off = gateway.commands.speed.source == "silence", bool(gateway.clock.off_sentence)
        state, reason, was_silent, was_off = self._logged
        self._logged = gateway.state, gateway.reason, limit_silent, clock_off
        if (gateway.state, gateway.reason) != (state, reason):
            # what cannot be read is logged under its own key; otherwise the rate limit would suppress the line after
            # 'controller gone'
            unread = state is gateway.state is State.NO_CONTROLLER and gateway.refusals.unread > 0
            wrong = unread or gateway.state is State.OTHER_CYCLE
            kind = "no telegram can be read" if unread else gateway.state.value
            self._log(logging.WARNING if wrong else logging.INFO, kind, gateway.reason)
        if clock_off != was_off:
            level = logging.WARNING if clock_off else logging.INFO
            self._log(level, "controller's clock", gateway.clock.off_sentence or "nothing is wrong with it any more")
        if limit_silent and not was_silent:
            text = f"its source is silent; {gateway.commands.speed.given:g} of the limits until it speaks"
            self._log(logging.WARNING, "speed limit", text)

    def _log(self, level: int, kind: str, text: str) -> None:
        note = self._lines.note(kind, time.monotonic_ns())
        if note is not None:
            log.log(level, "%s: %s%s", kind, text, note)

    # -- the controller

    def _receive(self) -> tuple[bytes, int, tuple]:
        data, arrived, source = datagram = receive(self._sock)
        self._datagram = data, source
        return datagram

    def _serve_controller(self) -> bool:
        """Answer the newest telegram; return whether there was one."""
        newest = self._inbox.newest()
        if newest is None:
            return False
        telegram, source = newest.telegram, newest.source
        carried = self.gateway.on_telegram(telegram, source, time.monotonic_ns())
        if carried is not None and self._encoder is not None:
            stop = True if self.gateway.ends else None
            switched = self._switched(self._encoder) if self.gateway.tool is not None else ()
            self._answer(self._encoder.encode(carried, telegram.controller_ms, stop, switched), source)
            self._last_resort.sent(
                telegram.controller_ms, source, carried, self.gateway.controller.kept, telegram.missed
            )
            self.reply_time.add((time.time_ns() - newest.arrived) / 1e3)
        self._publish_state()
        return True

    def _switched(self, encoder: Encoder) -> tuple[bool, ...]:
        """Return what a reply tells the tool's outputs; the last resort goes on with it."""
        assert self.gateway.tool is not None
        holding = self.gateway.tool.channels()
        if holding is not self._held_channels:
            self._held_channels = holding
            ending = encoder.template(True, self.gateway.tool.channels(ending=True))
            self._last_resort.hold(encoder.template(None, holding), ending)
        return self.gateway.tool.channels(ending=True) if self.gateway.ends else holding

    def _answer(self, reply: bytes, source: tuple) -> None:
        try:
            self._sock.sendto(reply, source)
        except OSError as error:
            self.gateway.counters[f"udp_send_{error.errno}"] += 1

    # -- MQTT

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected(client, properties)
        log.info("connected to the broker")
        topics = [(self._topics.command, 0), (self._topics.control, 1), (self._topics.stop_by("+"), 1)]
        client.subscribe(subscriptions(client, topics))
        info = self._publish_status()
        # the client sends again what was not acknowledged before: an older status, behind this one, would be the one that is kept
        self._status.hurry()
        if info is not None:
            self._connection.watch_publish(client, self._topics.status, info.mid)

    def _say_connection(self, sentence: str) -> None:
        # where all is ended together the broker may be gone first: nobody has to look after that
        log.log(logging.ERROR if self._running else logging.INFO, "%s", sentence)

    def _on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        self._connection.lost(reason_code)
        self._number += 1
        client.will_set(self._topics.status, offline_word(self.gateway.run, self._number), qos=1, retain=True)

    def _on_command(self, payload: bytes, pairs: list[tuple[str, str]], retained: bool) -> None:
        if retained:
            self._refuse_retained("command")
            return
        properties: CommandProperties | PayloadError | None
        try:
            properties = read_command_properties(pairs) if pairs else None
        except PayloadError as error:
            properties = error
        self.gateway.on_command(payload, properties, time.monotonic_ns())

    def _refuse_retained(self, name: str) -> None:
        why = f"a message on {name} with the retain flag: its age is unknown"
        self.gateway.refusals.message("retained", why)

    def _on_control(self, client, userdata, message: paho.MQTTMessage) -> None:
        if message.retain:
            self._refuse_retained("control")
            return
        try:
            control = parse_control(bytes(message.payload))
        except PayloadError as error:
            self.gateway.refusals.message(error.reason, error)
            self._log(logging.WARNING, f"refused on {error.reason}", str(error))
            return
        done = self.gateway.on_control(control, time.monotonic_ns())
        ok, reason = done.ok, done.reason
        if not reason:
            return
        if control.verb == "speed_limit":
            # repeated several times a second: only what is new is worth a line and an answer
            before, self._speed_answer = self._speed_answer, (control.session, ok, reason)
            if self._speed_answer == before:
                return
        verb = control.verb if control.verb in VERBS else "unknown verb"
        kind = verb if ok else f"refused {verb}"
        side_effects = self.gateway.side_effects
        # the status first: a reader of the answer must not act on an older status
        side_effects.run("the status", self._publish_status_of_stop if control.verb == "stop" else self._publish_status)
        answer = dumped(ControlAnswer(control.id, control.verb, ok, reason, control.session), SPACED, said=True)
        side_effects.run("the answer", self._publish_answer, self._topics.control_ack, answer)
        level = logging.INFO if ok else logging.WARNING
        side_effects.run("the log", self._log, level, kind, f"session {control.session}: {reason}")

    def _answer_stop(self, payload: bytes, known: dict[str, object]) -> None:
        self._publish_answer(self._topics.stop_ack, requests.STOP.payload(**identity_of(payload), **known))

    def _publish_answer(self, topic: str, answer: bytes) -> None:
        self._mqtt.client.publish(topic, answer, qos=1)

    def _on_stop(self, client, userdata, message: paho.MQTTMessage) -> None:
        now, account, payload = time.monotonic_ns(), "", bytes(message.payload)
        side_effects = self.gateway.side_effects
        try:
            account = account_of(message.topic)
            if not account:
                # an answer: this gateway's, or the executor's
                return
            stop = parse_intervention(account, payload, message.retain)
        except PayloadError as error:
            done = self.gateway.refuse_stop(account, error, now)
            line = logging.WARNING, f"refused on {error.reason}", str(error)
        else:
            done = self.gateway.on_stop(stop, now)
            line = logging.INFO, "stop by a person", f"account {account}: {done.reason or 'again'}"
        if done.reason:
            # the status first: a reader of the answer must not act on an older status
            side_effects.run("the status", self._publish_status_of_stop)
            known = {"account": account, "ok": done.ok, "reason": done.reason, "by": requests.GATEWAY}
            side_effects.run("the answer", self._answer_stop, payload, known)
        side_effects.run("the log", self._log, *line)

    def _publish_state(self) -> None:
        if not self._mqtt.connected:
            return
        message = self.gateway.state_message(time.monotonic_ns())
        if message is None:
            return
        payload, properties = message
        beside = properties.pairs() if self._state_properties else None
        self._mqtt.client.send_stream(self._topics.state, payload, beside)

    def _publish_status(self, final: bool = False) -> paho.MQTTMessageInfo | None:
        return self._send_status(lambda: self.guarded(self._document) or self._document_of_failure(), final)

    def _publish_status_of_stop(self) -> None:
        # not guarded: one that cannot be made is counted beside the stop, which the gateway itself carries out to its end
        self._send_status(self._document)

    def _send_status(self, document: Callable[[], dict], final: bool = False) -> paho.MQTTMessageInfo | None:
        self._status.sent(time.monotonic())
        if self._stops is not None:
            self._stops.keep(self.gateway.stopped or self.failure)
        if not self._mqtt.connected:
            return None
        status = document() | {"connection": self._number}
        if final:
            status |= {"state": "offline", "reason": Sentence("gateway stopped")}
        status["said"] = told(status)
        return self._mqtt.client.publish(self._topics.status, json.dumps(status), qos=1, retain=True)

    def _document(self) -> dict:
        status = self.gateway.status() | {"reply_us": self.reply_time.summary()}
        # said here once more, because the gateway's own state may be what has failed
        return status | {"state": State.FAILED.value, "reason": self.failure, "fault": True} if self.failure else status

    def _document_of_failure(self) -> dict:
        """Return a status of what is certain, because the one of the gateway cannot be put together."""
        gateway, config = self.gateway, self.gateway.config
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
