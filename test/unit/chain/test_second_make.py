"""A second make of controller runs the whole chain: absolute targets in binary frames, 8 ms, and its own faults."""

from __future__ import annotations

import dataclasses
from contextlib import contextmanager

import frames_make
import numpy as np
import pytest
from chain_samples import REACH, ROBOT, SETTINGS, make_plan, play_to_the_end
from frames_make import CYCLE_MS, SESSION, Frames, stamp_of
from simulation import SimulatedChain

from construction_twin.controller import port
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.executor import ExecutorState
from construction_twin.gateway.config import parse_config
from construction_twin.gateway.gateway import Gateway
from construction_twin.gateway.states import State
from construction_twin.link.observations import LinkState
from construction_twin.mock.controller import MockController
from construction_twin.mock.faults import Fault
from construction_twin.mock.program import MockSettings, build_controller, build_forward_kinematics, gateway_address
from construction_twin.mock.servo import IdealServo
from construction_twin.ros.nodes.rsi_gateway import gateway_config


@contextmanager
def known():
    """The second make is known in this module only: other tests compare what is known with the documents."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(port.MODULES, frames_make.MAKE.name, "frames_make")
        yield


@pytest.fixture(scope="module", autouse=True)
def known_make():
    with known():
        yield


with known():
    CONFIG = dataclasses.replace(gateway_config(ROBOT, SETTINGS | {"decimals": 6}), layout=Frames(), cycle=CYCLE_MS)
PEER = ("192.168.1.30", 50_000)
#: Where the arm of a frame stands [rad].
ARM = np.array(ROBOT.home)


#: What launch/bringup.launch loads of it.
LAUNCHED = {"make": "frames", "cycle": CYCLE_MS}


def made(**options) -> SimulatedChain:
    """Return a chain that is ready for a plan."""
    plain = build_controller(MockSettings(gateway_host="simulated", gateway_port=1), ROBOT).config
    config = dataclasses.replace(
        plain, layout=Frames(), cycle=CYCLE_MS, units=(), first_stamp=stamp_of(1, 0), restart_gap=SESSION
    )
    controller = MockController(config, IdealServo(3, config.period), build_forward_kinematics(ROBOT))
    chain = SimulatedChain(ROBOT, CONFIG, controller, **options)
    assert chain.run_until(lambda: chain.ready, 5.0), (chain.supervisor.reason, chain.gateway.reason)
    return chain


def moving(**options) -> SimulatedChain:
    """Return a chain in the middle of a plan."""
    chain = made(**options)
    chain.play(make_plan(chain, REACH, duration=6.0))
    chain.run_for(3.0)
    assert chain.gateway.state is State.FOLLOWING
    return chain


def frame(cycle, measured=ARM, followed=None, session=1, missed=0) -> bytes:
    encode = frames_make.controller_side(CONFIG.layout, CONFIG.axes, (), 6).encode
    return encode(stamp_of(session, cycle), measured, measured if followed is None else followed, (), (), missed)


def test_a_plan_is_played_to_its_end_in_agreement_and_the_arm_stands_at_the_goal():
    chain = made()
    play_to_the_end(chain, make_plan(chain, REACH, duration=6.0, waypoints=100))
    assert np.abs(np.array(chain.controller.measured) - REACH).max() <= 1e-8
    assert not [change for change in chain.transitions if change.source.name == "IN_SYNC"]
    counters = chain.gateway.counters
    assert (counters["late_replies"], counters["settling"], counters["rsi_sessions"]) == (0, 0, 1)
    poses = dict(chain.twin_poses)
    pairs = [(q, poses[stamp]) for _, q, _, stamp in chain.feedback if stamp in poses]
    assert len(pairs) > 500
    # the servo lags by two of its cycles
    assert max(np.abs(np.array(q) - twin).max() for q, twin in pairs) < 0.05


def test_its_replies_are_positions_within_the_limits_and_no_increments():
    chain = made()
    chain.play(make_plan(chain, REACH))
    assert chain.run_until(lambda: chain.executor.outcome == "finished", 20.0)
    targets = np.array([target for _, target in chain.corrections])
    assert np.abs(targets[0] - ROBOT.home).max() < 1e-12
    velocity = np.diff(targets, axis=0) / CONFIG.period
    assert (np.abs(velocity) <= np.array(ROBOT.velocity) + 1e-5).all()
    assert (targets >= np.array(ROBOT.lower)).all() and (targets <= np.array(ROBOT.upper)).all()


def test_a_session_that_is_started_anew_is_another_one_and_the_arm_stays_until_a_person_resets():
    chain = moving()
    chain.requests.append(chain.controller.restart)
    chain.run_for(0.1)
    assert chain.gateway.counters["rsi_sessions"] == 2
    assert chain.executor.state is not ExecutorState.PLAYING
    where = chain.controller.measured
    chain.run_for(1.0)
    assert np.abs(np.array(chain.controller.measured) - where).max() < 1e-6
    # it was in the middle of a plan: nothing arms until a person says so
    assert (chain.gateway.state, chain.supervisor.state) == (State.READY, LinkState.NEEDS_RESET)


@pytest.mark.parametrize("direction", ["to_pc", "to_controller"])
def test_frames_that_are_lost_both_ways_cost_no_step(direction):
    chain = moving()
    chain.faults.inject(Fault("drop", values=(0.2,), direction=direction))
    before = len(chain.measured)
    chain.run_for(1.0)
    poses = np.array([q for _, q in chain.measured[before - 1 :]])
    assert (np.abs(np.diff(poses, axis=0)) / CONFIG.period <= np.array(ROBOT.velocity) * 1.001).all()
    assert chain.controller.counters["missed"] > 10 and chain.controller.running
    assert chain.gateway.counters["standstills"] > 0


def test_the_last_resort_brakes_from_the_last_target_and_answers_on():
    resort = CONFIG.make.last_resort(CONFIG)
    step = 0.002
    for cycle in range(1, 20):
        targets = [tuple(ARM + step * n) for n in (cycle, cycle - 1)]
        resort.on_reply_sent(stamp_of(1, cycle), PEER, *targets, 0)
    resort.begin()
    decode, before = frames_make.controller_side(CONFIG.layout, CONFIG.axes, (), 6).decode, np.array(targets[0])
    for cycle in range(20, 200):
        stamp = resort.stamp_of(frame(cycle), PEER)
        assert not resort.rewind_if_lost(stamp, frame(cycle))
        reply = decode(resort.answer(stamp))
        assert reply.controller_ms == stamp_of(1, cycle)
        assert (np.array(reply.target) - before <= step).all()
        before = np.array(reply.target)
    assert resort.at_rest and resort.stamp_of(b"garbage", PEER) is None


def test_commissioning_holds_the_arm_where_it_began():
    gateway = Gateway(CONFIG, "run1", commissioning=True)
    telegram = CONFIG.make.reader(CONFIG).parse(frame(1))
    assert gateway.on_telegram(telegram, PEER, NANOSECONDS) == tuple(ARM)


def test_without_a_pose_nothing_is_answered(monkeypatch):
    """Where no origin is known there is no target to send."""
    monkeypatch.setattr(frames_make.Rules, "origin", lambda self, telegram: ((), ""))
    gateway = Gateway(CONFIG, "run1")
    assert gateway.on_telegram(CONFIG.make.reader(CONFIG).parse(frame(1)), PEER, NANOSECONDS) is None


def test_what_a_launch_file_loads_is_the_make_s_own_for_gateway_and_mock():
    config = gateway_config(ROBOT, SETTINGS | LAUNCHED)
    assert (config.layout, config.make) == (Frames(), frames_make.MAKE)
    settings = MockSettings(gateway_host="simulated", **LAUNCHED)
    assert build_controller(settings, ROBOT).config.layout == Frames()
    # it has no file that could name another port
    assert gateway_address(settings) == ("simulated", 50_000)


def test_a_file_a_cycle_and_a_make_that_are_not_there_are_refused():
    with pytest.raises(ConfigurationError, match="none: frames has no file for its telegrams"):
        gateway_config(ROBOT, SETTINGS | LAUNCHED | {"ethernet_xml": "<ROOT/>"})
    with pytest.raises(ConfigurationError, match="cycle: found 4, expected 8 ms"):
        gateway_config(ROBOT, SETTINGS | LAUNCHED | {"cycle": 4})
    with pytest.raises(ConfigurationError, match="make: found 'fanuc', expected one of rsi, frames"):
        gateway_config(ROBOT, SETTINGS | {"make": "fanuc"})
    for given, words in (
        ({"make": "fanuc"}, "make: found 'fanuc', expected one of rsi, frames"),
        ({"cycle": 4}, "cycle: found 4, expected 8 ms"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            build_controller(MockSettings(gateway_host="simulated", gateway_port=1, **LAUNCHED | given), ROBOT)


def test_its_configuration_names_the_make_and_is_read_again():
    assert parse_config(CONFIG.to_json(), "file") == CONFIG
    assert '"make": "frames"' in CONFIG.to_json()
