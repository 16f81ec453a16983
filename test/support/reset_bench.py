"""The real gateway and the bridge's real rules with messages that travel between them, on one simulated clock.

What a person does (reset, stop) happens at a time that the test chooses, anywhere in the exchange of messages.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

from gateway_cell import START, Cell

from construction_twin.core.errors import ReviewError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.link.gateway_status import GatewayAnswer, GatewayStatus, read
from construction_twin.link.observations import LinkState
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.mqtt.messages import Control, Intervention

MS = NANOSECONDS // 1000
#: Cycles between two polls of the bridge, as in its node.
POLL_CYCLES = 5
#: Period of the gateway's status [ns].
STATUS = NANOSECONDS


class ResetBench:
    """A gateway, its controller, the bridge's supervisor and a stream, with a broker between them that takes its time.

    Args:
        up, down: How long a message to the gateway, and one from it, travels [ns].
    """

    def __init__(self, up: int = 12 * MS, down: int = 17 * MS):
        self.cell = Cell()
        self.up, self.down = up, down
        ids = (f"id{number}" for number in itertools.count(1))
        self._make = lambda waits="": LinkSupervisor(self.cell.config, lambda: next(ids), waits=waits)
        self.supervisor = self._make()
        self.supervisor.inputs.on_connection(True)
        #: Control messages for which this returns True are lost on their way.
        self.loses: Callable[[Control], bool] = lambda control: False
        #: The same of answers to them.
        self.loses_answer: Callable[[Control], bool] = lambda control: False
        #: How much longer a control message takes than `up` [ns].
        self.extra: Callable[[Control], int] = lambda control: 0
        self.sent: list[Control] = []
        #: True while no command reaches the gateway.
        self.cut = False
        #: True while the twin stands where the arm is, so that a stream may begin.
        self.together = True
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._cycles = 0
        self._arrival = 0
        self._status_at = 0
        self._session = ""
        self._twin = START

    @property
    def now(self) -> int:
        return self.cell.now

    @property
    def gateway(self):
        return self.cell.gateway

    @property
    def link(self) -> LinkState:
        return self.supervisor.state

    @property
    def commands(self) -> bool:
        """Whether the gateway is armed for anybody."""
        return self.gateway.state in (State.ARMED, State.FOLLOWING)

    def at(self, time: int, action: Callable[[], None]) -> None:
        """Do something at a time [ns] of the clock."""
        heapq.heappush(self._events, (time, next(self._order), action))

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * NANOSECONDS / CYCLE_NS)):
            self.step()

    def run_until(self, condition: Callable[[], bool], seconds: float = 5.0) -> None:
        """Let time pass until a condition holds; AssertionError when it does not in time."""
        for _ in range(round(seconds * NANOSECONDS / CYCLE_NS)):
            if condition():
                return
            self.step()
        raise AssertionError(f"{self.link.name}: {self.supervisor.reason}; gateway {self.gateway.state.value}")

    def step(self) -> None:
        """Let 4 ms pass."""
        end = self.now + CYCLE_NS
        while self._events and self._events[0][0] <= end:
            _, _, action = heapq.heappop(self._events)
            action()
            self._tell_change()
        self.cell.cycle()
        self._tell_change()
        if self.now >= self._status_at + STATUS:
            self.tell()
        measured = self.cell.measured
        self.at(self.now + self.down, lambda: self.supervisor.inputs.on_pose(measured, self.now))
        self._command()
        self._cycles += 1
        if self._cycles % POLL_CYCLES == 0:
            control = self.supervisor.poll(self.now)
            if control is not None:
                self.send(control)

    def send(self, control: Control) -> None:
        """Send a control message of the bridge; those of one client arrive in their order."""
        self.sent.append(control)
        if self.loses(control):
            return
        self._arrival = max(self._arrival, self.now + self.up + self.extra(control))
        self.at(self._arrival, lambda: self._arrive(control))

    def _arrive(self, control: Control) -> None:
        answer = self.gateway.on_control(control, self.now)
        self.tell()
        told = GatewayAnswer(id=control.id, verb=control.verb, ok=answer.ok, reason=answer.reason)
        if not self.loses_answer(control):
            self.at(self.now + self.down, lambda: self.supervisor.on_answer(told, self.now))

    def tell(self) -> None:
        """Send the gateway's status."""
        self._status_at, status = self.now, read(GatewayStatus, self.gateway.status())
        self.at(self.now + self.down, lambda: self.supervisor.inputs.on_status(status, self.now))

    def _tell_change(self) -> None:
        if self.gateway.pop_change():
            self.tell()

    def _command(self) -> None:
        if self.supervisor.session != self._session:
            # the twin takes the arm's pose with every new session
            self._session, self._twin = self.supervisor.session, self.cell.measured
        pose = self._twin if self.together else (self._twin[0] + 0.1, self._twin[1])
        if self.supervisor.on_command(pose, self.now) and not self.cut:
            session = self.supervisor.session
            self.cell.stamp += CYCLE_NS
            self.cell.seq += 1
            seq, stamp = self.cell.seq, self.cell.stamp
            self.at(self.now + self.up, lambda: self._take(pose, session, seq, stamp))

    def _take(self, pose, session: str, seq: int, stamp: int) -> None:
        before = self.cell.stamp, self.cell.seq
        self.cell.send(pose, session, stamp, seq)
        self.cell.stamp, self.cell.seq = before

    # what people do

    def reset(self) -> None:
        """Call `reset`, as soon as the bridge does not refuse it for a pose that it has not seen at rest."""
        for _ in range(200):
            try:
                self.supervisor.request_reset(self.now)
            except ReviewError:
                self.step()
            else:
                return
        self.supervisor.request_reset(self.now)

    def stop_by_account(self) -> None:
        """Stop the gateway by `stop/anna`, which the bridge does not hear."""
        self.gateway.on_stop(Intervention("anna", "1"), self.now)

    def stop_by_verb(self) -> None:
        """Stop the gateway by `control`, as another program may."""
        self.gateway.on_control(Control(f"foreign{next(self._order)}", "foreign", "stop"), self.now)

    def halt(self) -> None:
        """Call the bridge's `halt`, as the node carries it out."""
        self.supervisor.halt("stopped at the gateway on request; call reset")
        self.send(Control(f"halt{next(self._order)}", self.supervisor.session, "stop"))

    def restart_gateway(self, farewell: bool = True) -> None:
        """Kill the gateway and start it again, as another run; the broker says so unless it is not to give a `farewell`."""
        if farewell:
            word = GatewayStatus(state="offline", reason="connection lost", run=self.gateway.run)
            self.at(self.now + self.down, lambda: self.supervisor.inputs.on_status(word, self.now))
        self.cell.gateway = Gateway(self.cell.config, f"run{next(self._order) + 2}")
        self._status_at = self.now

    def restart_bridge(self) -> None:
        """Kill the bridge and start it again: it knows nothing but why its predecessor waited for a person."""
        self.supervisor = self._make(self.supervisor.waits_for)
        self.supervisor.inputs.on_connection(True)
        self._session = ""
        self.tell()

    def arm(self) -> ResetBench:
        """Run until the link is armed and its stream is followed."""
        self.run_until(lambda: self.link is LinkState.ARMED and self.gateway.state is State.FOLLOWING)
        self.run(1.0)
        return self

    def stopped(self) -> ResetBench:
        """Run until the link is armed, and then stopped by a person, which everybody knows."""
        self.arm()
        self.stop_by_account()
        self.run(1.5)
        assert self.link is LinkState.NEEDS_RESET and self.gateway.state is State.HOLDING
        return self
