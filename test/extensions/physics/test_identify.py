"""The command `identify`: from a bag to the file that the monitor reads."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import rosbag
from chain_samples import make_plan, play_to_the_end
from construction_twin.msg import Feedback
from sensor_msgs.msg import JointState
from servo_chain import NAMES, poses, servo_chain

from construction_twin.core.units import CYCLE
from construction_twin.evaluation.alignment import evaluate
from construction_twin.evaluation.bag import read_recording
from construction_twin.extensions.physics.commands.identify import main
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.servo.model import read_servos


def pose(stamp: int, q, kind: type = JointState, **fields):
    message = kind(name=list(NAMES), position=list(q), **fields)
    message.header.stamp = to_time(stamp)
    return message


def write_bag(path, still: int | None = None):
    """Write what would be recorded of a chain with the realistic servo; one joint may never move."""
    chain = servo_chain()
    for goal in itertools.islice(poses(1), 6):
        goal = np.array(goal)
        if still is not None:
            goal[still] = chain.twin.pose[still]
        play_to_the_end(chain, make_plan(chain, goal))
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic: str, stamp: int, message) -> None:
            bag.write(f"/kr120/{topic}", message, to_time(stamp))

        for stamp, q in chain.twin_poses:
            write("twin/joint_states", stamp, pose(stamp, q))
            write("command/joint_states", stamp, pose(stamp, q))
        for stamp, q, seq, command in chain.feedback:
            write("physical/joint_states", stamp, pose(stamp, q))
            write("physical/feedback", stamp, pose(stamp, q, Feedback, seq=seq, command_stamp=to_time(command)))
        for stamp, q in chain.expected:
            write("expected/joint_states", stamp, pose(stamp, q))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("identify") / "run.bag")


def test_it_writes_what_the_monitor_reads(bag, tmp_path, capsys):
    assert main([str(bag), "--output", str(tmp_path)]) == 0
    model = read_servos(tmp_path / "servos.yaml", NAMES)
    for servo in model.servos:
        assert servo.lag(CYCLE) == pytest.approx(2 * 0.8 / 60.0 - CYCLE / 2, abs=1e-4)
    assert [path.name for path in tmp_path.iterdir()] == ["servos.yaml"]
    printed = capsys.readouterr().out
    assert all(name in printed for name in NAMES) and str(tmp_path / "servos.yaml") in printed.replace("\n", "")


def test_what_the_gate_expected_is_evaluated_from_the_bag(bag):
    expected = evaluate(read_recording(bag)).alignments["expected"]
    assert (expected.maximum < 2e-5).all() and expected.skipped < 100


def test_a_joint_that_did_not_move_is_refused_by_name_and_nothing_is_written(tmp_path, capsys):
    path = write_bag(tmp_path / "run.bag", still=2)
    assert main([str(path), "--output", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert "joint_a3" in told and "joint_a2" not in told
    assert not (tmp_path / "out" / "servos.yaml").exists()
