"""The network between ROS PC and cell PC fails in every way it knows, while the arm moves. Real broker, gateway program and mock.

In every case: what the gateway sends stays inside the limits in every cycle, the arm ends at its goal, both directions come back
by themselves, no process is started again, and the state says what happened.
"""

from __future__ import annotations

import itertools

import pytest
from fault_cell import GOAL, FaultCell
from impairment_profiles import TCP_PROFILES, Profile

from construction_twin.link.observations import LinkState

HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)


def assert_recovered(cell):
    """The assertions that every case shares; returns the gateway's counters."""
    cell.wait_until_following()
    cell.assert_within_limits()
    cell.assert_nobody_restarted()
    counters = cell.counters()
    if counters["stops_silence"]:
        told = [r for state in ("braking", "holding") for r in cell.gateway_reasons(state)]
        assert any(reason.startswith("silence: ") for reason in told), cell.describe()
    assert counters["stops_refused"] == 0, cell.describe()
    return counters


@pytest.mark.parametrize("name", ["delay_20_10", "stall_50ms_1s", "throttled"])
def test_a_bad_network_does_not_stop_a_motion(tmp_path, name):
    with FaultCell(tmp_path) as cell:
        cell.impair(TCP_PROFILES[name])
        cell.move()
        resets = cell.finish()
        counters = assert_recovered(cell)
        # a sender that this machine did not run for long is a fault of its own
        if cell.commander.longest_pause < 0.05:
            assert resets == 0 and counters["stops_silence"] == 0, cell.describe()


def move_until_struck(cell, goals):
    """Move to and fro until a stall strikes the arm in motion, and on to that goal.

    Returns the delay before [s], how often `reset` was called, how often the gateway braked for silence, and the goal.
    """
    for goal in itertools.islice(itertools.cycle(goals), 6):
        stops, delay = cell.counters()["stops_silence"], cell.commander.status["playout"]["delay_ms"] / 1e3
        struck, resets = cell.move_into_a_stall(goal), cell.finish(goal)
        if struck:
            return delay, resets, cell.counters()["stops_silence"] - stops, goal
        # the machine did not run one of us in time: the motion was held or over before the stall
    raise AssertionError(f"no stall struck a motion: {cell.tcp.stalls}; {cell.describe()}")


@pytest.mark.parametrize("feedback_timeout", [None, 0.1], ids=["going_on", "gated"])
def test_stalls_beyond_the_silence_stop_the_arm_at_most_once(tmp_path, feedback_timeout):
    with FaultCell(tmp_path, feedback_timeout=feedback_timeout) as cell:
        profile = TCP_PROFILES["stall_200ms_5s"]
        cell.impair(profile)
        delay, resets, stops, goal = move_until_struck(cell, (GOAL, HOME))
        assert resets <= 1
        # a sender that this machine did not run for long is a fault of its own, and such jitter makes the delay longer beforehand
        if cell.commander.longest_pause < 0.05 and delay < 0.05:
            # the arm stopped short of the twin, and nothing may drive it there: it takes a person's `reset`, and it is no fault
            assert (resets, stops) == (1, 1), cell.describe()
            assert "silence: " in cell.seen(LinkState.NEEDS_RESET)[-1]
        # the delay has grown by now: the same stall, another motion
        cell.wait(
            lambda: cell.commander.status["playout"]["delay_ms"] >= 1e3 * profile.stall[1], "a delay that absorbs it"
        )
        _, resets, stops, _ = move_until_struck(cell, (HOME, GOAL) if goal == GOAL else (GOAL, HOME))
        if cell.commander.longest_pause < 0.05:
            assert (resets, stops) == (0, 0), cell.describe()
        assert_recovered(cell)


def test_a_stall_that_no_delay_may_absorb_stops_the_arm_until_a_person_resets(tmp_path):
    # whatever the machine's own jitter has taught before: with this bound 200 ms are always more than delay and silence
    with FaultCell(tmp_path, playout_delay_max=0.05) as cell:
        cell.impair(TCP_PROFILES["stall_200ms_5s"])
        delay, resets, stops, _ = move_until_struck(cell, (GOAL, HOME))
        assert delay <= 0.05 and stops >= 1 and resets >= 1, cell.describe()
        assert "silence: " in cell.seen(LinkState.NEEDS_RESET)[-1]
        if cell.commander.longest_pause < 0.05:
            assert resets == 1, cell.describe()
        assert not cell.commander.status["fault"]
        assert_recovered(cell)


def test_a_cut_in_mid_motion_stops_the_arm_until_a_person_resets(tmp_path):
    with FaultCell(tmp_path) as cell:
        cell.move()
        cell.impair(TCP_PROFILES["cut_1s"])
        cell.wait(lambda: cell.commander.link is LinkState.NEEDS_RESET, "the link to need a reset")
        assert "silence: no command for" in cell.seen(LinkState.NEEDS_RESET)[-1]
        cell.wait(lambda: cell.gateway_reasons("holding"), "the gateway to say that it holds")
        assert cell.finish() == 1
        assert_recovered(cell)


def test_a_cut_at_rest_ends_by_itself(tmp_path):
    with FaultCell(tmp_path) as cell:
        session = cell.commander.status["session"]
        cell.impair(TCP_PROFILES["cut_1s"])
        cell.wait(lambda: cell.gateway_reasons("holding"), "the gateway to notice")
        cell.wait_until_following()
        assert cell.commander.status["session"] not in ("", session)
        # what is judged is the time from here
        cell.commander.longest_pause = 0.0
        resets = cell.finish(GOAL)
        # a sender that this machine did not run for long is a fault of its own
        if cell.commander.longest_pause < 0.05:
            assert resets == 0, cell.describe()
        assert_recovered(cell)


def test_broken_connections_are_made_again(tmp_path):
    with FaultCell(tmp_path) as cell:
        cell.move()
        cell.network.reset(cell.tcp)
        cell.wait(lambda: "offline" in [status.get("state") for status in cell.commander.statuses], "the last will")
        # it says whose it is: a late one must not be taken for another run's
        wills = [status for status in cell.commander.statuses if status.get("state") == "offline"]
        assert {will.get("run") for will in wills} == {cell.commander.statuses[0]["run"]}
        cell.finish()
        assert cell.tcp.counters["connections"] >= 2
        assert cell.seen(LinkState.GATEWAY_OFFLINE)
        assert_recovered(cell)


def test_a_broker_that_cannot_be_reached_for_5_s(tmp_path):
    with FaultCell(tmp_path) as cell:
        cell.move()
        cell.impair(Profile(cut=5.0))
        cell.wait(lambda: cell.commander.link is not LinkState.ARMED, "the link to notice")
        cell.finish()
        assert cell.seen(LinkState.GATEWAY_OFFLINE)
        assert_recovered(cell)


def test_a_broker_that_is_killed_and_started_again(tmp_path):
    with FaultCell(tmp_path) as cell:
        cell.move()
        cell.broker.kill()
        cell.wait(lambda: cell.commander.link is LinkState.DISCONNECTED, "the link to notice")
        cell.broker.start()
        assert cell.finish() == 1
        assert "silence: " in cell.seen(LinkState.NEEDS_RESET)[-1]
        assert_recovered(cell)
