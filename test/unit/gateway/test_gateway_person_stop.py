"""A person's stop, `stop/<account>`: it needs no session, brakes inside the limits as the verb does, and says who it was."""

from __future__ import annotations

import pytest
from gateway_cell import RUN, Cell, following

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.mqtt.messages import Control, Intervention
from construction_twin.mqtt.requests import ANSWERS


def press(cell: Cell, account: str = "arm-stopper-bob", id_: str = "1"):
    return cell.gateway.on_stop(Intervention(account, id_), cell.now)


def test_it_brakes_exactly_as_the_verb_does():
    pressed, told = following(), following()
    press(pressed)
    told.gateway.on_control(Control("1", "anybody", "stop"), told.now)
    for cell in (pressed, told):
        cell.cycle(400)
    assert pressed.replies == told.replies


@pytest.mark.parametrize("prepare", ["nothing heard", "ready", "armed"])
def test_without_a_session_and_at_rest_it_is_not_forgotten_either(prepare):
    cell = Cell()
    if prepare != "nothing heard":
        cell.cycle(3)
    if prepare == "armed":
        assert cell.arm()[0]
    assert press(cell).ok
    cell.cycle(3)
    assert cell.gateway.fault and "reset first" in cell.arm("s2")[1]


def test_what_a_run_before_this_one_was_stopped_for_needs_a_reset_and_says_so():
    cell = Cell()
    cell.gateway = Gateway(cell.config, RUN, stopped="stop: asked for by account anna")
    cell.cycle(5)
    assert cell.gateway.fault and cell.gateway.fault_number == 1 and "account anna" in cell.gateway.reason
    assert not cell.arm()[0] and cell.state is State.READY
    assert cell.gateway.stopped == "stop: asked for by account anna", (
        "it is kept as it was, however often it is started"
    )
    assert cell.control("reset")[0] and cell.gateway.stopped == ""
    assert cell.arm()[0]


def test_what_is_kept_is_the_first_stop_that_nobody_has_reset_and_no_end_of_the_program():
    cell = Cell()
    cell.cycle(5)
    cell.gateway.end("the gateway is ending", True)
    assert cell.gateway.fault and cell.gateway.stopped == ""
    cell.gateway.stop("first")
    cell.gateway.stop("second")
    assert "first" in cell.gateway.stopped


def test_pressing_on_costs_a_count_and_no_answer():
    cell = following()
    assert all(press(cell, id_=str(k)).reason for k in range(ANSWERS))
    before = cell.gateway.status()
    cell.gateway.pop_change()
    assert [press(cell, id_=str(k)).reason for k in range(500)] == [""] * 500
    assert not cell.gateway.pop_change()
    after = cell.gateway.status()
    # a reset that is under way knows of none of them
    assert after["fault_number"] == before["fault_number"] + 500
    after["fault_number"] = before["fault_number"]
    assert after["counters"].pop("stops_repeated") == 500 and after == before
    # another one's is answered all the same, and its own a moment later
    assert press(cell, "arm-reviewer-ada").reason
    cell.now += NANOSECONDS
    assert press(cell).reason


def test_whoever_was_just_answered_stops_an_arm_that_moves_again():
    """The pace is one of answers: no stop of an arm that may move is left out."""
    cell = Cell()
    cell.cycle(3)
    while press(cell).reason:
        pass
    cell.cycle(3)
    assert cell.control("reset")[0] and cell.arm("s2")[0]
    assert press(cell).reason and cell.gateway.fault


def test_what_is_no_stop_is_refused_counted_and_moves_nothing():
    cell = following()
    wrong = PayloadError("stop", "no stop")
    answer = cell.gateway.refuse_stop("ada", wrong, cell.now)
    assert (answer.ok, answer.reason) == (False, "no stop")
    answered = [cell.gateway.refuse_stop("ada", wrong, cell.now).reason for _ in range(99)]
    assert answered.count("no stop") == ANSWERS - 1
    assert (cell.count("refused_stop"), cell.state) == (100, State.FOLLOWING)
    assert "no stop" in cell.gateway.status()["last_refusal"]
    # and takes the next real one nothing
    assert press(cell, "ada").reason and cell.state is State.BRAKING
