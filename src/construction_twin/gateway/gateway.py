"""The gateway as a pure object: commands, controls and telegrams in; corrections, states and status out. rad and ns.

`Gateway.on_telegram` answers every telegram from what is already here (docs/architecture.md, law 1); `states` has the table of
states. `now` is on the gateway's monotonic clock.
"""

from __future__ import annotations

from functools import partial

from construction_twin.controller.telegram import Telegram
from construction_twin.core.errors import PayloadError
from construction_twin.core.follower import Follower
from construction_twin.core.records import json_value
from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.arm_control import ArmControl
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.control import CommandHandler
from construction_twin.gateway.controller_session import corrected
from construction_twin.gateway.states import HELD, Action, Event, Guard, Machine, Mode, Occasion, Row, State
from construction_twin.mqtt.messages import PROTOCOL, StateProperties


def _not_reset(reason: str) -> str:
    return Sentence("stopped before, and not reset ({reason})", reason=reason) if reason else ""


class Gateway(ArmControl):
    """One robot's gateway between the command stream and the controller session; see `ArmControl` for its arguments."""

    def __init__(
        self,
        config: GatewayConfig,
        run: str,
        commissioning: bool = False,
        measures: bool = False,
        stopped: str = "",
    ):
        super().__init__(config, run, commissioning, measures, stopped)
        self.commands = commands = CommandHandler(self)
        self.on_command, self.on_control = commands.on_command, commands.on_control
        self.on_stop, self.refuse_stop = commands.on_stop, commands.refuse_stop
        self._cycle = config.cycle_ns
        self._absolute = config.make.absolute
        self._began = ""
        # without properties commands carry no stamps, and states none of theirs
        self._stamps = config.properties
        self._silence = round(config.silence * NANOSECONDS)
        self.machine = Machine(
            Sentence("no telegram yet"),
            {
                Guard.ANSWERS: lambda occasion: "read-only" if self.mode is Mode.READ_ONLY else "",
                Guard.READS_ONLY: lambda occasion: "" if self.mode is Mode.READ_ONLY else "answered",
                Guard.HAS_ORIGIN: lambda occasion: self.sentence if self.player.follower is None else "",
                Guard.MAY_ARM: commands.refusal_of_arm,
                Guard.SAME_SESSION: commands.refusal_of_second_session,
                Guard.MAY_RESET: commands.refusal_of_reset,
                Guard.OWNER_MAY_RESET: commands.refusal_of_owner_reset,
            },
            {
                Action.BEGIN_SESSION: self._on_session_began,
                Action.END_SESSION: self._on_session_ended,
                Action.OWN: commands.on_armed,
                Action.START_STREAM: commands.on_stream_began,
                Action.BRAKE: self.on_brake,
                Action.BRAKE_TO_FAULT: self.on_brake,
                Action.FAULT: self.on_fault,
                Action.RESET: self.on_reset,
                Action.LAST_RESORT: self.on_fault,
            },
            refusal=lambda: self.sentence,
        )
        if stopped:
            self.stop(_not_reset(stopped))

    # -- a telegram

    def on_telegram(self, telegram: Telegram, source: object, now: int) -> tuple[float, ...] | None:
        """Carry a telegram through every step to its answer: position, or position minus origin [rad]; None: no answer."""
        machine, controller, player, counters = self.machine, self.controller, self.player, self.counters
        # session: what does the telegram mean, does another session begin, may it be answered?
        state = machine.state
        outcome = controller.on_telegram(telegram, source, now, state is State.FOLLOWING or state is State.BRAKING)
        if outcome is None:
            counters["telegrams_repeated"] += 1
            return None
        if outcome.begins:
            self._begin_controller_session(telegram)
        if outcome.refusal:
            machine.on(Event.ORIGIN_REFUSED, Occasion(outcome.refusal))
        state = machine.state
        if self.tool is not None:
            joined = state is State.JOINED
            why = Sentence("this session is not answered: {reason}", reason=machine.reason) if joined else ""
            self.tool.on_telegram(why, outcome.missed)
        if state is State.JOINED or state is State.READ_ONLY or state is State.FAILED:
            counters["telegrams_unanswered"] += 1
            return None
        if not controller.origin:
            # the only target that is known is the correction of none
            counters["telegrams_unanswered" if self._absolute else "telegrams"] += 1
            return None if self._absolute else (0.0,) * len(self.config.axes)
        counters["telegrams"] += 1
        # held pose: where the arm is held, after what a program of the controller did, and replies that did not arrive
        follower = player.follower or player.place(controller.origin)
        if outcome.drifted_to and state in HELD:
            follower = player.place(controller.move_origin(outcome.drifted_to, follower.position))
        elif outcome.drifted_to and state is State.FOLLOWING and (drift := controller.drift(outcome.drifted_to)):
            self.brake(Event.DRIFTED, drift)
        controller.replies.record_loss(outcome.lost, outcome.elapsed)
        elapsed = outcome.elapsed
        if outcome.lost or elapsed > self._cycle:
            follower, elapsed = self._restart_from_rest(follower, elapsed, outcome.lost)
        # where nothing has arrived for so long, nothing is played: the gate is to compare with the present
        self.command_stamp = player.stamp if controller.replies.lost_for <= self._silence else 0
        # playout with its one rate, or braking, and the limits of every joint
        if elapsed == self._cycle and not player.interpolator.interpolated:
            position = self._move(follower, elapsed)
        elif machine.state is State.FOLLOWING or machine.state is State.BRAKING:
            # until the change of the cycle is noticed, and while it brakes
            step = partial(self._move, follower, self._cycle)
            position = player.interpolator.position(elapsed, follower.position, step)
        else:
            player.interpolator.restart()
            position = follower.position
        # what goes with this target
        if self.tool is not None and machine.state is State.FOLLOWING and player.braking is None:
            self.tool.fire_due(player.stamp)
        if self.trace is not None:
            session = counters["rsi_sessions"]
            self.trace(telegram.controller_ms, session, machine.state, player.stamp, position, outcome.lost)
        # encode: a correction to the origin, or a position; the service writes the make's bytes
        return controller.replies.answer(position, controller.origin)

    def _begin_controller_session(self, telegram: Telegram) -> None:
        terms = self.config.make.terms
        began = Sentence(
            "{protocol} session began at {stamp} {value}: {why}",
            protocol=terms.protocol,
            stamp=terms.stamp,
            value=telegram.controller_ms,
            why=self.controller.begin_reason,
        )
        # the states of a new session do not show what stands against arming
        self._began = join_sentences(self.with_mode(began), _not_reset(self.stopped))
        self.machine.on(Event.SESSION_BEGAN, Occasion(self._began))
        if self.machine.state is State.MEASURING:
            if self.clock.measures:
                self.machine.append_to_reason(Sentence("measuring the controller's cycle"))
            else:
                self.machine.on(Event.CYCLE_FITS, Occasion(self._began))

    def _restart_from_rest(self, follower: Follower, elapsed: int, lost: bool) -> tuple[Follower, int]:
        """Stand at the last correction that arrived, where HOLDON kept the arm; return the follower there, and the time left."""
        player = self.player
        if player.interpolator.interpolated:
            # it stands within a step, not at its end
            player.interpolator.restart()
            follower = player.place(corrected(self.controller.origin, self.controller.replies.last_acknowledged))
        elif lost:
            follower.undo_step()
        else:
            follower.rest()
        pause = max(0, elapsed - self._cycle)
        if self.machine.state is State.FOLLOWING:
            player.restart_from_rest(pause, lost)
            self.counters["standstills"] += 1
        return follower, elapsed - pause

    def _move(self, follower: Follower, elapsed: int) -> tuple[float, ...]:
        """Return the position after a cycle: on the stream, on the way to rest, or held."""
        machine, player = self.machine, self.player
        if machine.state is State.FOLLOWING:
            # in commissioning mode the arm does not do what the player does
            measured = self.controller.measured if self.mode is Mode.NORMAL else ()
            position = player.play(follower, elapsed, measured)
            overdue = player.playout.overdue
            if overdue > self._silence:
                player.on_stream_given_up(self.command_session, self.controller.received_at)
                why = Sentence("no command for {seconds:.3f} s beyond the newest one", seconds=overdue / NANOSECONDS)
                self.brake(Event.STREAM_SILENT, why)
            return position
        if machine.state is State.BRAKING:
            position = follower.brake()
            self.side_effects.run("the way to rest", self.stopping.advance, follower, elapsed)
            if follower.at_rest:
                machine.on(Event.AT_REST, Occasion(machine.reason))
            return position
        return follower.position

    def on_last_resort(self, telegram: Telegram, target: tuple[float, ...], lost: bool) -> None:
        """Trace a telegram that the last resort answered with `target` [rad]; `lost`: the reply before it did not arrive."""
        controller = self.controller
        controller.store_measured(telegram)
        self.command_stamp = 0
        if self.trace is not None:
            position = target if self._absolute else corrected(controller.origin, target)
            self.trace(telegram.controller_ms, self.counters["rsi_sessions"], self.state, 0, position, lost)

    # -- between telegrams

    def poll(self, now: int) -> None:
        """Check for silence of the controller and of the speed limit, and the clock; call it behind an answer."""
        machine, controller = self.machine, self.controller
        self.commands.poll(now)
        if controller.is_silent(now):
            said, why = (
                controller.status.sentence,
                Sentence("no telegram for {seconds:g} s", seconds=self.config.timeout),
            )
            why = Sentence("{silence}; the last one said: {said}", silence=why, said=said) if said else why
            machine.on(Event.CONTROLLER_SILENT, Occasion(why))
        if machine.state is State.NO_CONTROLLER and self.refusals.unread:
            sentence, is_new = self.refusals.pop_unreadable(now)
            if sentence:
                machine.append_to_reason(sentence)
                machine.changed = machine.changed or is_new
        if self.clock.measures:
            self._judge_clock()

    def _judge_clock(self) -> None:
        machine, clock, state = self.machine, self.clock, self.machine.state
        if state in (State.ARMED, State.FOLLOWING):
            if clock.changed:
                self.brake(Event.CYCLE_REFUSED, clock.changed)
        elif state is State.READY:
            # a program began RSI anew in the other mode, where nothing else shows that it did
            if wrong := clock.judge(rates=False):
                machine.on(Event.CYCLE_REFUSED, Occasion(wrong))
        elif state in (State.MEASURING, State.OTHER_CYCLE):
            wrong = clock.judge()
            if wrong is not None:
                machine.on(Event.CYCLE_REFUSED if wrong else Event.CYCLE_FITS, Occasion(wrong or self._began))
        elif state is State.READ_ONLY:
            # it takes no corrections, but the next program may
            wrong = clock.judge()
            if wrong:
                machine.append_to_reason(wrong)
                machine.changed = True
            elif wrong is not None:
                machine.restore_reason()

    # -- what the rows of the table do

    def _on_session_began(self, row: Row, occasion: Occasion) -> None:
        self.player.follower = None
        if self.tool is not None:
            self.tool.begin_controller_session()
        self.disarm(occasion.reason)
        self.ending = False
        self.controller.replies.begin()
        self.clock.restart()
        self.player.interpolator.restart()
        self.refusals.begin_controller_session()

    def _on_session_ended(self, row: Row, occasion: Occasion) -> None:
        self.controller.end()
        self.clock.restart()
        self.player.follower = None
        if self.tool is not None:
            self.tool.end_controller_session(occasion.reason)
        self.disarm(occasion.reason)

    # -- what it publishes

    def state_message(self, stamp: int) -> tuple[bytes, StateProperties] | None:
        """Return the joint string of the measured pose and its properties, None without one; `stamp` is the gateway's own [ns]."""
        measured, counters = self.controller.measured, self.counters
        if not measured:
            return None
        try:
            payload = self.codec.encode(measured)
        except PayloadError as error:
            counters[f"state_refused_{error.reason}"] += 1
            return None
        counters["states_sent"] += 1
        return payload, StateProperties(counters["states_sent"], stamp, self.command_stamp if self._stamps else 0)

    def pop_change(self) -> bool:
        """Return whether the state changed since the last call."""
        changed, self.machine.changed = self.machine.changed, False
        return self.tool.pop_change() or changed if self.tool is not None else changed

    def status(self) -> dict:
        """Return the content of the `status` topic; each key is explained in docs/reference/mqtt.md."""
        config, owners, controller = self.config, self.commands.owners, self.controller
        status = {
            "state": self.state.value,
            "reason": self.reason,
            "session": self.command_session,
            "fault": self.fault,
            "fault_number": self.fault_number,
            "mode": self.mode.value,
            "correction": controller.replies.correction,
            "controller": controller.status.status_fields(),
            "last_ipoc_jump_ms": controller.jump_ms,
            "cycle": self.clock.status_fields(),
            "run": self.run,
            "protocol": PROTOCOL,
            "hash": config.hash,
            "decimals": config.decimals,
            "properties": config.properties,
            "playout": self.player.playout.status_fields(),
            "speed_limit": self.commands.speed.status_fields(),
            "stop": self.stopping.status_fields(),
            "intruder": {"session": owners.intruder, "count": owners.intrusions},
            "last_refusal": self.refusals.last,
            "later_refusal": self.refusals.later,
            "counters": dict(self.counters) | self.side_effects.counts("failed_beside"),
        }
        if pose := controller.tool_pose():
            status["tool_pose"] = pose
        if self.tool is not None:
            status["tool"] = self.tool.status_fields(self.reason if self.state is State.FAILED else "")
        return json_value(status)
