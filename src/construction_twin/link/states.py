"""The state machine of the link: one table of states, events, guards, actions and the states that they lead to, and the table of
the link to a bare PLC, which has no gateway to ask.

Pure data. `LinkSupervisor` finds out which event happened, evaluates the guards and carries out the actions; `BareSupervisor` those
of the second table.
"""

from __future__ import annotations

from enum import Enum

from construction_twin.core import state_table


class LinkState(Enum):
    """State of the link; values are those of `Link.msg`."""

    DISCONNECTED = 0
    GATEWAY_OFFLINE = 1
    NO_CONTROLLER = 2
    MISMATCH = 3
    RESYNC = 4
    ARMED = 5
    NEEDS_RESET = 6
    MIRROR = 7


class LinkEvent(Enum):
    """What can happen to the link; the values are the words of the documentation."""

    BROKER_LOST = "there is no connection to the broker"
    GATEWAY_LOST = "no gateway answers on the broker"
    MISMATCHED = "the gateway runs another configuration or version, or more than one answers"
    CONTROLLER_LOST = "the gateway has no controller session to command"
    PRESENT = "poll: broker, gateway and arm are there"
    TURN = "poll: a control message may be sent"
    ARM_ACCEPTED = "the gateway accepts `arm`"
    RESET_ASKED = "a person calls `reset`, or ends mirror mode"
    MIRROR_ASKED = "a person begins mirror mode"
    HALTED = "a person calls `halt`"
    WITHDRAWN = "what a person asked for has been answered as failed"
    RESPONSIBILITY_TAKEN = "a person arms a bare PLC, and takes the responsibility by name"


class Guard(Enum):
    """What must hold for a row to count; the values are the words of the documentation."""

    ALWAYS = ""
    ARM_LEADS = "mirror mode is on"
    SESSION_ENDED = "the gateway does not follow our session"
    FAULT = "the gateway reports a fault"
    FAULT_UNASKED = "the gateway reports a fault, and no person asked for this session"
    STOPPED_SINCE = "a person asked for this session, and the gateway was stopped or started again since the call"
    STOPPED_BEFORE = "a former run of the gateway was stopped, and no person has asked for a session since"
    HALTED_HERE = (
        "`halt` was called, or a person's request failed, since the last session with a right to command began"
    )
    FIRST_SESSION = "this bridge has never been armed, and the gateway is ready"
    NOTHING_COULD_JUMP = (
        "the gateway is ready, armed, or holds after silence; twin and arm rest within the start tolerance"
    )
    ANSWER_AWAITED = "the last control message is unanswered and younger than 0.5 s"
    BRAKING = "the gateway brakes"
    NOT_READY = "the gateway is not ready, or reports a fault"
    POSES_DIFFER = "twin and arm are not within the start tolerance, or the arm moves before the first session"
    ARM_REFUSED = "the gateway refused `arm`"
    WITHDRAWAL_UNTOLD = "a person's request failed, and the gateway does not know yet; no other session commands"
    OLD_SESSION_COMMANDS = "the gateway still follows the session before mirror mode"
    NOT_TOGETHER = "twin and arm are not at rest within the start tolerance"


class Action(Enum):
    """What a row does beside changing the state; the values are the words of the documentation."""

    NOTHING = ""
    FORGET_REQUESTS = "forget the pending control message and request"
    NOTE_HALT = "forget all requests; end mirror mode; wait for a person"
    NOTE_WITHDRAWAL = "forget all requests; wait for a person"
    NOTE_WITHDRAWAL_IN_MIRROR = "wait for a person when mirror mode has ended"
    BEGIN_MIRROR = "begin a session without the right to command"
    BEGIN_ASKED_SESSION = "begin a new session on a person's request"
    BEGIN_FIRST_SESSION = "begin the first session"
    BEGIN_NEXT_SESSION = "begin a new session without a person"
    BEGIN_SESSION_AFTER_REFUSAL = "begin another session"
    NOTE_ARMED = "remember that the link was armed"
    TELL_MIRROR = "say what the gateway does meanwhile"
    TELL_GATEWAY = "say what the gateway says"
    TELL_STOP = "say why the gateway was stopped"
    VOID_REQUEST = "forget the request; say why the gateway was stopped"
    TELL_FORMER_STOP = "say why the former run was stopped"
    TELL_HALT = "say that `halt` was called, or what failed"
    TELL_RESET = "say what the gateway says, and that `reset` is needed"
    SEND_RESET = "send `reset` with the stop's number"
    SEND_STOP = "send `stop`: what was sent before and arrives late arms nothing"
    SEND_ARM = "send `arm`"
    RESET_OLD_SESSION = "send `reset` for the session before mirror mode"
    BEGIN_NAMED_SESSION = "begin a session in this person's name"
    NOTE_RESPONSIBLE = "say who is responsible, and what is not checked"
    TELL_PERSON = "say that a person must arm, by name"


Row = state_table.Row[LinkState, LinkEvent, Guard, Action]
rows = state_table.Rows(LinkState, LinkEvent, Guard, Action)

#: States that are left as soon as broker, gateway and arm are there.
_ABSENT = (
    LinkState.DISCONNECTED,
    LinkState.GATEWAY_OFFLINE,
    LinkState.NO_CONTROLLER,
    LinkState.MISMATCH,
    LinkState.MIRROR,
)
_WAITING = (*_ABSENT, LinkState.NEEDS_RESET)

