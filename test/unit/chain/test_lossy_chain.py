"""Datagrams that get lost between gateway and controller: the arm stands for a cycle each time, and nothing is held for it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from chain_samples import make_plan
from servo_chain import NOMINAL, poses, servo_chain, sweep

from construction_twin.execution.executor import ExecutorState
from construction_twin.gateway.states import State
from construction_twin.mock.faults import Fault
from construction_twin.monitor import comparison
from construction_twin.monitor.states import SyncState
from construction_twin.mqtt.messages import Control


def left_in_sync(chain) -> list[str]:
    """Return why the gate closed, each time."""
    return [str(change) for change in chain.transitions if change.source is SyncState.IN_SYNC]


def lossy(share: float, servos=NOMINAL):
    """Return a chain in which a share of all datagrams is lost, in either direction."""
    chain = servo_chain(servos)
    chain.transitions.clear()
    chain.faults.inject(Fault("drop", values=(share,)))
    return chain


@pytest.mark.parametrize("servos", [NOMINAL, None], ids=["servos known", "not known"])
@pytest.mark.parametrize("share, plans", [(0.01, 6), (0.05, 2)])
def test_plans_at_full_speed_are_played_to_their_ends_although_datagrams_are_lost(share, plans, servos):
    chain = lossy(share, servos)
    waited = False
    for goal in itertools.islice(poses(7), plans):
        chain.play(make_plan(chain, goal))

        def over() -> bool:
            nonlocal waited
            waited = waited or chain.executor.limit.waits
            return chain.executor.outcome != ""

        assert chain.run_until(over, 60.0)
        assert (chain.executor.outcome, chain.gateway.state) == ("finished", State.FOLLOWING), chain.executor.reason
        # a plan that is approved earlier waits for it, and not for ever
        assert chain.run_until(lambda: not chain.trails >= 0.1, 60.0)
        chain.run_for(0.5)
    chain.faults.end(Fault("drop"))
    # what was put off is played
    assert chain.run_until(lambda: np.allclose(chain.controller.measured, goal, atol=1e-4), 10.0)
    assert left_in_sync(chain) == []
    assert chain.gateway.counters["standstills"] > 20 and waited


def test_one_lost_reply_at_full_speed_is_one_standstill_and_no_hold():
    chain = servo_chain(NOMINAL)
    plan, fastest, speed = sweep(chain, 0)
    chain.transitions.clear()
    chain.play(plan)
    chain.run_for(fastest)
    chain.faults.inject(Fault("drop", values=(1.0,), direction="to_controller", duration=0.008))
    assert chain.run_until(lambda: chain.executor.outcome != "", plan.trajectory.duration + 5.0)
    assert chain.executor.outcome == "finished" and left_in_sync(chain) == []
    assert chain.gateway.counters["standstills"] == 1 and not chain.executor.limit.waits
    # it is at speed again after a ramp at 0.8 of the acceleration limit, which costs half the ramp's time
    put_off = chain.gateway.status()["playout"]["put_off_ms"] / 1e3
    assert 0.2 < put_off / (speed / (2 * 0.8 * chain.robot.acceleration[0])) < 1.5


@pytest.mark.parametrize("servos", [NOMINAL, None], ids=["servos known", "not known"])
@pytest.mark.parametrize("share", [0.01, 0.05])
def test_a_stall_is_found_while_datagrams_are_lost(share, servos):
    chain = lossy(share, servos)
    plan, fastest, _ = sweep(chain, 0)
    chain.play(plan)
    chain.run_for(0.5 * fastest)
    chain.faults.inject(Fault("stall", chain.robot.axes[0].name))
    assert chain.run_until(lambda: chain.gate.state is not SyncState.IN_SYNC, 2.0)
    assert chain.gate.reason.startswith("A1 ")


@pytest.mark.parametrize("servos", [NOMINAL, None], ids=["servos known", "not known"])
def test_an_arm_that_its_gateway_keeps_still_is_waited_for_longer_than_setpoints_are_remembered(monkeypatch, servos):
    monkeypatch.setattr(comparison, "MAX_SETPOINTS", 1024)
    chain = servo_chain(servos)
    plan, fastest, _ = sweep(chain, 0)
    chain.transitions.clear()
    chain.play(plan)
    chain.run_for(0.2 * fastest)
    assert chain.gateway.on_control(Control("1", chain.gateway.command_session, "speed_limit", 0.0), chain.now).ok
    assert chain.run_until(lambda: chain.executor.limit.standing, 5.0)
    chain.run_for(8.0)
    # nobody knows any more by how much it trails
    assert math.isnan(chain.gate.comparison.last.round_trip) and chain.executor.limit.waits
    assert chain.executor.limit.standing and left_in_sync(chain) == []
    assert chain.gateway.on_control(Control("2", chain.gateway.command_session, "speed_limit", 1.0), chain.now).ok
    assert chain.run_until(lambda: chain.executor.outcome != "", plan.trajectory.duration + 10.0)
    assert chain.executor.outcome == "finished" and left_in_sync(chain) == []


def test_a_link_that_falls_silent_while_the_arm_is_waited_for_closes_the_gate():
    chain = servo_chain(NOMINAL)
    plan, fastest, _ = sweep(chain, 0)
    chain.transitions.clear()
    chain.play(plan)
    chain.run_for(0.2 * fastest)
    assert chain.gateway.on_control(Control("1", chain.gateway.command_session, "speed_limit", 0.0), chain.now).ok
    assert chain.run_until(lambda: chain.executor.limit.standing, 5.0)
    chain.faults.inject(Fault("drop", values=(1.0,)))
    assert chain.run_until(lambda: chain.gate.state is not SyncState.IN_SYNC, 2.0), chain.gate.reason
    assert chain.run_until(lambda: chain.executor.state is not ExecutorState.PLAYING, 0.1)
