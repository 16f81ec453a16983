"""Why the mock did not take a reply: told when it begins and when it ends, kept for status and diagnostics."""

from __future__ import annotations

from mock_cell import AXES, WITH_STOP, ZERO, Cell, assert_stopped

from construction_twin.core.units import CYCLE
from construction_twin.rsi.gateway_codec import SensorEncoder

NO_STOP = "the reply has no Stop element"
STRICT = {"layout": WITH_STOP, "stop_required": True}
WITHOUT_STOP = SensorEncoder("ImFree", AXES)


def test_why_replies_are_refused_is_told_once_and_not_in_every_cycle():
    cell = Cell(**STRICT)
    for _ in range(50):
        cell.cycle(ZERO, encoder=WITHOUT_STOP)
    assert cell.mock.refusals.news == [f"reply refused: {NO_STOP}"]
    assert cell.mock.refusals.present == cell.mock.refusals.last == NO_STOP
    cell.cycle(ZERO, encoder=SensorEncoder("KROSHU", AXES))
    assert cell.mock.refusals.news[1:] == ["reply refused: the reply's Type is 'KROSHU'; expected the SENTYPE 'ImFree'"]


def test_that_replies_count_again_is_told_with_how_many_did_not():
    cell = Cell(**STRICT)
    for _ in range(3):
        cell.cycle(ZERO, encoder=WITHOUT_STOP)
    cell.mock.refusals.news.clear()
    cell.cycles(round(1.0 / CYCLE) - 1)
    assert not cell.mock.refusals.news and cell.mock.refusals.present
    cell.cycles(1)
    assert cell.mock.refusals.news == [f"replies count again; 3 were refused, the last one because {NO_STOP}"]
    assert cell.mock.refusals.present == "" and cell.mock.refusals.last == NO_STOP
    cell.cycle(ZERO, encoder=WITHOUT_STOP)
    assert cell.mock.refusals.news[-1] == f"reply refused: {NO_STOP}"


def test_every_second_reply_that_is_refused_makes_one_line_and_not_one_each():
    cell = Cell(**STRICT)
    for _ in range(500):
        cell.cycle(ZERO, encoder=WITHOUT_STOP)
        cell.cycle(ZERO)
    assert len(cell.mock.refusals.news) == 1


def test_a_time_out_names_the_refusal_of_the_last_reply():
    cell = Cell(**STRICT, timeout=5)
    cell.cycles(3)
    for _ in range(5):
        cell.cycle(ZERO, encoder=WITHOUT_STOP)
    assert_stopped(cell, f"timeout: 5 cycles without a valid reply; the last one was refused: {NO_STOP}")
    cell.mock.restart()
    assert cell.mock.refusals.present == "" and cell.mock.refusals.last == NO_STOP


def test_a_time_out_after_valid_replies_blames_no_old_refusal():
    cell = Cell(**STRICT, timeout=5)
    cell.cycle(ZERO, encoder=WITHOUT_STOP)
    cell.cycles(3)
    cell.cycles(5, None)
    assert cell.cycle(None) is None
    assert cell.mock.reason == "timeout: 5 cycles without a valid reply"


def test_late_and_foreign_ipocs_are_named():
    cell = Cell()
    cell.cycles(5)
    packet = cell.cycle(ZERO, ipoc_offset=-8)
    assert cell.mock.refusals.last == f"the reply to IPOC {packet.controller_ms - 8} came 2 cycles late"
    packet = cell.cycle(ZERO, ipoc_offset=1)
    assert cell.mock.refusals.last == (
        f"the reply carries IPOC {packet.controller_ms + 1}; expected that of the packet, unchanged: {packet.controller_ms}"
    )
