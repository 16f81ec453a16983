"""Why the mock did not take a reply: told when it begins and when it ends, kept for status and diagnostics."""

from __future__ import annotations

from mock_cell import AXES, ZERO, Cell, assert_stopped

from construction_twin.rsi.gateway_codec import SensorEncoder

NO_AK = "the reply has no AK element"
OTHER_NAMES = SensorEncoder("ImFree", AXES, tuple(f"AKorr.{axis}" for axis in AXES))


def test_why_replies_are_refused_is_told_once_and_not_in_every_cycle():
    cell = Cell()
    for _ in range(50):
        cell.cycle(ZERO, encoder=OTHER_NAMES)
    assert cell.mock.refusals.log_lines == [f"reply refused: {NO_AK}"]
    assert cell.mock.refusals.present == cell.mock.refusals.last == NO_AK
    cell.cycle(ZERO, encoder=SensorEncoder("KROSHU", AXES))
    assert cell.mock.refusals.log_lines[1:] == [
        "reply refused: the reply's Type is 'KROSHU'; expected the SENTYPE 'ImFree'"
    ]


def test_a_time_out_names_the_refusal_of_the_last_reply():
    cell = Cell(timeout=5)
    cell.cycles(3)
    for _ in range(5):
        cell.cycle(ZERO, encoder=OTHER_NAMES)
    assert_stopped(cell, f"timeout: 5 cycles without a valid reply; the last one was refused: {NO_AK}")
    cell.mock.restart()
    assert cell.mock.refusals.present == "" and cell.mock.refusals.last == NO_AK
