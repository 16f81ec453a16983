"""The gateway's table of states: every change of state is a row of it, and every row happens."""

from __future__ import annotations

import dataclasses

import pytest
from gateway_cell import Cell, following, gap, slow

from construction_twin.gateway.states import TABLE, Action, Event, Guard, Machine, State


@pytest.fixture
def changes(monkeypatch) -> list:
    """Record every row that a gateway takes from now on."""
    on, taken = Machine.on, []

    def watched(machine, event, occasion):
        before = machine.state
        refusal = on(machine, event, occasion)
        if not refusal:
            taken.append((before, event, machine.state))
        return refusal

    monkeypatch.setattr(Machine, "on", watched)
    return taken


def test_guards_and_actions_are_all_used_and_no_row_comes_twice():
    assert {row.guard for row in TABLE} == set(Guard)
    assert {row.action for row in TABLE} == set(Action)
    assert {row.event for row in TABLE} == set(Event)
    assert len(TABLE) == len(set(TABLE))
    machine = Cell().gateway.machine
    assert set(machine.guards) == set(Guard) and set(machine.actions) == set(Action)


def test_nothing_leads_out_of_failed():
    assert not [row for row in TABLE if row.state is State.FAILED]
    assert {row.state for row in TABLE if row.target is State.FAILED} == set(State) - {State.FAILED}


def in_state(state: State, measures: bool = False) -> Cell:
    if state is State.NO_CONTROLLER:
        return Cell()
    if state in (State.FOLLOWING, State.BRAKING, State.HOLDING):
        cell = following(measures=measures)
        if state is not State.FOLLOWING:
            cell.control("stop")
        if state is State.HOLDING:
            cell.cycle(250)
    elif state is State.READ_ONLY:
        layout = dataclasses.replace(Cell().config.layout, onlysend=True)
        cell = Cell(layout=layout)
        cell.cycle(3)
    elif state in (State.MEASURING, State.OTHER_CYCLE):
        cell = Cell(measures=True)
        cell.cycle(3 if state is State.MEASURING else 200, step_ms=4 if state is State.MEASURING else 12)
    elif state is State.JOINED:
        cell = Cell()
        cell.cycle(3, setpoint=(0.2, -1.0))
    else:
        cell = Cell(measures=measures)
        cell.cycle(110 if measures else 3)
        if state is State.ARMED:
            assert cell.arm()[0]
    assert cell.state is state
    return cell


def jump(cell):
    # the program was started again: its correction is zero
    cell.measured = cell.setpoint
    cell.ipoc += 5000
    cell.cycle()


def drift(cell):
    cell.setpoint = (cell.setpoint[0] + 0.01, cell.setpoint[1])
    cell.cycle()


def dry(cell):
    cell.cycle(100)


def lose_replies(cell):
    for k in range(700):
        cell.send(slow(100 + k))
        cell.cycle(missed=k + 1)


def ignore_speed_limit(cell):
    cell.control("speed_limit", value=0)
    for k in range(100, 800):
        if cell.state is not State.FOLLOWING:
            return
        cell.control("speed_limit", value=0)
        cell.send(slow(k))
        cell.cycle()


def join(cell):
    """Begin a session whose first telegram holds nothing but IPOC, and whose second one has no poses either."""
    cell.ipoc += 5000
    cell.cycle(2, measured=None, setpoint=None)


def change_cycle(cell):
    following = cell.state is State.FOLLOWING
    for k in range(30):
        for command in range(3 if following else 0):
            cell.send(slow(100 + 3 * k + command))
        cell.cycle(step_ms=12)