#: An event without a row for the present state, or without a guard that holds, changes nothing.
TABLE: tuple[Row, ...] = (
    *rows(LinkState, LinkEvent.BROKER_LOST, LinkState.DISCONNECTED, Action.FORGET_REQUESTS),
    *rows(LinkState, LinkEvent.GATEWAY_LOST, LinkState.GATEWAY_OFFLINE, Action.FORGET_REQUESTS),
    *rows(LinkState, LinkEvent.MISMATCHED, LinkState.MISMATCH, Action.FORGET_REQUESTS),
    *rows(LinkState, LinkEvent.CONTROLLER_LOST, LinkState.NO_CONTROLLER, Action.FORGET_REQUESTS),
    # what a person asks for
    *rows(LinkState, LinkEvent.HALTED, LinkState.NEEDS_RESET, Action.NOTE_HALT),
    # mirror mode began after the request: the arm leads on
    *rows(LinkState, LinkEvent.WITHDRAWN, None, Action.NOTE_WITHDRAWAL_IN_MIRROR, Guard.ARM_LEADS),
    *rows(LinkState, LinkEvent.WITHDRAWN, LinkState.NEEDS_RESET, Action.NOTE_WITHDRAWAL),
    *rows(LinkState, LinkEvent.MIRROR_ASKED, LinkState.MIRROR, Action.BEGIN_MIRROR),
    *rows(LinkState, LinkEvent.RESET_ASKED, LinkState.RESYNC, Action.BEGIN_ASKED_SESSION),
    # nothing is missing: which side may command?
    *rows(LinkState, LinkEvent.PRESENT, LinkState.MIRROR, Action.TELL_MIRROR, Guard.ARM_LEADS),
    # armed is only what shows no fault: this one came later
    *rows(LinkState.ARMED, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_STOP, Guard.FAULT),
    *rows(LinkState.ARMED, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_GATEWAY, Guard.SESSION_ENDED),
    *rows(LinkState.RESYNC, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_STOP, Guard.FAULT_UNASKED),
    *rows(LinkState.RESYNC, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.VOID_REQUEST, Guard.STOPPED_SINCE),
    *rows(_WAITING, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_HALT, Guard.HALTED_HERE),
    *rows(_WAITING, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_STOP, Guard.FAULT),
    *rows(_WAITING, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_FORMER_STOP, Guard.STOPPED_BEFORE),
    *rows(_WAITING, LinkEvent.PRESENT, LinkState.RESYNC, Action.BEGIN_FIRST_SESSION, Guard.FIRST_SESSION),
    *rows(_WAITING, LinkEvent.PRESENT, LinkState.RESYNC, Action.BEGIN_NEXT_SESSION, Guard.NOTHING_COULD_JUMP),
    *rows(_ABSENT, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_RESET),
    # which control message comes next?
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.NOTHING, Guard.ANSWER_AWAITED),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.NOTHING, Guard.BRAKING),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.SEND_RESET, Guard.NOT_READY),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.NOTHING, Guard.POSES_DIFFER),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.BEGIN_SESSION_AFTER_REFUSAL, Guard.ARM_REFUSED),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.SEND_ARM),
    *rows(LinkState.NEEDS_RESET, LinkEvent.TURN, LinkState.NEEDS_RESET, Action.NOTHING, Guard.ANSWER_AWAITED),
    *rows(LinkState.NEEDS_RESET, LinkEvent.TURN, LinkState.NEEDS_RESET, Action.SEND_STOP, Guard.WITHDRAWAL_UNTOLD),
    *rows(LinkState.MIRROR, LinkEvent.TURN, LinkState.MIRROR, Action.NOTHING, Guard.ANSWER_AWAITED),
    *rows(LinkState.MIRROR, LinkEvent.TURN, LinkState.MIRROR, Action.SEND_STOP, Guard.WITHDRAWAL_UNTOLD),
    *rows(LinkState.MIRROR, LinkEvent.TURN, LinkState.MIRROR, Action.RESET_OLD_SESSION, Guard.OLD_SESSION_COMMANDS),
    *rows(LinkState.RESYNC, LinkEvent.ARM_ACCEPTED, LinkState.ARMED, Action.NOTE_ARMED),
)

#: The same for a bare PLC: nothing is asked of it, and only a person's name leads to ARMED.
BARE_TABLE: tuple[Row, ...] = (
    *rows(LinkState, LinkEvent.BROKER_LOST, LinkState.DISCONNECTED, Action.FORGET_REQUESTS),
    *rows(LinkState, LinkEvent.GATEWAY_LOST, LinkState.GATEWAY_OFFLINE, Action.FORGET_REQUESTS),
    *rows(LinkState, LinkEvent.MISMATCHED, LinkState.MISMATCH, Action.FORGET_REQUESTS),
    *rows(LinkState, LinkEvent.CONTROLLER_LOST, LinkState.NO_CONTROLLER, Action.FORGET_REQUESTS),
    # what a person asks for
    *rows(LinkState, LinkEvent.HALTED, LinkState.NEEDS_RESET, Action.NOTE_HALT),
    *rows(LinkState, LinkEvent.MIRROR_ASKED, LinkState.MIRROR, Action.BEGIN_MIRROR),
    *rows(LinkState.NEEDS_RESET, LinkEvent.RESPONSIBILITY_TAKEN, LinkState.RESYNC, Action.BEGIN_NAMED_SESSION),
    # nothing is missing
    *rows(LinkState, LinkEvent.PRESENT, LinkState.MIRROR, Action.TELL_MIRROR, Guard.ARM_LEADS),
    *rows(_ABSENT, LinkEvent.PRESENT, LinkState.NEEDS_RESET, Action.TELL_PERSON),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.RESYNC, Action.NOTHING, Guard.NOT_TOGETHER),
    *rows(LinkState.RESYNC, LinkEvent.TURN, LinkState.ARMED, Action.NOTE_RESPONSIBLE),
)

#: The rows for a state and an event, in the tables' order.
ROWS, BARE_ROWS = state_table.by_cause(TABLE), state_table.by_cause(BARE_TABLE)
