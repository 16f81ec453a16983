"""The gateway's state, why it was entered, and how it changes: by the rows of its table, and in no other way."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from construction_twin.core.sentences import join_sentences
from construction_twin.gateway.states import ROWS, Action, Event, Guard, Occasion, Row, State


class Machine:
    """The present state.

    Args:
        guards: From the occasion to what speaks against the row, in a sentence; "" for nothing.
        actions: Takes row and occasion; returns the sentence with which the next state is entered, None for the occasion's own.
        refusal: Returns the sentence about an event that the present state does not take.

    Attributes:
        changed: True after every change of state or reason, until whoever reports it sets it to False.
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
