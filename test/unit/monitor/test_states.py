"""The monitor's state machine: what its table says, and that it keeps every change with its cause."""

from __future__ import annotations

import pytest

from construction_twin.monitor.states import HELD_STATES, TABLE, SyncEvent, SyncMachine, SyncState

EVERY = [(state, event) for state in SyncState for event in SyncEvent]


def machine_in(state: SyncState) -> SyncMachine:
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
    machine = SyncMachine()
    for event in way:
        assert machine.on(event, "on the way", 1)
    machine.take()
    assert machine.state is state
    return machine


class TestTable:
    def test_has_a_row_for_every_state(self):
        assert set(TABLE) == set(SyncState)

    def test_every_event_means_something_somewhere(self):
        assert {event for row in TABLE.values() for event in row} == set(SyncEvent)

    def test_stopped_is_left_by_a_new_session_alone(self):
        leaving = {event for event, target in TABLE[SyncState.STOPPED].items() if target is not SyncState.STOPPED}
        assert leaving == {SyncEvent.NEW_SESSION}

    def test_every_state_goes_back_to_waiting_with_a_new_session(self):
        assert {row[SyncEvent.NEW_SESSION] for row in TABLE.values()} == {SyncState.WAITING}

    def test_only_opening_leads_to_in_sync(self):
        leading = {
            event
            for state, row in TABLE.items()
            for event, target in row.items()
            if target is SyncState.IN_SYNC is not state
        }
        assert leading == {SyncEvent.OPENED}

    def test_other_settings_change_no_state_and_are_taken_only_where_nothing_holds(self):
        taken = {state: row[SyncEvent.CONFIGURED] for state, row in TABLE.items() if SyncEvent.CONFIGURED in row}
        assert taken == {state: state for state in set(SyncState) - HELD_STATES}

    def test_a_gate_that_holds_can_be_given_up(self):
        held = {SyncState.HOLDING, SyncState.REPLANNING, SyncState.STALE, SyncState.FAULT}
        assert held == HELD_STATES

    def test_a_refused_setpoint_is_not_planned_around(self):
        assert SyncEvent.REPLAN_ASKED not in TABLE[SyncState.FAULT]

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
    target = TABLE[state].get(event)
    assert machine.on(event, "why", 7, None, 5) is (target is not None)
    if target is None:
        assert (machine.state, machine.reason) == before and not machine.changed and machine.take() == []
        return
    reason = before[1] if event is SyncEvent.CONFIGURED else "why"
    assert (machine.state, machine.reason, machine.changed) == (target, reason, True)
    (change,) = machine.take()
    assert (change.at, change.source, change.target, change.event) == (7, state, target, event)
    assert (change.reason, change.comparison, change.held_stamp) == ("why", None, 5)
    assert not machine.changed


def test_transitions_are_taken_once_and_in_order():
    machine = SyncMachine()
    machine.on(SyncEvent.OPENED, "first", 1)
    machine.on(SyncEvent.FEEDBACK_STALE, "second", 2)
    assert [change.reason for change in machine.take()] == ["first", "second"]
    assert machine.take() == []


def test_a_transition_reads_as_a_sentence():
    machine = SyncMachine()
    machine.on(SyncEvent.OPENED, "poses agree", 1)
    assert str(machine.take()[0]) == "WAITING -> IN_SYNC (opened): poses agree"
