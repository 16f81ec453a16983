"""A state machine as one table of state, event, guard, action and next state.

Each is an Enum of the machine; the value "" is the guard that always holds, and the action that does nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)
G = TypeVar("G", bound=Enum)
A = TypeVar("A", bound=Enum)


@dataclass(frozen=True, slots=True)
class Row(Generic[S, E, G, A]):
    """In `state`, when `event` happens and `guard` holds, do `action` and go to `target`; None: the state and its reason stay."""

    state: S
    event: E
    guard: G
    action: A
    target: S | None


class Rows(Generic[S, E, G, A]):
    """Makes the rows of one table of these Enums; by default the guard always holds, and the action does nothing."""

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


def rows_by_event(table: tuple[Row[S, E, G, A], ...]) -> dict[tuple[S, E], tuple[Row[S, E, G, A], ...]]:
    """Return the rows for each state and event, in the order in which they are tried: the first whose guard holds applies."""
    states, events = type(table[0].state), type(table[0].event)
    return {
        (state, event): tuple(row for row in table if row.state is state and row.event is event)
        for state in states
        for event in events
    }


def row_of(rows: Causes[S, E, G, A], state: S, event: E, holds: Callable[[G], bool]) -> Row[S, E, G, A] | None:
    """Return the row that applies to an event; None: it changes nothing."""
    return next((row for row in rows[state, event] if not row.guard.value or holds(row.guard)), None)
