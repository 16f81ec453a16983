"""What stands on the ROS PC, in its smallest form: a planned stream at 250 Hz, and the bridge's own rules of who may move.

`LinkSupervisor` and `StateCheck` are the ones the bridge runs; gate and executor are a few lines. For the tests of faults: no ROS.
"""

from __future__ import annotations

import threading
import time
import uuid

import numpy as np
from impairment import hurry

from construction_twin.core.errors import PayloadError
from construction_twin.core.travel_time import StateCheck
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.gateway_status import parse_status
from construction_twin.link.observations import LinkState
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.fast_client import UserProperties
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Topics, read_state_properties
from construction_twin.mqtt.plain_client import received_pairs

#: The supervisor is asked every so many cycles, as in the bridge.
_POLL_CYCLES = 5
#: The bridge's `max_state_age` [s].
_MAX_STATE_AGE = 0.1


class Commander(threading.Thread):
    """Sends the pose it stands at, or the next one of a motion, every 4 ms.

    Args:
        port: Of the broker, on `host`.
        feedback_timeout: Without a state for this long a motion is held, as the gate does it [s]; None: whatever comes back, it
            goes on sending.

    Attributes:
        pose: What is commanded now [rad].
        outcome: Of the last motion: ``playing``, ``finished``, or why it was held.
        links: Every change of the link's state, with its reason.
        statuses: Every status of the gateway.
        states: States accepted.
        moved_at: When a state showed another pose than the one before [s, `time.monotonic`].
        longest_pause: Largest distance of two cycles of this thread: what the machine, not the network, did to the stream [s].
    """

    def __init__(
        self,
        port: int,
        topics: Topics,
        config: GatewayConfig,
        host: str = "127.0.0.1",
        feedback_timeout: float | None = None,
    ):
        super().__init__(name="commander", daemon=True)
        self.pose: tuple[float, ...] | None = None
        self.arm: tuple[float, ...] | None = None
        self.outcome = "nothing played yet"
        self.links: list[tuple[LinkState, str]] = []
        self.statuses: list[dict] = []
        self.states = self.refused = self.sent = 0
        self.moved_at: list[float] = []
        self.longest_pause = 0.0
        self._topics = topics
        self._timeout = feedback_timeout
        self._heard_at = time.monotonic()
        self._codec = JointStringCodec(len(config.axes), config.decimals)
        self._supervisor = LinkSupervisor(config, lambda: uuid.uuid4().hex)
        self._check = StateCheck(_MAX_STATE_AGE)
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._motion: np.ndarray | None = None
        self._next = 0
        self._session = ""
        self._client = make_client(Broker(host, port), unique_id(topics.robot, "commander"), topics.bridge_status)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.message_callback_add(topics.state, self._on_state)
        self._client.message_callback_add(topics.status, self._on_status)
        self._client.message_callback_add(topics.control_ack, self._on_answer)
        self._client.connect_async(host, port, 5)
        self._client.loop_start()

    # -- for the test

    @property
    def link(self) -> LinkState:
        """State of the link."""
        return self._supervisor.state

    @property
    def status(self) -> dict:
        """The gateway's last status."""
        return self.statuses[-1] if self.statuses else {}

    @property
    def playing(self) -> bool:
        """True while a motion is being sent."""
        return self._motion is not None

    def play(self, motion: np.ndarray) -> None:
        """Send these poses, shape (m, n) [rad], one per cycle; they begin where the stream stands."""
        with self._lock:
            self._motion, self._next, self.outcome = motion, 0, "playing"

    def reset(self) -> None:
        """Do what a person's `reset` does; ReviewError when it cannot be done now."""
        with self._lock:
            self._supervisor.request_reset(time.monotonic_ns())

    def close(self) -> None:
        """Stop sending and disconnect."""
        self._ended.set()
        self.join(5.0)
        self._client.disconnect()
        self._client.loop_stop()

    # -- the stream

    def run(self) -> None:
        """Send on a 4 ms grid; what was not sent in time is sent late, with its own stamp."""
        hurry()
        begin, epoch, cycle = time.monotonic_ns(), time.time_ns(), 0
        last = begin
        while not self._ended.is_set():
            now = time.monotonic_ns()
            self.longest_pause = max(self.longest_pause, (now - last) / NANOSECONDS)
            last = now
            due = begin + cycle * CYCLE_NS
            if now < due:
                time.sleep((due - now) / NANOSECONDS)
                continue
            self._cycle(cycle, epoch + cycle * CYCLE_NS)
            cycle += 1

    def _cycle(self, cycle: int, stamp: int) -> None:
        now = time.monotonic_ns()
        with self._lock:
            supervisor = self._supervisor
            control = supervisor.poll(now) if cycle % _POLL_CYCLES == 0 else None
            self._note_link()
            self._advance()
            send = self.pose is not None and supervisor.on_command(self.pose, now)
            session, pose = supervisor.session, self.pose
        if control is not None:
            self._client.publish(self._topics.control, control.to_json(), qos=1)
        if send:
            self.sent += 1
            beside = UserProperties(CommandProperties(session, self.sent, stamp).pairs())
            self._client.publish(self._topics.command, self._codec.encode(pose), properties=beside)

    def _advance(self) -> None:
        supervisor = self._supervisor
        if supervisor.session != self._session or self.pose is None:
            # a new session: the twin takes the arm's pose
            if self.arm is not None:
                self._session, self.pose = supervisor.session, self.arm
                self._hold("another session began")
            return
        if self._motion is None:
            return
        if supervisor.state is not LinkState.ARMED:
            self._hold(f"link is {supervisor.state.name}")
        elif self._timeout is not None and time.monotonic() - self._heard_at > self._timeout:
            self._hold("no feedback")
        elif self._next == len(self._motion):
            self._motion, self.outcome = None, "finished"
        else:
            self.pose = tuple(self._motion[self._next].tolist())
            self._next += 1

    def _hold(self, why: str) -> None:
        if self._motion is not None:
            self._motion, self.outcome = None, why

    def _note_link(self) -> None:
        supervisor = self._supervisor
        if not self.links or self.links[-1][0] is not supervisor.state:
            self.links.append((supervisor.state, supervisor.reason))

    # -- MQTT

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        client.subscribe([(self._topics.state, 0), (self._topics.status, 1), (self._topics.control_ack, 1)])
        with self._lock:
            self._supervisor.inputs.on_connection(True)

    def _on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        with self._lock:
            self._supervisor.inputs.on_connection(False)

    def _on_state(self, client, userdata, message) -> None:
        try:
            q = self._codec.decode(message.payload)
            properties = read_state_properties(received_pairs(message))
            self._check.accept(properties.seq, properties.stamp, time.monotonic_ns())
        except PayloadError:
            self.refused += 1
            return
        with self._lock:
            before, self.arm, self._heard_at = self.arm, q, time.monotonic()
            if before is not None and q != before:
                self.moved_at.append(self._heard_at)
            self.states += 1
            self._supervisor.inputs.on_pose(q, time.monotonic_ns())

    def _on_status(self, client, userdata, message) -> None:
        status = parse_status(message.payload)
        self.statuses.append(status)
        if status.get("state") == "offline":
            self._check.restart()
        with self._lock:
            self._supervisor.inputs.on_status(status, time.monotonic_ns())

    def _on_answer(self, client, userdata, message) -> None:
        with self._lock:
            self._supervisor.on_answer(parse_status(message.payload), time.monotonic_ns())
