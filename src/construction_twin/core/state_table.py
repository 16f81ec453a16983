"""A state machine as one table of state, event, guard, action and next state: its rows, how they are found and how they are told.

States, events, guards and actions are Enums of the machine's own. What a guard asks and an action does is the machine's business;
their values are the words of the documentation, "" for a guard that always holds and an action that does nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)
G = TypeVar("G", bound=Enum)
A = TypeVar("A", bound=Enum)


@dataclass(frozen=True, slots=True)
class Row(Generic[S, E, G, A]):
    """One row of a table: in `state`, when `event` happens and `guard` holds, do `action` and go to `target`.

    Attributes
    ----------
    state, event, guard, action : Enum
        Rows of the same state and event are tried in order; the first one whose guard holds applies.
    target : Enum or None
        Next state; None: the state stays what it is.
    """

    state: S
    event: E
    guard: G
    action: A
    target: S | None


def rows(states: Iterable[S], event: E, guard: G, action: A, target: S | None) -> list[Row[S, E, G, A]]:
    """Return the same row for several states."""
    return [Row(state, event, guard, action, target) for state in states]


def by_cause(table: tuple[Row[S, E, G, A], ...]) -> dict[tuple[S, E], tuple[Row[S, E, G, A], ...]]:
    """Return the rows for each state and event, in the order in which they are tried; none for an event that changes nothing."""
    states, events = type(table[0].state), type(table[0].event)
    return {
        (state, event): tuple(row for row in table if row.state is state and row.event is event)
        for state in states
        for event in events
    }


def cells(table: tuple[Row, ...]) -> list[tuple[str, str, str, str, str]]:
    """Return a table in words, for the documentation: state, event, guard, action, next state ("" where it stays)."""
    return [
        (_name(row.state), row.event.value, row.guard.value, row.action.value, _name(row.target) if row.target else "")
        for row in table
    ]


def _name(state: Enum) -> str:
    # where messages hold a number, people read the name
    return state.value if isinstance(state.value, str) else state.name
