"""A reset clears what was shown when a person asked for it, and nothing that came later: with the real gateway, at every moment.

The real gateway and the bridge's real rules, with messages that travel between them, on one simulated clock. What a person does
(reset, stop) happens at a time that the test chooses, anywhere in the exchange of messages.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

import pytest
from gateway_cell import START, Cell
from supervisor_bench import Bench

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
        self.run(0.4)
        return self

    def stopped(self) -> ResetBench:
        """Run until the link is armed, and then stopped by a person, which everybody knows."""
        self.arm()
        self.stop_by_account()
        self.run(0.5)
        assert self.link is LinkState.NEEDS_RESET and self.gateway.state is State.HOLDING
        return self


#: How long a stop is watched that must not be taken back [s].
WATCHED = 3.0
STOPS = {"stop/anna": ResetBench.stop_by_account, "control": ResetBench.stop_by_verb, "halt": ResetBench.halt}

#: Why the gateway is stopped after `stop/anna`.
STOPPED_BY_ANNA = "stop: asked for by account anna"


def begun(situation: str) -> ResetBench:
    bench = ResetBench()
    return bench.stopped() if situation == "stopped" else bench.arm()


def assert_stands(bench: ResetBench, seconds: float = WATCHED, fault: bool = True) -> None:
    """From now on the gateway is not armed, and the link neither, until a person resets again; and then it is."""
    told = bench.now + 2 * (bench.up + bench.down) + 100 * MS
    end = bench.now + round(seconds * NANOSECONDS)
    while bench.now < end:
        bench.step()
        assert not bench.commands, "a person's stop was taken back"
        assert bench.now < told or bench.link is not LinkState.ARMED
    assert bench.gateway.fault is fault and bench.link is LinkState.NEEDS_RESET
    assert_a_reset_arms(bench)


def assert_a_reset_arms(bench: ResetBench) -> None:
    bench.reset()
    bench.run_until(lambda: bench.link is LinkState.ARMED and bench.commands)


def stop_and_watch(bench: ResetBench, route: str, late: int) -> None:
    """Stop in `late` ns, and watch that it stands; some moments for longer, because each costs time."""
    bench.at(bench.now + late, lambda: STOPS[route](bench))
    bench.run(late / NANOSECONDS)
    # it is on its way to the gateway
    bench.run((bench.up + 8 * MS) / NANOSECONDS)
    assert_stands(bench, 0.7 if late % (100 * MS) else WATCHED)


class TestEveryMoment:
    """From the call, over reset sent, received, accepted, arm sent and accepted, to the stream: every 30 ms, polls every 20 ms."""

    @pytest.mark.parametrize("situation", ["stopped", "armed"])
    @pytest.mark.parametrize("route", sorted(STOPS))
    def test_a_stop_after_the_call_stands(self, situation, route):
        for late in range(0, 800 * MS, 30 * MS):
            bench = begun(situation)
            bench.reset()
            stop_and_watch(bench, route, late)

    @pytest.mark.parametrize("route", sorted(STOPS))
    def test_it_stands_too_while_a_session_begins_without_a_person(self, route):
        for late in range(0, 1200 * MS, 50 * MS):
            bench = begun("armed")
            bench.cut = True
            bench.run_until(lambda bench=bench: bench.gateway.state is State.BRAKING)
            bench.cut = False
            stop_and_watch(bench, route, late)

    @pytest.mark.parametrize("route", sorted(STOPS))
    def test_it_stands_too_after_the_end_of_mirror_mode(self, route):
        for late in range(0, 600, 40):
            bench = begun("armed")
            bench.supervisor.begin_mirror(bench.now)
            bench.run(1.0)
            assert bench.link is LinkState.MIRROR and not bench.commands
            bench.supervisor.end_mirror(bench.now)
            stop_and_watch(bench, route, late * MS)

    @pytest.mark.parametrize("route", ["stop/anna", "control"])
    @pytest.mark.parametrize("early", range(-4, 61, 4))
    def test_a_stop_before_the_call_is_cleared_only_if_it_was_shown_by_then(self, route, early):
        bench = begun("stopped")
        STOPS[route](bench)
        bench.run(early / 1000)
        shown = bench.supervisor.inputs.status.fault_number == bench.gateway.fault_number
        assert shown == (early * MS >= bench.down) or early in (16, 20)
        bench.reset()
        if shown:
            bench.run_until(lambda: bench.link is LinkState.ARMED)
        else:
            bench.run(0.1)
            assert_stands(bench)

    @pytest.mark.parametrize("lost", ["first reset", "first answer", "first arm", "answer to arm"])
    @pytest.mark.parametrize("late", range(0, 1400, 100))
    def test_what_is_sent_again_clears_no_stop_that_came_between(self, lost, late):
        bench = begun("stopped")
        verb, dropped = ("arm" if "arm" in lost else "reset"), []

        def loses(control) -> bool:
            if control.verb == verb and not dropped:
                dropped.append(control)
            return control in dropped

        if "answer" in lost:
            bench.loses_answer = loses
        else:
            bench.loses = loses
        bench.reset()
        stop_and_watch(bench, "stop/anna", late * MS)


class TestNumbers:
    def test_a_reset_of_an_older_stop_is_refused_by_number_whoever_sends_it(self):
        cell = begun("stopped").cell
        older = cell.resetting
        assert cell.gateway.status()["fault_number"] == older["fault_number"] == 1
        cell.gateway.stop("again")
        ok, reason = cell.control("reset", value=older)
        assert not ok and "fault_number 1, the last stop is number 2" in reason and cell.gateway.fault
        for value in (None, 2, {"fault_number": 2}, older | {"fault_number": 3}, older | {"fault_number": True}):
            assert not cell.control("reset", value=value or {})[0]
        assert not cell.control("reset", value=cell.resetting | {"run": "run0"})[0]
        assert not cell.control("reset", value=cell.resetting | {"x": 1})[0] and cell.gateway.fault
        assert cell.control("reset", value=cell.resetting)[0] and not cell.gateway.fault

    def test_silence_has_no_number_and_what_it_stopped_goes_on_by_itself(self):
        bench = begun("armed")
        bench.cut = True
        bench.run_until(lambda: bench.gateway.state is State.HOLDING)
        bench.cut = False
        bench.run_until(lambda: bench.link is LinkState.ARMED and bench.commands)
        assert bench.gateway.fault_number == 0

    def test_the_number_is_in_the_sentence_that_a_person_reads(self):
        bench = begun("stopped")
        assert "(stop 1)" in bench.supervisor.reason
        bench.stop_by_account()
        bench.run(0.5)
        assert "(stop 2)" in bench.supervisor.reason

    def test_a_person_whose_request_became_void_reads_why(self):
        bench = begun("stopped")
        bench.reset()
        bench.stop_by_account()
        bench.run(0.5)
        assert bench.supervisor.reason == (
            f"gateway was stopped since the call (stop 2): {STOPPED_BY_ANNA}; call reset"
        )

    def test_an_old_status_that_is_sent_again_shows_nothing_old(self):
        bench = begun("armed")
        old = read(GatewayStatus, bench.gateway.status())
        bench.stop_by_account()
        bench.run(1.0)
        assert bench.supervisor.inputs.on_status(old, bench.now).startswith("an old status, of stop 0 after stop 1")
        bench.supervisor.poll(bench.now)
        assert bench.link is LinkState.NEEDS_RESET and bench.supervisor.inputs.status.fault


class TestRestart:
    """Numbers belong to a run: what a gateway forgets when it is started again, the bridge does not."""

    @pytest.mark.parametrize("farewell", [True, False])
    def test_a_stop_outlasts_the_gateway_that_was_stopped(self, farewell):
        bench = begun("stopped")
        bench.restart_gateway(farewell)
        bench.run(1.0 if farewell else 5.0)
        assert "before it was started again (stop: asked for by account anna)" in bench.supervisor.reason
        assert_stands(bench, fault=False)

    @pytest.mark.parametrize("farewell", [True, False])
    def test_a_stop_outlasts_gateway_and_bridge_one_after_the_other(self, farewell):
        bench = begun("stopped")
        bench.restart_gateway(farewell)
        bench.run(1.0 if farewell else 5.0)
        bench.restart_bridge()
        bench.run(1.0)
        assert STOPPED_BY_ANNA in bench.supervisor.reason
        assert_stands(bench, fault=False)

    def test_a_bridge_that_is_started_again_says_what_the_gateway_says_of_the_stop(self):
        bench = begun("stopped")
        before = bench.supervisor.reason
        bench.restart_bridge()
        bench.run(1.0)
        assert bench.supervisor.reason == before and "(stop 1)" in before
        assert_stands(bench)

    @pytest.mark.parametrize("number", [0, 1])
    def test_a_program_that_failed_before_it_could_number_that_is_a_stop_too(self, number):
        scripted = Bench()
        scripted.gateway["fault_number"] = number
        scripted.run(1.0)
        assert scripted.state is LinkState.ARMED
        scripted.gateway |= {"state": "failed", "reason": "KeyError in poll", "fault": True, "session": ""}
        scripted.run(0.5)
        assert scripted.state is LinkState.NEEDS_RESET
        scripted.gateway |= {"state": "ready", "reason": "", "fault": False, "fault_number": 0, "run": "run2"}
        scripted.supervisor.inputs.on_status(
            GatewayStatus(state="offline", reason="connection lost", run="run1"), scripted.now
        )
        scripted.run(5.0)
        assert scripted.state is LinkState.NEEDS_RESET and "KeyError in poll" in scripted.supervisor.reason
        scripted.supervisor.request_reset(scripted.now)
        scripted.run(1.0)
        assert scripted.state is LinkState.ARMED

    @pytest.mark.parametrize("farewell", [True, False])
    @pytest.mark.parametrize("late", range(0, 200, 20))
    def test_a_reset_that_a_restart_overtakes_clears_nothing(self, late, farewell):
        bench = begun("stopped")
        bench.reset()
        bench.run(late / 1000)
        cleared = not bench.gateway.fault
        bench.restart_gateway(farewell)
        bench.run(1.0 if farewell else 5.0)
        if cleared:
            # what a person had reset is reset, and nothing has stopped the arm since
            assert_a_reset_arms(bench)
        else:
            assert_stands(bench, fault=False)

    def test_the_end_of_the_program_is_no_stop_of_anybody_s(self):
        bench = begun("armed")
        bench.gateway.end("the gateway is ending", True)
        bench.run(1.0)
        assert bench.gateway.fault and bench.gateway.fault_number == 0
        bench.restart_gateway()
        bench.run_until(lambda: bench.link is LinkState.ARMED and bench.commands)

    def test_the_end_of_the_program_takes_no_stop_back(self):
        bench = begun("stopped")
        bench.gateway.end("the gateway is ending", True)
        bench.run(1.0)
        bench.restart_gateway()
        bench.run(1.0)
        assert_stands(bench, fault=False)


class TestWithdrawal:
    """What was answered as failed does not happen later without a person."""

    @staticmethod
    def failed(bench: ResetBench, seconds: float = 5.0) -> None:
        """Call `reset` while the twin stands elsewhere; it is answered as failed, as the node does."""
        bench.reset()
        bench.run_until(lambda: bench.link is LinkState.RESYNC)
        bench.together = False
        bench.run(seconds)
        bench.supervisor.withdraw(bench.supervisor.requests, "not armed within 5 s: RESYNC")
        bench.together = True

    @pytest.mark.parametrize("situation", ["first session", "armed", "stopped"])
    def test_nothing_is_armed_until_a_person_resets_again(self, situation):
        bench = ResetBench() if situation == "first session" else begun(situation)
        if situation == "first session":
            bench.together = False
            bench.run(1.0)
            assert bench.link is LinkState.RESYNC
        self.failed(bench)
        bench.run(0.2)
        assert bench.supervisor.reason == "not armed within 5 s: RESYNC; call reset"
        assert not bench.supervisor.withdraws
        assert_stands(bench, 10.0)

    @pytest.mark.parametrize("interruption", ["bridge", "gateway", "controller"])
    def test_not_by_an_interruption_of_the_link_either(self, interruption):
        bench = begun("armed")
        self.failed(bench)
        bench.run(0.5)
        if interruption == "bridge":
            bench.restart_bridge()
        elif interruption == "gateway":
            bench.restart_gateway()
        else:
            # the controller's program is started again
            bench.cell.ipoc += 100_000
        assert_stands(bench, 10.0, fault=interruption != "gateway")

    @pytest.mark.parametrize("ended", ["withdrawn", "halted"])
    def test_nor_by_a_bridge_that_is_started_again_before_the_gateway_has_heard_of_it(self, ended):
        bench = begun("armed")
        bench.loses = lambda control: control.verb == "stop"
        if ended == "halted":
            bench.halt()
        else:
            self.failed(bench)
        bench.run(1.0)
        # what it had not sent yet dies with it
        bench.restart_bridge()
        bench.loses = lambda control: False
        assert not bench.gateway.fault
        assert_stands(bench, 10.0, fault=False)

    @pytest.mark.parametrize("late", range(0, 300, 20))
    def test_nor_by_a_bridge_that_ended_while_the_request_was_under_way(self, late):
        bench = begun("stopped")
        bench.reset()
        bench.run((late + 20) / 1000)
        armed = bench.link is LinkState.ARMED
        bench.restart_bridge()
        for _ in range(1000):
            bench.step()
            assert armed or bench.link in (LinkState.NEEDS_RESET, LinkState.DISCONNECTED)
            assert armed or bench.gateway.state is not State.FOLLOWING
        assert_a_reset_arms(bench)
        bench.restart_bridge()
        bench.run_until(lambda: bench.link is LinkState.ARMED)

    @pytest.mark.parametrize("lost", ["nothing", "answers to arm"])
    def test_an_arm_that_is_accepted_late_is_disarmed(self, lost):
        bench = begun("stopped")
        if lost == "nothing":
            # the way to the gateway is stalled from the first arm on; then everything comes at once
            stalled, arms = bench.now + 6 * NANOSECONDS, []

            def extra(control) -> int:
                arms.extend([control] if control.verb == "arm" else [])
                return max(0, stalled - bench.now) if arms else 0

            bench.extra = extra
        else:
            bench.loses_answer = lambda control: control.verb == "arm"
        bench.reset()
        bench.run(5.0)
        assert "arm" in [control.verb for control in bench.sent] and bench.link is LinkState.RESYNC
        bench.supervisor.withdraw(bench.supervisor.requests, "not armed within 5 s: RESYNC")
        armed = 0
        for _ in range(2500):
            bench.step()
            armed += bench.commands
            assert bench.link is LinkState.NEEDS_RESET
        # it was accepted, and held for no longer than the stop behind it took
        assert armed * 4 <= (bench.up + 40 * MS) // MS
        assert bench.gateway.counters["stops_stop"] >= 2
        bench.loses_answer = lambda control: False
        assert_stands(bench)

    def test_the_reason_of_a_stop_that_still_stands_is_kept_at_the_gateway(self):
        bench = begun("stopped")
        bench.loses = lambda control: control.verb == "reset"
        bench.reset()
        bench.run(0.7)
        bench.loses = lambda control: False
        bench.supervisor.on_answer(GatewayAnswer(id=bench.sent[-1].id, reason="the arm is still moving"), bench.now)
        bench.supervisor.withdraw(bench.supervisor.requests, "not armed within 5 s: RESYNC")
        bench.run(2.0)
        assert bench.gateway.status()["stop"]["by"] == "anna" and bench.gateway.fault_number == 1
        assert_stands(bench)

    def test_somebody_else_who_commands_is_not_stopped_by_it(self):
        bench = begun("armed")
        bench.supervisor.halt("stopped")
        bench.run(0.5)
        bench.cell.control("reset", "other")
        assert bench.cell.arm("other")[0]
        bench.reset()
        bench.loses = lambda control: control.verb != "stop"
        bench.run(1.0)
        bench.supervisor.withdraw(bench.supervisor.requests, "not armed within 5 s: RESYNC")
        bench.run(3.0)
        assert bench.gateway.command_session == "other" and not bench.gateway.fault
        assert bench.link is LinkState.NEEDS_RESET

    @pytest.mark.parametrize("waiting", ["halted", "failed before", "another process waited"])
    def test_nor_by_a_link_that_waited_for_a_person_already_and_was_not_polled_in_time(self, waiting):
        bench = begun("armed")
        if waiting == "halted":
            bench.halt()
        else:
            self.failed(bench)
        bench.run(0.5)
        if waiting == "another process waited":
            bench.restart_bridge()
        bench.run(0.5)
        # the poll waits for a socket until the answer is due, and then goes on
        bench.reset()
        bench.supervisor.withdraw(bench.supervisor.requests, "not armed within 5 s: NEEDS_RESET")
        assert_stands(bench, 10.0)

    def test_a_person_who_asked_meanwhile_is_not_concerned(self):
        bench = begun("stopped")
        bench.together = False
        bench.reset()
        first = bench.supervisor.requests
        bench.run(4.0)
        bench.reset()
        bench.run(1.0)
        bench.supervisor.withdraw(first, "not armed within 5 s: RESYNC")
        assert bench.link is LinkState.RESYNC
        bench.together = True
        bench.run_until(lambda: bench.link is LinkState.ARMED)


class TestWithdrawnBesideMirrorMode:
    """Mirror mode neither forgets what failed for a person, nor is ended by it."""

    @staticmethod
    def failing() -> ResetBench:
        """Return a stopped link whose `reset` has come as far as an `arm` that no answer followed, nor any status."""
        bench = begun("stopped")
        bench.loses = lambda control: control.verb in ("arm", "stop")
        bench.reset()
        bench.run_until(lambda: bench.sent[-1].verb == "arm")
        bench.run(0.2)
        assert bench.link is LinkState.RESYNC
        return bench

    @staticmethod
    def fail(bench: ResetBench) -> None:
        bench.supervisor.withdraw(bench.supervisor.requests, "not armed within 5 s: RESYNC")

    @staticmethod
    def mirror(bench: ResetBench) -> None:
        """Begin mirror mode as soon as the command stream, which began anew with the session, has been seen to rest."""
        bench.run(0.5)
        bench.supervisor.begin_mirror(bench.now)
        assert bench.link is LinkState.MIRROR

    @pytest.mark.parametrize("late", [False, True])
    def test_the_stop_that_is_owed_is_sent_while_the_arm_leads(self, late):
        bench = self.failing()
        arm = bench.sent[-1]
        self.fail(bench)
        self.mirror(bench)
        if late:
            bench.cell.control("arm", arm.session, arm.value)
        assert bench.supervisor.withdraws and bench.gateway.state is (State.ARMED if late else State.READY)
        bench.loses = lambda control: False
        bench.run(2.0)
        assert bench.sent[-1].verb == "stop" and bench.sent[-1].session == arm.session
        assert not bench.supervisor.withdraws and bench.gateway.fault and not bench.commands
        assert bench.link is LinkState.MIRROR
        # its end is a person's request, which clears that stop
        bench.supervisor.end_mirror(bench.now)
        bench.run_until(lambda: bench.link is LinkState.ARMED)

    def test_a_request_that_fails_after_mirror_mode_began_does_not_end_it(self):
        bench = self.failing()
        self.mirror(bench)
        self.fail(bench)
        assert bench.link is LinkState.MIRROR and bench.supervisor.reason.startswith("the arm leads")
        bench.run(2.0)
        assert bench.link is LinkState.MIRROR and bench.supervisor.mirrors

    @pytest.mark.parametrize("order", ["failed before", "failed meanwhile", "halted before"])
    def test_mirror_mode_that_ended_read_only_leaves_the_arming_to_a_person(self, order):
        scripted = Bench()
        supervisor = scripted.supervisor
        scripted.answering = False
        supervisor.halt("stopped; call reset")
        scripted.run(0.5)
        if order != "halted before":
            supervisor.request_reset(scripted.now)
            scripted.run(1.0)
            assert scripted.state is LinkState.RESYNC
        if order == "failed before":
            supervisor.withdraw(supervisor.requests, "not armed within 5 s")
            scripted.run(0.3)
        supervisor.begin_mirror(scripted.now)
        scripted.run(0.5)
        if order == "failed meanwhile":
            supervisor.withdraw(supervisor.requests, "not armed within 5 s")
        scripted.set_gateway("read_only", session="")
        scripted.run(0.5)
        supervisor.end_mirror(scripted.now)
        scripted.run(0.5)
        assert scripted.state is LinkState.NO_CONTROLLER
        scripted.answering = True
        scripted.set_gateway("ready")
        scripted.run(3.0)
        assert scripted.state is LinkState.NEEDS_RESET and supervisor.reason.endswith("call reset")
        supervisor.request_reset(scripted.now)
        scripted.run(1.0)
        assert scripted.state is LinkState.ARMED


class TestTwoGateways:
    """Both runs are named in one sentence, and nothing is armed until one is left."""

    @staticmethod
    def speak(bench: ResetBench, seconds: float, run: str = "other", period: float = 1.0, **other) -> list[str]:
        """Let another gateway tell its status once a second; return every sentence of the link, each once."""
        told = []
        for _ in range(round(seconds / period)):
            status = read(GatewayStatus, bench.gateway.status() | {"run": run} | other)
            bench.supervisor.inputs.on_status(status, bench.now)
            for _ in range(round(period * 250)):
                bench.step()
                told += [bench.supervisor.reason] if bench.supervisor.reason not in told else []
        return told

    @pytest.mark.parametrize("state", ["ready", "no_controller", "following"])
    def test_they_are_named_and_the_link_stops(self, state):
        bench = begun("armed")
        bench.run(0.5)
        told = self.speak(bench, 10.0, state=state, session="")
        assert len(told) == 2 and "run run1 and run other" in told[1], told
        assert bench.link is LinkState.MISMATCH and not bench.commands

    def test_nothing_is_armed_until_one_is_left(self):
        bench = begun("stopped")
        self.speak(bench, 3.0)
        with pytest.raises(
            Exception,
            match="cannot reset: more than one gateway .*: run run1 and run other",
        ) as refused:
            bench.supervisor.request_reset(bench.now)
        assert type(refused.value).__name__ == "ReviewError"
        sent = len(bench.sent)
        self.speak(bench, 5.0)
        assert len(bench.sent) == sent and bench.link is LinkState.MISMATCH
        # one says farewell
        farewell = GatewayStatus(state="offline", reason="gateway stopped", run="other")
        bench.supervisor.inputs.on_status(farewell, bench.now)
        bench.run(0.1)
        assert bench.link is LinkState.NEEDS_RESET
        assert_a_reset_arms(bench)

    def test_one_that_is_silent_is_gone(self):
        bench = begun("armed")
        self.speak(bench, 2.0)
        bench.run(4.0)
        assert bench.link is LinkState.ARMED and bench.commands

    @pytest.mark.parametrize("will", [{"run": "run0"}, {}])
    def test_a_late_last_will_of_another_run_changes_nothing(self, will):
        bench = begun("armed")
        session = bench.supervisor.session
        told = bench.supervisor.inputs.on_status(GatewayStatus(state="offline", **will), bench.now)
        assert "changes nothing" in told
        for _ in range(500):
            bench.step()
            assert bench.link is LinkState.ARMED and bench.gateway.state is State.FOLLOWING
        assert bench.supervisor.session == session

    def test_a_late_last_will_of_a_former_connection_of_the_same_run_changes_nothing(self):
        scripted = Bench()
        scripted.gateway["connection"] = 2
        scripted.run(1.0)
        will = {"state": "offline", "reason": "connection lost", "run": scripted.gateway["run"], "connection": 1}
        assert "last will of a former connection" in scripted.supervisor.inputs.on_status(
            read(GatewayStatus, will), scripted.now
        )
        scripted.run(0.02)
        assert scripted.state is LinkState.ARMED
        # that of the present one counts, and so does one that names none
        for present in ({"connection": 2}, {}):
            word = {key: text for key, text in will.items() if key != "connection"} | present
            assert not scripted.supervisor.inputs.on_status(read(GatewayStatus, word), scripted.now)
            scripted.supervisor.poll(scripted.now)
            assert scripted.state is LinkState.GATEWAY_OFFLINE
            scripted.run(1.0)
            assert scripted.state is LinkState.ARMED

    def test_the_own_last_will_counts_at_once(self):
        bench = begun("armed")
        bench.run(0.5)
        assert not bench.supervisor.inputs.on_status(GatewayStatus(state="offline", run=bench.gateway.run), bench.now)
        bench.run(0.04)
        assert bench.link is LinkState.GATEWAY_OFFLINE
