"""The gateway's states and modes, and its state machine: one table of state, event, guard, action and next state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

from construction_twin.controller.port import Terms
from construction_twin.core import state_table
from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.gateway.config import GatewayConfig


class Mode(Enum):
    """What becomes of the corrections; the words are those of `status`."""

    NORMAL = "normal"  # they are sent
    COMMISSIONING = "commissioning"  # they are computed, reported, and zero on the wire
    READ_ONLY = "read_only"  # the controller expects no answer, and gets none

    @classmethod
    def of(cls, config: GatewayConfig, commissioning: bool) -> Mode:
        """Return the mode; a layout without replies comes first."""
        if not config.layout.expects_replies:
            return cls.READ_ONLY
        return cls.COMMISSIONING if commissioning else cls.NORMAL

    def describe(self, sentence: str, terms: Terms) -> str:
        """Return a sentence with what the mode means for the arm."""
        if self is Mode.NORMAL:
            return sentence
        if self is Mode.COMMISSIONING:
            return Sentence(
                "{what}; commissioning: every correction is sent as zero, the arm does not move", what=sentence
            )
        why = terms.read_only
        return Sentence("{what}; {why}, so nothing is answered and no motion can be commanded", what=sentence, why=why)


class State(Enum):
    """States of the gateway; the words are those of `status`, the order is that of a trace's numbers."""

    NO_CONTROLLER = "no_controller"  # no telegram for the timeout: nothing to answer
    READ_ONLY = "read_only"  # no answer is expected: poses are reported, nothing is answered or commanded
    JOINED = "joined_running"  # telegrams whose correction we cannot know: not answered, so that the session times out
    READY = "ready"  # origin captured, holding; waits for `arm`
    ARMED = "armed"  # holding; the session's stream may begin
    FOLLOWING = "following"  # the stream is played
    BRAKING = "braking"  # the arm is being brought to rest
    HOLDING = "holding"  # at rest after a fault or a stop; waits for `reset`
    FAILED = "failed"  # the program itself has failed; the last resort brakes and answers, until a person starts the gateway anew
    MEASURING = "measuring"  # holding; the controller's cycle is not known yet, so nothing may be commanded
    OTHER_CYCLE = "other_cycle"  # holding; the controller's cycle is not the expected one, so nothing may be commanded


class Event(Enum):
    """Event of the gateway."""

    SESSION_BEGAN = "the first telegram of a controller session"
    CYCLE_FITS = "the controller's cycle is the expected one"
    CYCLE_REFUSED = "the controller has another cycle, or its clock does not run in real time"
    ORIGIN_REFUSED = "telegrams do not tell the origin"
    CONTROLLER_SILENT = "no telegram for the timeout"
    AT_REST = "braking has ended"
    DRIFTED = "the programmed position left the origin by more than the start tolerance"
    STREAM_BEGAN = "the first command of a stream"
    STREAM_SILENT = "the stream is overdue, or too much of it is missing"
    COMMAND_REFUSED = "a command breaks a limit"
    SPEED_IGNORED = "the sender does not obey the speed limit"
    REPLIES_LOST = "replies do not arrive, and the arm trails its stream too far"
    ARM = "`arm`"
    STOP = "`stop` or `end`, a person's `stop/<account>`, or the program is ending"
    RESET = "`reset`"
    FAILURE = "an unexpected exception"


class Guard(Enum):
    """Condition of a row."""

    NONE = ""
    ANSWERS = "the controller expects answers"
    READS_ONLY = "the controller expects no answers"
    HAS_ORIGIN = "the origin is known"
    MAY_ARM = (
        "the origin is known; no fault; the arm is where it is held; the session has not had its turn; "
        "the controller's cycle is still the one that was measured"
    )
    SAME_SESSION = "from the armed session"
    MAY_RESET = "the origin is known; it names the run and the last stop's number; the arm is at rest"
    OWNER_MAY_RESET = "from the commanding session; it names the run and the last stop's number; the arm is at rest"


class Action(Enum):
    """Effect of a row."""

    NONE = ""
    BEGIN_SESSION = "forget origin and command session"
    END_SESSION = "forget origin and command session; the controller session is over"
    OWN = "the session may command"
    START_STREAM = "check and take the command"
    BRAKE = "brake; drop the command session"
    BRAKE_TO_FAULT = "brake; drop the command session; fault until `reset`"
    FAULT = "fault until `reset`"
    RESET = "drop the command session; clear the fault; with no correction take the origin anew"
    LAST_RESORT = "fault; the last resort brakes and answers"


Row = state_table.Row[State, Event, Guard, Action]
rows = state_table.Rows(State, Event, Guard, Action)

_LIVE = tuple(state for state in State if state is not State.FAILED)
_MOVABLE = (State.ARMED, State.FOLLOWING, State.BRAKING, State.HOLDING)
_UNMEASURED = (State.MEASURING, State.OTHER_CYCLE)
#: States in which nothing is commanded, and the held pose follows what a program of the controller does.
HELD = (*_UNMEASURED, State.READY, State.ARMED)
_NOTHING_TO_BRAKE = (State.NO_CONTROLLER, State.READ_ONLY, State.JOINED, *_UNMEASURED)

