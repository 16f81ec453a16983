"""The command `currents`: from two bags to a table, a figure and files; or one sentence why there is nothing to compare."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
import rosbag
from chain_samples import make_plan, play_to_the_end
from construction_twin.msg import AxisCurrent, Execution, Feedback
from sensor_msgs.msg import JointState
from servo_chain import NAMES, servo_chain

from construction_twin.evaluation.bag import read_recording
from construction_twin.ros.commands.currents import main
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.ros.transport.joint_stream import to_time

GOAL = (0.4, -1.2, 1.2, 0.3, 0.8, -0.3)


def message(kind, stamp: int, **fields):
    made = kind(name=list(NAMES), **fields)
    made.header.stamp = to_time(stamp)
    return made


def write_bag(path, goal=GOAL, factors=(1.0,) * 6, currents=True):
    """Write what would be recorded of a chain that plays a plan; its axes take a current that grows with what they turn."""
    chain = servo_chain()
    plan = make_plan(chain, np.array(goal))
    play_to_the_end(chain, plan)
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic: str, stamp: int, made) -> None:
            bag.write(f"/kr120/{topic}", made, to_time(stamp))

        for topic, samples in (("twin", chain.twin_poses), ("next", chain.setpoints), ("command", chain.commands)):
            for stamp, q in samples:
                write(f"{topic}/joint_states", stamp, message(JointState, stamp, position=list(q)))
        for stamp, q, seq, command in chain.feedback:
            beside = {"seq": seq, "command_stamp": to_time(command)}
            write("physical/joint_states", stamp, message(JointState, stamp, position=list(q)))
            write("physical/feedback", stamp, message(Feedback, stamp, position=list(q), **beside))
            if currents:
                told = [10.0 * factor * angle for factor, angle in zip(factors, q)]
                write("physical/current", stamp, message(AxisCurrent, stamp, current=told, **beside))
        begin = chain.executor.plan_start
        write("plan", begin, plan_to_msg(plan, "base_link", np.zeros((len(plan.trajectory.times), 3))))
        played = Execution(plan_id=plan.id, plan_start=to_time(begin), duration=plan.trajectory.duration)
        played.outcome, played.state = "finished", Execution.IDLE
        write("execution", begin, played)
    return path


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("currents")
    return {
        "reference": write_bag(folder / "reference.bag"),
        "worn": write_bag(folder / "worn.bag", factors=(1.0, 1.0, 1.2, 1.0, 1.0, 1.0)),
        "other": write_bag(folder / "other.bag", goal=(0.3, *GOAL[1:])),
        "bare": write_bag(folder / "bare.bag", currents=False),
    }


def test_it_says_which_axis_takes_more_and_where_and_writes_it_down(bags, tmp_path, capsys):
    assert main([str(bags["worn"]), "--reference", str(bags["reference"]), "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    written = json.loads((tmp_path / "currents.json").read_text())
    rows = list(csv.DictReader((tmp_path / "currents.csv").read_text().splitlines()))
    axes = {axis["joint"]: axis for axis in written["axes"]}
    assert axes["joint_a3"]["rms"] == pytest.approx(0.2 * axes["joint_a3"]["reference_rms"])
    assert all(abs(axis["largest"]) < 1e-9 for name, axis in axes.items() if name != "joint_a3")
    assert f"largest difference: joint_a3, {axes['joint_a3']['largest']:+.3f}" in printed
    assert [row["joint"] for row in rows] == list(NAMES) and float(rows[2]["rms"]) == axes["joint_a3"]["rms"]
    for name in ("currents.json", "currents.csv", "currents.png"):
        assert str(tmp_path / name) in printed
    assert (tmp_path / "currents.png").read_bytes()[:4] == b"\x89PNG"
    # a table that a narrow terminal would cut is no table
    assert "…" not in printed


@pytest.mark.parametrize(
    ("bag", "reference", "said"),
    [
        ("other", "reference", "not of the same plan"),
        ("bare", "reference", "bare.bag holds no motor currents"),
        ("worn", "bare", "bare.bag holds no motor currents"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence_and_no_file(bags, tmp_path, capsys, bag, reference, said):
    assert main([str(bags[bag]), "--reference", str(bags[reference]), "--output", str(tmp_path)]) == 1
    refused = capsys.readouterr()
    assert said in refused.err and refused.err.count("\n") == 1 and not refused.out
    assert not list(tmp_path.iterdir())


def test_a_reference_that_is_not_there_is_named(bags, tmp_path, capsys):
    assert main([str(bags["worn"]), "--reference", str(tmp_path / "none.bag"), "--output", str(tmp_path)]) == 1
    assert "none.bag" in capsys.readouterr().err


def test_a_bag_without_currents_has_none(bags):
    assert len(read_recording(bags["worn"]).currents) > 500
    assert read_recording(bags["bare"]).currents is None