UNMEASURED = (State.MEASURING, State.OTHER_CYCLE)
HAPPENS = [
    *[
        (state, Event.SESSION_BEGAN, jump, State.READY)
        for state in State
        if state not in (State.READ_ONLY, State.FAILED, *UNMEASURED)
    ],
    *[(state, Event.SESSION_BEGAN, jump, State.MEASURING) for state in UNMEASURED],
    *[(state, Event.CYCLE_FITS, lambda cell: cell.cycle(1200), State.READY) for state in UNMEASURED],
    (State.MEASURING, Event.CYCLE_REFUSED, lambda cell: cell.cycle(200, step_ms=12), State.OTHER_CYCLE),
    (State.READY, Event.CYCLE_REFUSED, change_cycle, State.OTHER_CYCLE),
    (State.OTHER_CYCLE, Event.CYCLE_REFUSED, lambda cell: cell.cycle(1200, step_ms=8), State.OTHER_CYCLE),
    *[(state, Event.CYCLE_REFUSED, change_cycle, State.HOLDING) for state in (State.ARMED, State.FOLLOWING)],
    (State.MEASURING, Event.ORIGIN_REFUSED, join, State.JOINED),
    (State.READ_ONLY, Event.SESSION_BEGAN, jump, State.READ_ONLY),
    *[
        (state, Event.CONTROLLER_SILENT, gap, State.NO_CONTROLLER)
        for state in State
        if state not in (State.NO_CONTROLLER, State.FAILED)
    ],
    (State.READY, Event.ARM, lambda cell: cell.arm(), State.ARMED),
    (State.ARMED, Event.ARM, lambda cell: cell.arm(), State.ARMED),
    (State.FOLLOWING, Event.ARM, lambda cell: cell.arm(), State.FOLLOWING),
    (State.ARMED, Event.STREAM_BEGAN, lambda cell: cell.send(slow(0)), State.FOLLOWING),
    (State.FOLLOWING, Event.STREAM_SILENT, dry, State.HOLDING),
    (State.FOLLOWING, Event.COMMAND_REFUSED, lambda cell: cell.send((0.4, 3.0)), State.BRAKING),
    (State.FOLLOWING, Event.SPEED_IGNORED, ignore_speed_limit, State.HOLDING),
    (State.FOLLOWING, Event.REPLIES_LOST, lose_replies, State.HOLDING),
    (State.FOLLOWING, Event.DRIFTED, drift, State.BRAKING),
    (State.BRAKING, Event.AT_REST, dry, State.HOLDING),
    *[
        (state, Event.STOP, lambda cell: cell.control("stop"), State.BRAKING)
        for state in (State.READY, State.ARMED, State.FOLLOWING, State.BRAKING, State.HOLDING)
    ],
    *[
        (state, Event.STOP, lambda cell: cell.control("stop"), state)
        for state in (State.NO_CONTROLLER, State.READ_ONLY, State.JOINED, *UNMEASURED)
    ],
    *[
        (state, Event.RESET, lambda cell: cell.control("reset"), State.READY)
        for state in (State.READY, State.ARMED, State.HOLDING)
    ],
    *[(state, Event.RESET, lambda cell: cell.control("reset"), state) for state in UNMEASURED],
    *[
        (state, Event.FAILURE, lambda cell: cell.gateway.fail("failed: ZeroDivisionError"), State.FAILED)
        for state in State
        if state is not State.FAILED
    ],
]


@pytest.mark.parametrize("state, event, cause, end", HAPPENS, ids=lambda value: getattr(value, "name", None))
def test_a_row_happens(state, event, cause, end, changes):
    cell = in_state(state, measures=event is Event.CYCLE_REFUSED)
    changes.clear()
    cause(cell)
    assert (state, event) in [change[:2] for change in changes[:2]]
    assert cell.state is end
    expected = {(row.state, row.event, row.target or row.state) for row in TABLE}
    assert set(changes) <= expected


def test_every_row_but_those_of_the_origin_and_of_rest_before_a_reset_is_seen_to_happen():
    named = {(state, event) for state, event, _, _ in HAPPENS}
    missing = {(row.state, row.event) for row in TABLE} - named
    assert missing == {
        (State.READY, Event.ORIGIN_REFUSED),
        (State.FOLLOWING, Event.RESET),
        (State.BRAKING, Event.RESET),
    }


def test_a_failed_gateway_commands_nothing_and_says_so():
    cell = following()
    cell.gateway.fail("failed: ZeroDivisionError")
    assert cell.gateway.fault
    before = dict(cell.gateway.counters)
    assert cell.telegram() is None
    cell.send(slow(100))
    assert cell.gateway.counters["refused_not_armed"] == before.get("refused_not_armed", 0) + 1
    for ok, reason in (cell.arm("s2"), cell.control("reset")):
        assert not ok and reason == "gateway is failed: failed: ZeroDivisionError"
    assert cell.control("stop") == (True, "gateway is failed")
    cell.now += 10**10
    cell.gateway.poll(cell.now)
    assert cell.state is State.FAILED
