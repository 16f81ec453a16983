"""The monitor's state machine: what its table says. That the gate follows it: test_state_machine."""

from __future__ import annotations

from construction_twin.monitor.states import (
    TABLE,
    Action,
    Guard,
    SyncEvent,
    SyncState,
    Transition,
)


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


def test_a_transition_reads_as_a_sentence():
    change = Transition(1, SyncState.WAITING, SyncState.IN_SYNC, SyncEvent.OPENED, "poses agree", None, 0)
    assert str(change) == "WAITING -> IN_SYNC (opened): poses agree"
