"""The link's table: complete, unambiguous, and carried out by the supervisor as it is written down."""

from __future__ import annotations

import itertools

import pytest
from supervisor_bench import armed, bench

from construction_twin.core.state_table import Occasion, cells
from construction_twin.link.states import (
    BARE_ROWS,
    BARE_TABLE,
    ROWS,
    TABLE,
    Action,
    Guard,
    LinkEvent,
    LinkState,
)

#: Fixtures of the bench.
__all__ = ["armed", "bench"]


def test_every_event_guard_and_action_is_used():
    table = TABLE + BARE_TABLE
    assert {row.event for row in table} == set(LinkEvent)
    assert {row.guard for row in table} == set(Guard)
    assert {row.action for row in table} == set(Action)


def test_no_row_stands_behind_one_that_always_counts():
    for rows in [*ROWS.values(), *BARE_ROWS.values()]:
        assert all(row.guard is not Guard.ALWAYS for row in rows[:-1])
        assert len({row.guard for row in rows}) == len(rows)


def test_only_an_accepted_arm_leads_to_armed_and_only_from_resync():
    leading = [row for row in TABLE if row.target is LinkState.ARMED]
    assert [(row.event, row.state) for row in leading] == [(LinkEvent.ARM_ACCEPTED, LinkState.RESYNC)]


def test_only_a_person_s_name_leads_a_bare_plc_to_armed():
    leading = [row for row in BARE_TABLE if row.target is LinkState.ARMED]
    assert [(row.event, row.state, row.action) for row in leading] == [
        (LinkEvent.TURN, LinkState.RESYNC, Action.NOTE_RESPONSIBLE)
    ]
    into_resync = [row for row in BARE_TABLE if row.target is LinkState.RESYNC is not row.state]
    assert [(row.event, row.state) for row in into_resync] == [(LinkEvent.RESPONSIBILITY_TAKEN, LinkState.NEEDS_RESET)]
    assert not {row.action for row in BARE_TABLE} & {Action.SEND_ARM, Action.SEND_RESET, Action.RESET_OLD_SESSION}


def test_halt_leads_from_everywhere_to_a_state_that_only_a_person_or_an_interruption_leaves_without_guards():
    for state in LinkState:
        assert [row.target for row in ROWS[state, LinkEvent.HALTED]] == [LinkState.NEEDS_RESET]
    guards = [row.guard for row in ROWS[LinkState.NEEDS_RESET, LinkEvent.PRESENT]]
    # asked first, so that neither of the two that begin a session is asked at all
    assert guards.index(Guard.HALTED_HERE) < guards.index(Guard.FIRST_SESSION)
    assert guards.index(Guard.FAULT) < guards.index(Guard.FIRST_SESSION) < guards.index(Guard.NOTHING_COULD_JUMP)


def test_no_event_arms_or_begins_a_session_without_broker_gateway_and_arm():
    for state, event in itertools.product(LinkState, LinkEvent):
        if event in (LinkEvent.BROKER_LOST, LinkEvent.GATEWAY_LOST, LinkEvent.MISMATCHED, LinkEvent.CONTROLLER_LOST):
            assert [row.action for row in ROWS[state, event]] == [Action.FORGET_REQUESTS]


def test_messages_are_sent_only_in_resync_and_mirror():
    sending = {Action.SEND_ARM, Action.SEND_RESET, Action.RESET_OLD_SESSION}
    assert {row.state for row in TABLE if row.action in sending} == {
        LinkState.RESYNC, LinkState.MIRROR,
    }  # fmt: skip


@pytest.mark.parametrize("event", LinkEvent)
@pytest.mark.parametrize("state", LinkState)
def test_the_supervisor_carries_out_every_row_that_a_state_and_an_event_have(armed, state, event):
    """The first row whose guard holds is the one: the target is its, and everything that it names is implemented."""
    supervisor = armed.supervisor
    for row in ROWS[state, event]:
        assert supervisor.machine.holds(row.guard, Occasion(now=armed.now)) in (True, False)
    rows = [row for row in ROWS[state, event] if supervisor.machine.holds(row.guard, Occasion(now=armed.now))]
    supervisor.machine.state = state
    supervisor.take(event, armed.now, "why")
    assert supervisor.state is (rows[0].target if rows else state)


def test_values_are_those_of_the_message():
    assert [(state.name, state.value) for state in LinkState] == [
        ("DISCONNECTED", 0), ("GATEWAY_OFFLINE", 1), ("NO_CONTROLLER", 2), ("MISMATCH", 3), ("RESYNC", 4),
        ("ARMED", 5), ("NEEDS_RESET", 6), ("MIRROR", 7),
    ]  # fmt: skip


def test_the_documentation_s_table_has_a_line_for_every_row():
    told = cells(TABLE)
    assert len(told) == len(TABLE) and told[0][0] == "DISCONNECTED" and told[-1][-1] == "ARMED"
    assert not any("|" in text or "\n" in text for row in told for text in row)
