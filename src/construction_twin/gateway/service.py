"""rsi_gateway: MQTT <-> robot controller on the cell PC. Runs without ROS: ``python -m construction_twin.gateway --help``.

One thread, one select loop: the controller's datagrams first, then MQTT. An unexpected exception ends neither loop nor answers:
`GatewayService.run_guarded` hands the arm to the last resort, which brakes. Standard library and paho-mqtt only.
"""

from __future__ import annotations

import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.controller_socket import ControllerSocket
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.mqtt_connection import MqttConnection
from construction_twin.gateway.states import State
from construction_twin.gateway.stop_file import StopFile
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.polled_client import PolledClient

log = logging.getLogger("rsi_gateway")

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
    """Sockets around a `Gateway`; `sock` is bound, `controller` the only address that is read."""

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
        self._sock = sock
        self.controller = ControllerSocket(self.gateway, sock, controller)
        self._thread_failure: BaseException | None = None
        # what failed, until it is published
        self._cause: BaseException | None = None
        self._selector = selectors.DefaultSelector()
        self._selector.register(sock, selectors.EVENT_READ, None)
        reply_time = self.controller.reply_time
        polled = partial(PolledClient, selector=self._selector)
        self.mqtt = MqttConnection(self.gateway, broker, topics, polled, self.run_guarded, stops, reply_time)
        # state and reason in the log, whether a silent source is
        self._logged: tuple[State | None, str, bool] = None, "", False
        self._running = True

    @property
    def failure(self) -> str:
        """The sentence of the gateway's failure; "" for none."""
        return self.mqtt.failure

    def run(self) -> None:
        """Serve until `stop` is called; then bring the arm to rest, and end the controller's program, before answering ends."""
        try:
            while self._running:
                self._run_once()
            self.run_guarded(self.gateway.end, Sentence("the gateway is ending"), True)
            gateway, resort = self.gateway, self.controller.last_resort
            resort.ending = gateway.config.layout.stop
            self._run_while(
                lambda: not resort.at_rest if self.failure else gateway.state is State.BRAKING, _LONGEST_BRAKING
            )
            self._run_while(lambda: resort.ends_program if self.failure else gateway.ends_program, _LAST_STOP)
        finally:
            self.run_guarded(self._publish_failure)
            self.run_guarded(self.mqtt.publish_status, True)
            self.run_guarded(self.mqtt.polled.close)
            if self._stops is not None:
                self.run_guarded(self._stops.close)
            self._sock.close()

    def _run_while(self, goes_on: Callable[[], bool], longest: float) -> None:
        deadline = time.monotonic() + longest
        while goes_on() and time.monotonic() < deadline:
            self._run_once()

    def stop(self) -> None:
        """Make `run` brake and return; safe in a signal handler."""
        self._running, self.mqtt.ending = False, True

    # -- failure

    def run_guarded(self, part: Callable[..., _Result], *arguments: object) -> _Result | None:
        """Return what a part returns; None after an unexpected exception, when the gateway has failed and the arm brakes."""
        try:
            return part(*arguments)
        except Exception as error:  # noqa: BLE001 (the arm brakes and holds, whatever it is)
            self._fail(error)
            return None

    def on_thread_failure(self, arguments: threading.ExceptHookArgs) -> None:
        """Store the exception of another thread, as `threading.excepthook`, for the loop's next turn."""
        if arguments.exc_value is not None:
            self._thread_failure = arguments.exc_value
        # to stderr as well: the thread that has ended may be the one that writes the log
        threading.__excepthook__(arguments)

    def _fail(self, error: BaseException) -> None:
        if self.failure:
            self.gateway.counters["failures"] += 1
            return
        self.controller.last_resort.begin()
        self.mqtt.failure = _FAILED
        self.gateway.counters["failures"] += 1
        # published after the next reply: the controller waits for no sentence and no log line
        self._cause = error

    def _publish_failure(self) -> None:
        error, self._cause = self._cause, None
        if error is None:
            return
        what = f"{type(error).__name__}: {error}"[:_LONGEST_FAILURE]
        self.mqtt.failure = Sentence(
            "{what}; the gateway has failed: it brakes, holds and takes no command; see its log, start it again",
            what=what,
        )
        # a thread of its own, because a traceback is formatted from source files, and a disk may take longer than a cycle
        threading.Thread(
            target=log.critical, args=("%s", self.failure), kwargs={"exc_info": error}, daemon=True
        ).start()
        self.gateway.fail(self.failure)

    # -- the loop

    def _run_once(self) -> None:
        """Serve controller and MQTT once; everything in a turn happens at its one `now`."""
        events: list | None = []
        if not self.failure:
            self.run_guarded(self._serve_once)
        else:
            events = self.run_guarded(self._wait)
        if self.failure:
            self.mqtt.now = time.monotonic_ns()
            if self.run_guarded(self.controller.answer_as_last_resort):
                self.run_guarded(self.mqtt.publish_state, self.mqtt.now)
            self.run_guarded(self._publish_failure)
            if events is None:
                # a selector that fails must neither take the whole processor nor silence MQTT
                time.sleep(0.001)
            polled = self.mqtt.polled
            if polled.connected if events is None else self._is_readable(events):
                self.run_guarded(polled.read)
            self.run_guarded(polled.service, self.mqtt.now / NANOSECONDS)
            self.run_guarded(self._publish_status, True)

    def _wait(self) -> list:
        # what TLS has decrypted already makes no socket readable
        return self._selector.select(0.0 if self.mqtt.polled.pending else 0.05)

    def _serve_once(self) -> None:
        events = self._wait()
        if self._thread_failure is not None:
            raise self._thread_failure
        now = self.mqtt.now = time.monotonic_ns()
        answered = self.controller.serve(now)
        if answered:
            self.mqtt.publish_state(now)
        if self._is_readable(events):
            self.mqtt.polled.read()
        self.mqtt.polled.service(now / NANOSECONDS)
        self.gateway.poll(now)
        self._publish_status(answered)
        if self.gateway.side_effects.unwritten:
            # a thread of its own, as of a failure: a traceback is formatted from source files
            failed = log.error, self.gateway.side_effects.pop_failures()
            threading.Thread(target=self.gateway.side_effects.write, args=failed, daemon=True).start()

    def _is_readable(self, events: list) -> bool:
        return any(key.data is self.mqtt.polled and mask & selectors.EVENT_READ for key, mask in events)

    def _publish_status(self, answered: bool) -> None:
        """Publish the status when it has changed, or is due."""
        if self.gateway.pop_change():
            if not self.failure:
                self._log_change()
            self.mqtt.publish_status()
        elif self.mqtt.is_status_due(answered):
            self.mqtt.publish_status()

    def _log_change(self) -> None:
        gateway = self.gateway
        limit_silent = gateway.commands.speed.source == "silence"
        state, reason, was_silent = self._logged
        self._logged = gateway.state, gateway.reason, limit_silent
        if (gateway.state, gateway.reason) != (state, reason):
            # under its own key: otherwise the rate limit would suppress the line after 'controller gone'
            unread = state is gateway.state is State.NO_CONTROLLER and gateway.refusals.unread > 0
            wrong = unread or gateway.state is State.OTHER_CYCLE
            kind = "no telegram can be read" if unread else gateway.state.value
            self.mqtt.log_line(logging.WARNING if wrong else logging.INFO, kind, gateway.reason)
        if limit_silent and not was_silent:
            text = f"its source is silent; {gateway.commands.speed.requested:g} of the limits until it speaks"
            self.mqtt.log_line(logging.WARNING, "speed limit", text)
