"""The arm under the gateway's control: its parts, its state, and how it is stopped. rad and ns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial

from construction_twin.core.sentences import Sentence
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.command_intake import CommandIntake
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.controller_clock import ControllerClock
from construction_twin.gateway.controller_session import ControllerSession
from construction_twin.gateway.player import Player, StopReport
from construction_twin.gateway.states import CAUSES, Action, Event, Machine, Mode, Occasion, Row, State
from construction_twin.gateway.tool_switches import ToolSwitches
from construction_twin.mqtt.joint_string import JointStringCodec

#: What is quoted of a refused message in `status` [characters]: the status stays small, whatever was sent.
LONGEST_REFUSAL = 300


class Refusals:
    """Counts refusals and keeps the last one's sentence."""

    def __init__(self, counters: Counter[str]):
        self._counters = counters
        #: The last refusal that no stop has caused; the one that stopped the arm, until `clear_cause`.
        self.last = ""
        #: The last one since the one that stopped the arm.
        self.later = ""
        #: Datagrams refused since the last readable telegram; the last one's reason and sentence.
        self.unread, self.unread_reason, self.unread_why = 0, "", ""
        self._has_own = self._stopped = False
        self._published_at = -NANOSECONDS
        self.begin_controller_session()

    def begin_controller_session(self) -> None:
        """Restart the count of unreadable datagrams."""
        self._published_reason, self._published_count = "", 0

    def count_message(self, reason: str, why: object, follows: bool = False) -> None:
        """Count a message on MQTT as ``refused_<reason>``; one that `follows` from a stop replaces no other as the last."""
        if follows and self._has_own:
            self._counters[f"refused_{reason}"] += 1
            return
        self._record(f"refused_{reason}", reason, why)
        self._has_own = not follows

    def on_stop(self) -> None:
        """Hold the last refusal, which stopped the arm."""
        self._stopped, self.later = True, ""

    def count_telegram(self, reason: str, why: object) -> None:
        """Count a refused datagram on the controller's port as ``telegram_refused_<reason>``."""
        self._record(f"telegram_refused_{reason}", f"telegram {reason}", why)
        self._has_own = True
        self.unread += 1
        self.unread_reason, self.unread_why = reason, str(why)[:LONGEST_REFUSAL]

    def clear_cause(self) -> None:
        """Release the refusal that stopped the arm."""
        self.last, self.later = self.later or self.last, ""
        self._has_own = self._stopped = False

    def pop_unreadable(self, now: int) -> tuple[str, bool]:
        """Return the sentence on unreadable datagrams, once a second, else "", and whether its reason is a new one."""
        if now < self._published_at + NANOSECONDS or self.unread == self._published_count:
            return "", False
        reason, is_new = self.unread_reason, self.unread_reason != self._published_reason
        self._published_at, self._published_count, self._published_reason = now, self.unread, reason
        count, why = self.unread, self.unread_why
        text = Sentence(
            "datagrams refused: {count}, the last one for {reason}: {why}", count=count, reason=reason, why=why
        )
        return text, is_new

    def _record(self, counter: str, reason: str, why: object) -> None:
        self._counters[counter] += 1
        text = f"{reason}: {why}"[:LONGEST_REFUSAL]
        if self._stopped:
            self.later = text
        else:
            self.last = text


