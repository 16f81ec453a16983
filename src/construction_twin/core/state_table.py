"""A state machine: one table of state, event, guard, action and next state, and the one runner of such tables.

States, events, guards and actions are Enums of the machine's own; their values are the words of the documentation, "" for the guard
that always holds and for the action that does nothing. What a guard asks and an action does are functions that the machine's owner
gives. Pure, standard library only; time comes with an occasion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from construction_twin.core.sentences import Sentence, both

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)
G = TypeVar("G", bound=Enum)
A = TypeVar("A", bound=Enum)


@dataclass(frozen=True, slots=True)
class Row(Generic[S, E, G, A]):
    """One row of a table: in `state`, when `event` happens and `guard` holds, do `action` and go to `target`.

    Attributes:
        state, event, guard, action: Rows of the same state and event are tried in order; the first one whose guard holds applies.
        target: Next state; None: the state stays what it is, and so does its reason.
    """

    state: S
    event: E
    guard: G
    action: A
    target: S | None


class Rows(Generic[S, E, G, A]):
    """Makes the rows of one table of these Enums, the same one for a state, or for several.

    Without another word a guard is the one that always holds, and an action does nothing.
    """

    def __init__(self, states: type[S], events: type[E], guards: type[G], actions: type[A]):
        self._always, self._nothing = guards(""), actions("")

    def __call__(
        self,
        states: S | Iterable[S],
        event: E,
        target: S | None = None,
        action: A | None = None,
        guard: G | None = None,
    ) -> list[Row[S, E, G, A]]:
        """Return one row for each state."""
        guard, action = guard or self._always, action or self._nothing
        return [
            Row(state, event, guard, action, target) for state in ([states] if isinstance(states, Enum) else states)
        ]


#: The rows for each state and event, in the order in which they are tried.
Causes = Mapping[tuple[S, E], tuple[Row[S, E, G, A], ...]]


def by_cause(table: tuple[Row[S, E, G, A], ...]) -> dict[tuple[S, E], tuple[Row[S, E, G, A], ...]]:
    """Return the rows for each state and event, in the order in which they are tried; none for an event that changes nothing."""
    states, events = type(table[0].state), type(table[0].event)
    return {
        (state, event): tuple(row for row in table if row.state is state and row.event is event)
        for state in states
        for event in events
    }


def row_of(rows: Causes[S, E, G, A], state: S, event: E, holds: Callable[[G], bool]) -> Row[S, E, G, A] | None:
    """Return the row that applies to an event, for a state that is a value and not a machine's; None: the event does not fit."""
    return next((row for row in rows[state, event] if not row.guard.value or holds(row.guard)), None)


@dataclass(frozen=True, slots=True)
class Occasion:
    """What came with an event.

    Attributes:
        reason: One sentence for people: why the next state is entered.
        now: When [ns], on the machine's own clock.
    """

    reason: str = ""
    now: int = 0


Occ = TypeVar("Occ", bound=Occasion)


class Machine(Generic[S, E, G, A, Occ]):
    """The present state, why it was entered, and how it changes: by the rows of a table, and in no other way.

    Args:
        guards: From the occasion to what speaks against the row, in a sentence; "" for nothing. See `conditions`.
        actions: Takes row and occasion; returns the sentence with which the next state is entered, None for the occasion's own.
        refusal: Returns the sentence about an event that the present state does not take; None: one with state and reason.

    Attributes:
        changed: True after every change of state or reason, until whoever reports it sets it to False.
    """

    def __init__(
        self,
        rows: Causes[S, E, G, A],
        state: S,
        reason: str,
        guards: Mapping[G, Callable[[Occ], str]],
        actions: Mapping[A, Callable[[Row[S, E, G, A], Occ], str | None]],
        refusal: Callable[[], str] | None = None,
        after: Callable[[Row[S, E, G, A], Occ], None] | None = None,
    ):
        self.state = state
        self.reason = self._entered_for = reason
        self.changed = True
        self._rows = rows
        self._guards, self._actions = dict(guards), dict(actions)
        self._refusal, self._after = refusal or self._is_not_taken, after
        for row in (row for of_cause in rows.values() for row in of_cause):
            if not row.guard.value:
                self._guards.setdefault(row.guard, lambda _occasion: "")
            if not row.action.value:
                self._actions.setdefault(row.action, lambda _row, _occasion: None)
            missing = {row.guard} - self._guards.keys() or {row.action} - self._actions.keys()
            if missing:
                raise ValueError(f"the table's {missing.pop()} has no function")

    def row(self, event: E, occasion: Occ) -> Row[S, E, G, A] | None:
        """Return the row that would apply to an event now; None: the event changes nothing."""
        for row in self._rows[self.state, event]:
            if not self._guards[row.guard](occasion):
                return row
        return None

    def on(self, event: E, occasion: Occ) -> str:
        """Take an event.

        Returns:
            "" when a row was applied; else in one sentence why none was.
        """
        refusal = ""
        for row in self._rows[self.state, event]:
            refusal = self._guards[row.guard](occasion)
            if not refusal:
                said = self._actions[row.action](row, occasion)
                if row.target is not None:
                    self.state, self.changed = row.target, True
                    self.reason = self._entered_for = occasion.reason if said is None else said
                if self._after is not None:
                    self._after(row, occasion)
                return ""
        return refusal or self._refusal()

    def _is_not_taken(self) -> str:
        return Sentence("it is {state}: {reason}", state=_name(self.state), reason=self.reason)

    def add(self, note: str) -> None:
        """Add to the reason for which the present state was entered, in place of what was added before."""
        self.reason = both(self._entered_for, note)

    def drop(self) -> None:
        """Take back what was added."""
        if self.reason != self._entered_for:
            self.reason, self.changed = self._entered_for, True


def conditions(asked: Mapping[G, Callable[[Occ], bool]]) -> dict[G, Callable[[Occ], str]]:
    """Return guards that are true or false as guards that say what speaks against a row: that the guard does not hold."""
    return {guard: _condition(f"not so: {guard.value}", holds) for guard, holds in asked.items()}


def _condition(refusal: str, holds: Callable[[Occ], bool]) -> Callable[[Occ], str]:
    return lambda occasion: "" if holds(occasion) else refusal


def _name(state: Enum) -> str:
    # where messages hold a number, people read the name
    return state.value if isinstance(state.value, str) else state.name
