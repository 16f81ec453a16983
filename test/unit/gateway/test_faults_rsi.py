"""The network between gateway and controller fails, or the gateway does, while the arm moves.

No PC can prevent the step that HOLDON makes. So: the gateway's own sequence stays inside the limits, the mock controller holds in
every missed cycle and stops at `Timeout`, the gateway comes back as docs/architecture.md, law 2, says, and the step is printed
(`pytest -s`).
"""

from __future__ import annotations

import itertools

import pytest
from fault_cell import GOAL, FaultCell, judge_arm
from impairment_profiles import UDP_PROFILES, Profile

from construction_twin.gateway.states import State
from construction_twin.link.states import LinkState

HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)


def report(name, cell, since=0):
    """Check HOLDON in what the controller sent since packet number `since`, and print the step."""
    found = judge_arm(cell.packets[since:], cell.config.limits)
    print(f"\nRSI fault {name}: {found}")
    return found


def assert_recovered(cell):
    """The assertions that every case shares; returns the gateway's counters."""
    cell.wait_until_following()
    cell.assert_within_limits()
    counters = cell.counters()
    assert counters["stops_refused"] == 0, cell.describe()
    return counters


def test_lost_late_repeated_and_reordered_datagrams(tmp_path):
    with FaultCell(tmp_path, udp=True, fraction=0.35) as cell:
        goals, worst = [HOME, GOAL], {}
        for name, profile in UDP_PROFILES.items():
            since, carried = len(cell.packets), dict(cell.udp.counters)
            cell.impair_rsi(profile)
            goals.reverse()
            cell.move(goals[0])
            cell.finish(goals[0])
            cell.impair_rsi(Profile())
            cell.wait_until_following()
            worst[name] = report(name, cell, since)
            for counter, fraction in (
                ("lost", profile.loss),
                ("held_back", profile.reordering),
                ("duplicated", profile.duplication),
            ):
                happened = cell.udp.counters[counter] - carried.get(counter, 0)
                assert not fraction or happened > 0, f"{name}: nothing was {counter}"
                # packet or reply lost: either way the controller misses that cycle, beside those this machine is late in
                assert counter != "lost" or worst[name].missed >= happened, f"{name}: {happened} datagrams were lost"
        assert worst["loss_5"].blow > 0.01
        assert assert_recovered(cell)["telegrams_repeated"] > 0, "duplicated telegrams are noticed"
        cell.assert_nobody_restarted()


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
        found = report(f"{lost} replies lost", cell, since)
        assert found.missed >= lost and found.starts >= 1
        assert any(entry.lost and entry.state is State.FOLLOWING for entry in cell.entries())
        counters = assert_recovered(cell)
        assert counters["standstills"] >= 1 and counters["delay_irregular"] == counters["stops_replies"] == 0
        cell.assert_nobody_restarted()


def test_a_controller_at_12_ms_is_led_through_a_bad_network_by_a_stream_of_250_hz(tmp_path):
    with FaultCell(tmp_path, udp=True, fraction=0.5, cycle=12) as cell:
        cell.move(GOAL)
        cell.impair_rsi(UDP_PROFILES["loss_5"])
        cell.finish(GOAL)
        cell.impair_rsi(Profile())
        cell.move(HOME)
        cell.finish(HOME)
        # not every datagram comes through, but none is ever less than a cycle away from the one before
        steps = {after.ipoc - before.ipoc for before, after in itertools.pairwise(cell.entries())}
        assert min(steps) == 12 and not any(step % 12 for step in steps)
        cycle = cell.commander.status["cycle"]
        assert (cycle["expected_ms"], cycle["ipoc_step_ms"]) == (12, 12)
        assert_recovered(cell)
        cell.assert_nobody_restarted()


def test_a_cut_shorter_than_timeout_leaves_the_session_alone(tmp_path):
    with FaultCell(tmp_path, udp=True) as cell:
        sessions = cell.counters()["rsi_sessions"]
        cell.move()
        cell.impair_rsi(Profile(cut=0.2))
        cell.wait(lambda: cell.packets[-1].missed >= 25, "the controller to miss replies")
        cell.finish()
        found = report("cut of 0.2 s", cell)
        assert found.missed >= 25
        counters = assert_recovered(cell)
        cell.assert_nobody_restarted()
        if not cell.mock.said("stopped"):
            assert counters["rsi_sessions"] == sessions


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
        report("cut of 0.8 s", cell)
        assert assert_recovered(cell)["rsi_sessions"] > sessions
        cell.assert_nobody_restarted()


@pytest.mark.parametrize("seconds", [0.02, 0.2])
def test_late_replies(tmp_path, seconds):
    with FaultCell(tmp_path, udp=True) as cell:
        cell.move()
        cell.freeze_gateway(seconds)
        cell.finish()
        found = report(f"gateway not run for {seconds} s", cell)
        assert found.missed >= round(seconds / 0.004) - 1
        assert_recovered(cell)
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
        found = report("gateway killed", cell)
        assert found.missed >= 999
        assert len([entry for entry in cell.entries() if entry.session == 1]) == 0, (
            "no reply to a session that it joined"
        )
        assert_recovered(cell)