class ArmControl:
    """The parts of a gateway, its state, and the acts of every side: brake, stop, end.

    Args:
        run: Unique id of this run.
        measures: False: telegrams come on a simulated clock, and the controller's cycle is not measured.
        stopped: Why the run before this one was stopped, where nobody has reset that.
    """

    #: Made by `Gateway`, which knows the functions of all guards and actions.
    machine: Machine

    def __init__(self, config: GatewayConfig, run: str, commissioning: bool, measures: bool, stopped: str):
        self.config = config
        self.run = run
        self.mode = Mode.of(config, commissioning)
        self.codec = JointStringCodec.of_config(config)
        self.counters: Counter[str] = Counter()
        self.refusals = Refusals(self.counters)
        #: True after any stop but one by silence, until a `reset`; outlives the controller session.
        self.fault = False
        #: Number of the last of these stops in this run, 0 before the first; a `reset` must name it.
        self.fault_number = 0
        #: Its reason, until a `reset`; the end of the program is no stop.
        self.stopped = stopped
        self.side_effects = SideEffects()
        #: Called with every answered telegram, see `TraceWriter.record`.
        self.trace: Callable[[int, int, State, int, tuple[float, ...], bool], None] | None = None
        self.clock = ControllerClock(config.make, config.cycle, measures)
        self.controller = ControllerSession(config, self.counters, zero=self.mode is not Mode.NORMAL)
        self.player = Player(config, self.counters)
        self.tool = ToolSwitches(config.tool, config.layout, config.cycle_ns, self.counters) if config.tool else None
        self.intake = CommandIntake(config, self.codec, self.player)
        self.with_mode = partial(self.mode.describe, terms=config.make.terms)
        #: Stamp of the target in the last answer [ns]; 0 for none.
        self.command_stamp = 0
        #: The end of the controller's program was requested.
        self.ending = False
        self.stopping = StopReport(config.limits.linear)

    @property
    def state(self) -> State:
        """What the gateway is doing."""
        return self.machine.state

    @property
    def reason(self) -> str:
        """Why, in one sentence."""
        return self.machine.reason

    @property
    def command_session(self) -> str:
        """Id of the session that may command; "" for none."""
        return "" if self.machine.state is State.FAILED else self.intake.stream.session

    @property
    def sentence(self) -> Sentence:
        """State and reason, for a refusal."""
        return Sentence("gateway is {state}: {reason}", state=self.state.value, reason=self.reason)

    def on_brake(self, row: Row, occasion: Occasion) -> None:
        """Brake and report the distance; drop the command session."""
        cause, state, follower = CAUSES[row.event], row.state, self.player.follower
        if row.action is Action.BRAKE_TO_FAULT:
            self.on_fault(row, occasion)
        self.counters[f"stops_{cause}"] += 1
        if state is not State.BRAKING and follower is not None:
            # a second stop keeps the first report; after a silent stream, braking began in the first cycle without a command
            begun = self.player.braking if cause == "silence" else None
            follows = self.mode is Mode.NORMAL and state is State.FOLLOWING and cause != "drift"
            measured = self.controller.measured if follows else ()
            report = self.stopping.begin, cause, follower, measured, begun, occasion.account
            self.side_effects.run("the way to rest", *report)
        self.disarm(occasion.reason)

    def on_fault(self, row: Row, occasion: Occasion) -> None:
        """Set the fault, until a `reset`."""
        self.fault = self.machine.changed = True
        if not occasion.ending:
            self.fault_number += 1
            self.stopped = self.stopped or occasion.reason

    def on_reset(self, row: Row, occasion: Occasion) -> None:
        """Drop the command session, clear the fault."""
        self.disarm(Sentence("reset"))
        self.fault, self.stopped, self.ending = False, "", False
        self.refusals.clear_cause()
        if self.mode is Mode.COMMISSIONING or not any(self.controller.replies.correction):
            # the arm stands at its origin, or where a program of the controller took it: the next stream begins there
            self.controller.renew_origin()
            self.player.place(self.controller.origin)

    def disarm(self, why: str) -> None:
        """Drop the command session, its stream and its switches."""
        if self.tool is not None:
            self.tool.void(why)
        self.intake.stream.begin("")
        self.command_stamp = 0
        self.player.clear()

    def brake(self, event: Event, reason: str, account: str = "", ending: bool = False) -> None:
        """Brake for an event of `states.CAUSES`, with a `reason`."""
        why = Sentence("{cause}: {reason}", cause=CAUSES[event], reason=reason)
        self.machine.on(event, Occasion(why, account=account, ending=ending))

    def stop(self, reason: str, account: str = "", ending: bool = False) -> None:
        """Brake in any state, at rest too, and stay stopped until a `reset`."""
        self.brake(Event.STOP, reason, account, ending)

    def end(self, reason: str, program: bool = False) -> None:
        """Brake as in `stop`, and once at rest end the controller's program; this `program`'s own end is no numbered stop."""
        self.stop(reason, ending=program)
        self.ending = self.config.layout.stop

    @property
    def ends_program(self) -> bool:
        """True when replies must end the controller's program: the end was asked for, and the arm is at rest."""
        return self.ending and self.state in (State.HOLDING, State.MEASURING, State.OTHER_CYCLE)

    def fail(self, reason: str) -> None:
        """Enter FAILED after an unexpected exception: the last resort answers, for good. Only state and fault are touched."""
        self.machine.on(Event.FAILURE, Occasion(reason))
