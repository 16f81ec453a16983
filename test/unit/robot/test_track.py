"""The arm on its track through the whole chain, on a simulated clock: order, units and signs of the seventh axis."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import plan_samples
import pytest
import yaml
from simulation import SimulatedChain

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import radians
from construction_twin.evaluation.report import write_report
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import TraceEntry
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.planning.timing import time_path
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.scenario.judge import trace_excesses

ROOT = Path(__file__).resolve().parents[3]
ROBOT = read_robot_files(ROOT / "urdf" / "kr120_track.urdf.xacro", ROOT / "config" / "kr120_track.yaml")
SETTINGS = yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text())
ETHERNET = (ROOT / "krl" / "ethernet" / "ctwin_e1_ethernet.xml").read_text()
#: Unequal values, so that no two can be taken for each other: the track, then A1 to A6.
GOAL = (0.6123, *radians((11.0, -62.0, 73.0, 24.0, 55.0, -36.0)))
#: A controller that counts backwards, from elsewhere, in mm * 180 / pi.
ODD_E1 = {
    "e1_sign": -1,
    "e1_offset": 0.15,
    "e1_feedback_scale": 57.29577951308232,
    "e1_correction_scale": 57.29577951308232,
}


def make_chain(e1: dict, decimals: int = 3) -> SimulatedChain:
    config = gateway_config(ROBOT, SETTINGS | {"decimals": decimals, "ethernet_xml": ETHERNET} | e1)
    mock = MockSettings(gateway_host="simulated", ethernet_xml=ETHERNET, **e1)
    chain = SimulatedChain(ROBOT, config, build_controller(mock, ROBOT))
    reasons = chain.supervisor, chain.executor, chain.gate
    assert chain.run_until(lambda: chain.ready, 5.0), [part.reason for part in reasons]
    return chain


def play(chain: SimulatedChain, goal) -> None:
    trajectory = time_path(np.array([chain.twin.pose, goal]), ROBOT)
    plan = plan_samples.make_plan(trajectory, f"plan-{chain.now}", asked_ns=chain.now)
    chain.play(plan)
    assert chain.run_until(lambda: chain.executor.outcome == "finished", trajectory.duration + 5.0), (
        chain.executor.reason
    )
    chain.run_for(1.0)


def block(packet: bytes, name: str) -> dict[str, float]:
    attributes = re.search(rb"<%s ([^>]*)/>" % name.encode(), packet)[1].decode()
    return {key: float(value) for key, value in re.findall(r'(\w+)="([^"]*)"', attributes)}


def test_the_joints_are_track_first_and_the_string_has_it_last():
    assert ROBOT.joint_names[0] == "track"
    assert [axis.name for axis in ROBOT.axes] == ["E1", "A1", "A2", "A3", "A4", "A5", "A6"]
    codec = JointStringCodec.of(ROBOT, 3)
    payload = b"+011.000,-062.000,+073.000,+024.000,+055.000,-036.000,+00612.300"
    assert codec.encode(GOAL) == payload and codec.length == len(payload) == 64
    assert codec.decode(payload) == pytest.approx(GOAL, abs=1e-12)


@pytest.mark.parametrize("decimals", [3, 6])
@pytest.mark.parametrize("e1", [{}, ODD_E1], ids=["plain", "odd"])
def test_a_motion_ends_at_the_goal_joint_by_joint_and_its_telegrams_carry_the_controllers_e1(decimals, e1):
    chain = make_chain(e1, decimals)
    assert len(chain.codec.encode(chain.twin.pose).split(b",")) == 7
    play(chain, GOAL)
    # the arm's own truth, behind both codecs; corrections have 6 decimals of mm and deg
    assert chain.controller.measured == pytest.approx(chain.codec.quantise(GOAL), abs=2e-8)
    assert chain.twin.pose == chain.codec.quantise(GOAL)
    packet = chain.controller.begin_cycle()
    axes = block(packet, "AIPos")
    assert [axes[f"A{number}"] for number in range(1, 7)] == pytest.approx((11, -62, 73, 24, 55, -36), abs=2e-6)
    # scale * (sign * x + offset) in mm
    wanted = 57.29577951308232 * (-612.3 + 150.0) if e1 else 612.3
    assert block(packet, "EIPos")["E1"] == pytest.approx(wanted, abs=1e-3)
    assert chain.gateway.counters["settling"] == 0
    assert not [name for name in chain.gateway.counters if name.startswith(("refused", "stops"))]


def test_a_wrong_sign_of_e1_mirrors_the_track_and_only_the_pendant_can_tell():
    config = gateway_config(ROBOT, SETTINGS | {"decimals": 3, "ethernet_xml": ETHERNET, "e1_sign": -1})
    mock = MockSettings(gateway_host="simulated", ethernet_xml=ETHERNET)
    chain = SimulatedChain(ROBOT, config, build_controller(mock, ROBOT))
    assert chain.run_until(lambda: chain.ready, 5.0)
    start = chain.controller.measured[0]
    trajectory = time_path(np.array([chain.twin.pose, GOAL]), ROBOT)
    chain.play(plan_samples.make_plan(trajectory, "plan-1", asked_ns=chain.now))
    chain.run_for(trajectory.duration + 1.0)
    # wrong in feedback and correction alike: twin and arm agree, and the arm itself goes to the mirrored place
    assert chain.executor.outcome == "finished"
    assert chain.controller.measured[0] - start == pytest.approx(-GOAL[0], abs=1e-6)


def test_corrections_are_inside_the_limits_with_the_allowance_of_each_joints_own_unit():
    chain = make_chain({})
    play(chain, GOAL)
    origin = chain.controller.start_pose
    entries = [
        TraceEntry(ipoc, 0, State.FOLLOWING, 1, tuple(o + c for o, c in zip(origin, correction)))
        for ipoc, correction in chain.corrections
    ]
    assert trace_excesses(entries, chain.gateway.config.limits, 3) == []
    track = np.array([entry.position[0] for entry in entries])
    acceleration = np.diff(track, 2) / 0.004**2
    assert np.abs(acceleration).max() <= ROBOT.acceleration[0] + 0.125 + 1e-6


def test_the_evaluation_keeps_metres_and_radians_apart(tmp_path):
    chain = make_chain({})
    play(chain, GOAL)
    report = write_report(chain.recording(), ROBOT, tmp_path)
    table = report.summary["tables"]["lag_removed"]
    assert set(table["track"]) == {"avg_m", "max_m"} and set(table["joint_a1"]) == {"avg_rad", "max_rad"}
    assert table["track"]["max_m"] < 2e-6 and table["joint_a1"]["max_rad"] < 2e-5
    assert set(report.summary["final_error_m"]) == {"track"} and "track" not in report.summary["final_error_rad"]
    header = (tmp_path / "table1.csv").read_text().splitlines()
    assert header[0].endswith(",avg_m,max_m")
    row = next(line for line in header if line.startswith("lag_removed,track"))
    assert row.split(",")[2:8] == [""] * 6 and float(row.split(",")[8]) == table["track"]["avg_m"]
    assert {path.name for path in report.files} >= {"figure8.png", "figure9.png"}


def test_limits_tell_m_from_rad():
    limits = MotionLimits.of(ROBOT)
    assert limits.linear == (True, *(False,) * 6)
    assert limits.last_digits(3)[:2] == pytest.approx((1e-6, math.radians(1e-3)))
    assert limits.allowances(3)[:2] == pytest.approx((0.125, math.radians(125.0)))
    assert (
        str(limits.refusal("velocity", 0, 3.0, 2.5, "/s"))
        == "track: velocity check failed: 3000 mm/s against 2500 mm/s"
    )
    assert "deg/s" in str(limits.refusal("velocity", 1, 3.0, 2.5, "/s"))
