"""The executor's table: what it says of each state, and that the executor goes by it alone."""

from __future__ import annotations

import pytest
from construction_twin.msg import Execution
from executor_bench import Bench, make_plan, make_work_plan

from construction_twin.execution.states import (
    ACTIVE,
    MOVING,
    OUTCOMES,
    ROWS,
    TABLE,
    Action,
    ExecutorEvent,
    ExecutorState,
    Guard,
)
from construction_twin.monitor.settings import RESUME
from construction_twin.monitor.states import SyncState


def test_every_state_event_guard_and_action_means_something():
    assert {row.state for row in TABLE} == {row.target for row in TABLE} == set(ExecutorState)
    assert {row.event for row in TABLE} == set(ExecutorEvent)
    assert {row.guard for row in TABLE} == set(Guard) and {row.action for row in TABLE} == set(Action)


def test_an_approval_alone_leads_to_motion():
    begins = {row.event for row in TABLE if row.state not in ACTIVE and row.target in ACTIVE}
    assert begins == {ExecutorEvent.APPROVED}


def test_a_plan_ends_with_an_outcome_and_only_there():
    for row in TABLE:
        assert (row.action in OUTCOMES) is (row.state in ACTIVE and row.target not in ACTIVE), row


def test_a_stop_never_leads_to_motion_again():
    assert {row.target for row in TABLE if row.state is ExecutorState.STOPPING} <= {
        ExecutorState.STOPPING,
        ExecutorState.IDLE,
    }


def test_a_guard_without_a_row_behind_it_that_always_counts_is_none():
    for state in ExecutorState:
        for event in ExecutorEvent:
            rows = ROWS[state, event]
            assert not rows or rows[-1].guard is Guard.ALWAYS
            assert all(row.guard is not Guard.ALWAYS for row in rows[:-1])


def test_whatever_ends_a_motion_counts_in_every_state_that_moves():
    for event in (ExecutorEvent.STOP, ExecutorEvent.DISARMED, ExecutorEvent.GATE_ENDS, ExecutorEvent.NEW_SESSION):
        assert all(ROWS[state, event] for state in MOVING), event


def test_values_are_those_of_the_message():
    assert all(getattr(Execution, state.name) == state.value for state in ExecutorState)


def bench_in(state: ExecutorState) -> Bench:
    """Return an executor that was led to a state from outside."""
    bench = Bench()
    if state is ExecutorState.WAITING:
        return bench
    bench.ready()
    if state is ExecutorState.IDLE:
        return bench
    if state is ExecutorState.AT_BOUNDARY:
        bench.writes = False
        bench.with_tool().approve(make_work_plan(segment_0={"engaged": True}))
        return bench
    bench.play(make_plan(), 100)
    if state is ExecutorState.STOPPING:
        bench.executor.stop(0)
    elif state in (ExecutorState.PAUSING, ExecutorState.PAUSED):
        bench.executor.pause(0)
    elif state is ExecutorState.HELD:
        bench.executor.on_sync(SyncState.HOLDING, False, RESUME, bench.stamp)
    bench.run_until(state)
    return bench


#: What is called from outside, and the event that it is.
CALLS = {
    ExecutorEvent.STOP: lambda bench: bench.executor.stop(0),
    ExecutorEvent.DISARMED: lambda bench: bench.executor.on_link(False, "by the test"),
    ExecutorEvent.GATE_ENDS: lambda bench: bench.executor.on_sync(SyncState.STOPPED, False),
    ExecutorEvent.GATE_OPENS: lambda bench: bench.executor.on_sync(SyncState.IN_SYNC, True),
    ExecutorEvent.GATE_HOLDS: lambda bench: bench.executor.on_sync(SyncState.HOLDING, False, RESUME, bench.stamp),
    ExecutorEvent.STALLED: lambda bench: bench.executor.stall("by the test"),
}


@pytest.mark.parametrize("event", CALLS)
@pytest.mark.parametrize("state", ExecutorState)
def test_the_executor_goes_where_the_table_says(state, event):
    bench = bench_in(state)
    CALLS[event](bench)
    allowed = {row.target for row in ROWS[state, event]} or {state}
    assert bench.state in allowed
    ends = {row.target: OUTCOMES[row.action] for row in ROWS[state, event] if row.action in OUTCOMES}
    assert bench.executor.outcome == ends.get(bench.state, "")


@pytest.mark.parametrize("state", ExecutorState)
def test_a_new_session_leads_to_waiting_from_everywhere(state):
    bench = bench_in(state)
    bench.executor.restart("new command session", 0)
    assert (bench.state, bench.executor.reason) == (ExecutorState.WAITING, "new command session")
    assert bench.executor.outcome == ("dropped" if state in ACTIVE else "")