#: Every change of state. What no row names changes nothing: it is refused, or counted.
TABLE: tuple[Row, ...] = (
    *rows(_LIVE, Event.SESSION_BEGAN, State.MEASURING, Action.BEGIN_SESSION, Guard.ANSWERS),
    *rows(_LIVE, Event.SESSION_BEGAN, State.READ_ONLY, Action.BEGIN_SESSION, Guard.READS_ONLY),
    *rows(_UNMEASURED, Event.CYCLE_FITS, State.READY),
    *rows((State.MEASURING, State.READY, State.OTHER_CYCLE), Event.CYCLE_REFUSED, State.OTHER_CYCLE),
    *rows((State.ARMED, State.FOLLOWING), Event.CYCLE_REFUSED, State.BRAKING, Action.BRAKE_TO_FAULT),
    *rows((State.MEASURING, State.READY), Event.ORIGIN_REFUSED, State.JOINED),
    *rows(_LIVE[1:], Event.CONTROLLER_SILENT, State.NO_CONTROLLER, Action.END_SESSION),
    *rows(State.READY, Event.ARM, State.ARMED, Action.OWN, Guard.MAY_ARM),
    *rows((State.ARMED, State.FOLLOWING), Event.ARM, None, Action.NONE, Guard.SAME_SESSION),
    *rows(State.ARMED, Event.STREAM_BEGAN, State.FOLLOWING, Action.START_STREAM),
    *rows(State.FOLLOWING, Event.STREAM_SILENT, State.BRAKING, Action.BRAKE),
    *rows(State.FOLLOWING, Event.COMMAND_REFUSED, State.BRAKING, Action.BRAKE_TO_FAULT),
    *rows(State.FOLLOWING, Event.SPEED_IGNORED, State.BRAKING, Action.BRAKE_TO_FAULT),
    *rows(State.FOLLOWING, Event.REPLIES_LOST, State.BRAKING, Action.BRAKE_TO_FAULT),
    *rows(State.FOLLOWING, Event.DRIFTED, State.BRAKING, Action.BRAKE_TO_FAULT),
    *rows(State.READY, Event.STOP, State.BRAKING, Action.BRAKE_TO_FAULT, Guard.HAS_ORIGIN),
    *rows(State.READY, Event.STOP, None, Action.FAULT),
    *rows(_MOVABLE, Event.STOP, State.BRAKING, Action.BRAKE_TO_FAULT),
    *rows(_NOTHING_TO_BRAKE, Event.STOP, None, Action.FAULT),
    *rows(State.BRAKING, Event.AT_REST, State.HOLDING),
    *rows(State.FOLLOWING, Event.RESET, State.READY, Action.RESET, Guard.OWNER_MAY_RESET),
    *rows(
        (State.READY, State.ARMED, State.BRAKING, State.HOLDING),
        Event.RESET,
        State.READY,
        Action.RESET,
        Guard.MAY_RESET,
    ),
    *rows(_UNMEASURED, Event.RESET, None, Action.RESET, Guard.MAY_RESET),
    *rows(_LIVE, Event.FAILURE, State.FAILED, Action.LAST_RESORT),
)

ROWS = state_table.rows_by_event(TABLE)

#: What the arm brakes for, as `status` and the counters ``stops_<cause>`` name it.
CAUSES = {
    Event.STREAM_SILENT: "silence",
    Event.COMMAND_REFUSED: "refused",
    Event.SPEED_IGNORED: "speed_limit",
    Event.REPLIES_LOST: "replies",
    Event.DRIFTED: "drift",
    Event.CYCLE_REFUSED: "cycle",
    Event.STOP: "stop",
}


@dataclass(frozen=True, slots=True)
class Occasion:
    """Arguments of an event.

    Attributes:
        reason: The sentence with which the next state is entered.
        session, value: Of the control message.
        stamp, q: Of the command [ns], [rad].
        account: Whose `stop/<account>` it was; "": another way.
        ending: The program's own stop, because it ends.
    """

    reason: str = ""
    now: int = 0
    session: str = ""
    stamp: int = 0
    q: tuple[float, ...] = ()
    account: str = ""
    ending: bool = False
    value: object = None


class Machine:
    """The present state; it changes by the rows of the table, and in no other way.

    Args:
        guards: From the occasion to the sentence against the row; "" for none.
        actions: Return the sentence with which the next state is entered; None: the occasion's own.
        refusal: Returns the sentence about an event that the present state does not take.

    Attributes:
        changed: True after every change of state or reason, until it was published.
    """

    def __init__(
        self,
        reason: str,
        guards: Mapping[Guard, Callable[[Occasion], str]],
        actions: Mapping[Action, Callable[[Row, Occasion], str | None]],
        refusal: Callable[[], str],
    ):
        self.state = State.NO_CONTROLLER
        self.reason = self._entered_for = reason
        self.changed = True
        self.guards = {Guard.NONE: lambda _occasion: "", **guards}
        self.actions = {Action.NONE: lambda _row, _occasion: None, **actions}
        self._refusal = refusal

    def on(self, event: Event, occasion: Occasion) -> str:
        """Apply the first row whose guard holds; return "", or in one sentence why none was applied."""
        refusal = ""
        for row in ROWS[self.state, event]:
            refusal = self.guards[row.guard](occasion)
            if not refusal:
                sentence = self.actions[row.action](row, occasion)
                if row.target is not None:
                    self.state, self.changed = row.target, True
                    self.reason = self._entered_for = occasion.reason if sentence is None else sentence
                return ""
        return refusal or self._refusal()

    def append_to_reason(self, note: str) -> None:
        """Add to the reason for which the present state was entered, in place of what was added before."""
        self.reason = join_sentences(self._entered_for, note)

    def restore_reason(self) -> None:
        """Remove what was added to the reason."""
        if self.reason != self._entered_for:
            self.reason, self.changed = self._entered_for, True
