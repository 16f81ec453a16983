"""The monitor's state machine: what its table says, and that it keeps every change with its cause."""

from __future__ import annotations

import pytest

from construction_twin.core.state_table import conditions
from construction_twin.monitor.states import (
    TABLE,
    Action,
    Guard,
    SyncEvent,
    SyncMachine,
    SyncOccasion,
    SyncState,
)

EVERY = [(state, event) for state in SyncState for event in SyncEvent]


class Machine(SyncMachine):
    """A machine whose guards all hold, but those in `closed`, and that notes what it does."""

    def __init__(self, closed: tuple[Guard, ...] = ()):
        self.done: list[tuple[Action, int]] = []
        guards = {guard: lambda occasion, guard=guard: guard not in closed for guard in Guard}
        super().__init__(conditions(guards), dict.fromkeys(Action, self._do))

    def _do(self, row, occasion) -> str:
        self.done.append((row.action, occasion.now))
        return self.reason if row.action is Action.KEEP_REASON else occasion.reason


def machine_in(state: SyncState, closed: tuple[Guard, ...] = ()) -> Machine:
    """Return a machine that was led to a state along the table."""
    way = {
        SyncState.WAITING: (),
        SyncState.IN_SYNC: (SyncEvent.OPENED,),
        SyncState.HOLDING: (SyncEvent.OPENED, SyncEvent.POSE_DIFFERS),
        SyncState.REPLANNING: (SyncEvent.OPENED, SyncEvent.POSE_DIFFERS, SyncEvent.REPLAN_ASKED),
        SyncState.STALE: (SyncEvent.OPENED, SyncEvent.FEEDBACK_STALE),
        SyncState.STOPPED: (SyncEvent.OPENED, SyncEvent.POSE_DIFFERS, SyncEvent.POLICY_STOP),
        SyncState.FAULT: (SyncEvent.OPENED, SyncEvent.SETPOINT_REFUSED),
    }[state]
    machine, led = Machine(closed), Machine()
    for event in way:
        assert not led.on(event, SyncOccasion("on the way", 1))
    assert led.state is state
    machine.state, machine.reason = led.state, led.reason
    return machine


class TestTable:
    def test_every_state_event_guard_and_action_means_something(self):
        assert {row.state for row in TABLE} == {row.target for row in TABLE} - {None} == set(SyncState)
        assert {row.event for row in TABLE} == set(SyncEvent)
        assert {row.guard for row in TABLE} == set(Guard) and {row.action for row in TABLE} == set(Action)

    def test_stopped_is_left_by_a_new_session_alone(self):
        leaving = {row.event for row in TABLE if row.state is SyncState.STOPPED is not row.target}
        assert leaving == {SyncEvent.NEW_SESSION}

    def test_only_opening_leads_to_in_sync(self):
        assert {row.event for row in TABLE if row.target is SyncState.IN_SYNC is not row.state} == {SyncEvent.OPENED}

    def test_values_are_those_of_the_message(self):
        assert [(state.name, state.value) for state in SyncState] == [
            ("WAITING", 0),
            ("IN_SYNC", 1),
            ("HOLDING", 2),
            ("REPLANNING", 3),
            ("STALE", 4),
            ("STOPPED", 5),
            ("FAULT", 6),
        ]


@pytest.mark.parametrize("state, event", EVERY, ids=lambda value: value.name.lower())
def test_an_event_leads_where_the_table_says_or_nowhere(state, event):
    machine = machine_in(state)
    before = machine.state, machine.reason
    row = machine.row(event, SyncOccasion(now=7))
    assert (not machine.on(event, SyncOccasion("why", 7, None, 5))) is (row is not None)
    assert machine.done == ([] if row is None else [(row.action, 7)])
    if row is None or row.target is None:
        assert (machine.state, machine.reason) == before and not machine.changed and machine.take() == []
        return
    reason = before[1] if event in (SyncEvent.CONFIGURED, SyncEvent.SERVOS_REFINED) else "why"
    assert (machine.state, machine.reason, machine.changed) == (row.target, reason, True)
    (change,) = machine.take()
    assert (change.at, change.source, change.target, change.event) == (7, state, row.target, event)
    assert (change.reason, change.comparison, change.held_stamp) == ("why", None, 5)
    assert not machine.changed


@pytest.mark.parametrize("row", [row for row in TABLE if row.guard is not Guard.ALWAYS], ids=str)
def test_a_row_whose_guard_does_not_hold_changes_nothing(row):
    machine = machine_in(row.state, closed=(row.guard,))
    assert machine.on(row.event, SyncOccasion("why", 7)) and machine.done == []
    assert machine.state is row.state and not machine.changed


def test_transitions_are_taken_once_and_in_order():
    machine = Machine()
    machine.on(SyncEvent.OPENED, SyncOccasion("first", 1))
    machine.on(SyncEvent.FEEDBACK_STALE, SyncOccasion("second", 2))
    assert [change.reason for change in machine.take()] == ["first", "second"]
    assert machine.take() == []


def test_a_transition_reads_as_a_sentence():
    machine = Machine()
    machine.on(SyncEvent.OPENED, SyncOccasion("poses agree", 1))
    assert str(machine.take()[0]) == "WAITING -> IN_SYNC (opened): poses agree"
