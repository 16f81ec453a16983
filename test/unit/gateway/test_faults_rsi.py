"""The network between gateway and controller fails, or the gateway does, while the arm moves.

No PC can prevent the step that HOLDON makes. So: the gateway's own sequence stays inside the limits, the mock controller stops at
`Timeout`, and the gateway comes back as docs/architecture.md, law 2, says.
"""

from __future__ import annotations

import pytest
from fault_cell import FaultCell
from impairment_profiles import Profile

from construction_twin.gateway.states import State
from construction_twin.link.observations import LinkState


def missed(cell, since=0):
    """Return how many cycles without a valid reply the controller counted, from packet number `since` on."""
    return sum(packet.missed > 0 for packet in cell.packets[since:])


def assert_recovered(cell):
    """The assertions that every case shares; returns the gateway's counters."""
    cell.wait_until_following()
    cell.assert_within_limits()
    counters = cell.counters()
    assert counters["stops_refused"] == 0, cell.describe()
    return counters


@pytest.mark.parametrize("lost", [1, 5])
def test_replies_dropped_on_the_network_are_not_made_up_in_a_step(tmp_path, lost):
    with FaultCell(tmp_path, udp=True, fraction=0.6) as cell:
        cell.move()
        since, before = len(cell.packets), cell.udp.counters["lost"]
        cell.udp.answers_to_lose = lost
        cell.wait(lambda: cell.udp.counters["lost"] == before + lost, "the replies to be lost")
        # the network is good again, so every packet tells what became of the reply before
        cell.wait(lambda: any(packet.missed >= lost for packet in cell.packets[since:]), "the controller to count them")
        assert cell.finish() == 0, "nobody needs to reset anything"
        assert missed(cell, since) >= lost
        assert any(entry.lost and entry.state is State.FOLLOWING for entry in cell.entries())
        counters = assert_recovered(cell)
        assert counters["standstills"] >= 1 and counters["delay_irregular"] == counters["stops_replies"] == 0
        cell.assert_nobody_restarted()


def test_after_a_cut_longer_than_timeout_the_next_session_begins_where_the_arm_stands(tmp_path):
    with FaultCell(tmp_path, udp=True) as cell:
        sessions = cell.counters()["rsi_sessions"]
        cell.move()
        cell.impair_rsi(Profile(cut=0.8))
        cell.wait(lambda: cell.mock.said("timeout: 100 cycles without a valid reply"), "the controller to stop")
        stopped = cell.packets[-1].measured
        cell.wait(lambda: cell.packets[-1].setpoint == stopped, "the controller's next session")
        cell.wait(lambda: cell.commander.link is LinkState.NEEDS_RESET, "the link to need a reset")
        assert any("no telegram for" in reason for reason in cell.gateway_reasons("no_controller"))
        assert cell.packets[-1].measured == stopped, "nothing drives the arm to the twin"
        assert cell.finish() >= 1, "a person is needed"
        assert assert_recovered(cell)["rsi_sessions"] > sessions
        cell.assert_nobody_restarted()


def test_a_killed_gateway_joins_the_running_session_and_waits_for_the_next(tmp_path):
    # a controller that waits long enough for the gateway's program to be started again
    with FaultCell(tmp_path, udp=True, mock_timeout=1000, timeout=1000) as cell:
        cell.move()
        cell.gateway.kill()
        killed = len(cell.packets)
        cell.wait(lambda: cell.commander.status.get("state") == "offline", "the last will")
        cell.start_gateway()
        cell.wait(lambda: cell.gateway_reasons("joined_running"), "the gateway to join the running session")
        assert "joined a running session" in cell.gateway_reasons("joined_running")[-1]
        cell.wait(lambda: cell.mock.said("timeout: 1000 cycles"), "the controller to stop")
        stopped = cell.packets[-1].measured
        assert {packet.measured for packet in cell.packets[killed + 5 :]} == {stopped}, "HOLDON"
        assert cell.finish() >= 1, "a person is needed"
        assert missed(cell) >= 999
        assert len([entry for entry in cell.entries() if entry.session == 1]) == 0, (
            "no reply to a session that it joined"
        )
        assert_recovered(cell)
