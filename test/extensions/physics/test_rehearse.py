"""ros.commands.rehearse: a plan from a file, rehearsed without a ROS master."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import rosbag
import rospy
from physics_samples import between
from plan_samples import make_plan

from construction_twin.extensions.physics.commands.rehearse import BROKEN, FAILED, PASSED, main
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.scene.objects import Scene

NAMES = ",".join(["time_s", *(f"joint_a{number}_deg" for number in range(1, 7))])
WALL = """
padding: 0.0
objects:
  wall: {shape: box, size: [1.0, 0.05, 2.2], position: [1.6, 0.6, 1.1]}
"""


@pytest.fixture
def plan(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_text(f"{NAMES}\n0,0,-90,90,0,45,0\n2,-40,-90,90,0,45,10\n")
    return file


@pytest.fixture
def wall(tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text(WALL)
    return file


def test_a_plan_that_passes_ends_with_0_and_names_axes_load_and_estimates(plan, capsys):
    assert main([str(plan), "--payload", "40,0,0,0.2"]) == PASSED
    said = capsys.readouterr().out
    assert re.match(r"rehearsal of plan \w+: passed", said)
    for words in ("joint_a1", "joint_a6", "40.0 kg", "200 mm", "120.0 kg", "~ an estimate", "armature"):
        assert words in said


def test_a_wall_in_the_way_ends_with_1_and_is_named(plan, wall, capsys):
    assert main([str(plan), "--scene", str(wall)]) == FAILED
    said = capsys.readouterr().out
    assert re.match(r"rehearsal of plan \w+: failed", said)
    assert "touches wall after" in said


@pytest.mark.parametrize(
    "options",
    [
        ("--payload", "heavy"),
        ("--payload", "1,2"),
        ("--payload", "-1"),
        ("--payload", "inf"),
        ("--mass", "wall"),
        ("--mass", "wall=nothing"),
        ("--mass", "wall=0"),
        ("--scene", "/no/such/scene.yaml"),
        ("--drives", "/no/such/drives.yaml"),
    ],
)
def test_what_cannot_be_rehearsed_ends_with_2_and_one_sentence(plan, options, capsys):
    assert main([str(plan), *options]) == BROKEN
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("rehearse: ")
    assert said.err.count("\n") == 1


@pytest.mark.parametrize("text", ["", "1,2,3\n", f"{NAMES}\n0,0,0,0,0,0,9999\n1,0,0,0,0,0,0\n"])
def test_a_file_that_is_no_plan_ends_with_2(plan, text, capsys):
    plan.write_text(text)
    assert main([str(plan)]) == BROKEN
    assert capsys.readouterr().err.startswith("rehearse: ")


@pytest.mark.parametrize(
    "options, words",
    [
        (["--plan-id", "p7"], "--plan-id 'p7'"),
        (["--mass", "foo=5"], "--mass 'foo': expected bodies of the scene: wall"),
    ],
)
def test_what_means_nothing_here_is_refused_before_the_rehearsal(plan, wall, options, words, capsys):
    assert main([str(plan), "--scene", str(wall), *options]) == BROKEN
    said = capsys.readouterr()
    assert words in said.err and said.out == ""


# -- of a bag


def planned(plan_id: str, turn: float) -> Plan:
    """Return a plan as the planner makes it: the first axis turns so far within 2 s [rad]."""
    begin = np.array((0.0, -1.5, 1.6, 0.0, 0.8, 0.0))
    goal = begin + np.array((turn, 0.0, 0.0, 0.0, 0.0, 0.2))
    return make_plan(between(begin, goal, 2.0), plan_id, Scene().hash)


@pytest.fixture
def bag(tmp_path):
    """A bag of a robot kr120 with two plans, the first of them recorded twice, as latched topics are."""
    file = tmp_path / "run.bag"
    with rosbag.Bag(str(file), "w") as opened:
        for second, (plan_id, turn) in enumerate((("p1", -0.7), ("p2", 0.7), ("p1", -0.7)), 1):
            plan = planned(plan_id, turn)
            path = np.zeros((len(plan.trajectory.times), 3))
            opened.write("/kr120/plan", plan_to_msg(plan, "base_link", path), rospy.Time(second))
    return file


def report_of(arguments: list[str], capsys) -> dict:
    assert main([*arguments, "--json"]) in (PASSED, FAILED)
    return json.loads(capsys.readouterr().out)


def test_of_a_bag_the_newest_plan_is_rehearsed_or_the_one_that_is_named(bag, wall, capsys):
    # the wall stands on one side: which plan was taken shows in what it touches
    newest = report_of([str(bag), "--scene", str(wall)], capsys)
    named = report_of([str(bag), "--scene", str(wall), "--plan-id", "p1"], capsys)
    assert (newest["state"], newest["contacts"]) == ("passed", [])
    assert named["state"] == "failed" and named["contacts"][0]["second"] == "wall"
    assert newest["duration"] == named["duration"] == 2.0
    assert (newest["plan_id"], newest["plan_hash"]) == ("p2", planned("p2", 0.7).hash)


@pytest.mark.parametrize("arguments", [("--plan-id", "p9"), ("--robot", "/ur")])
def test_a_plan_or_robot_that_the_bag_does_not_have_ends_with_2(bag, arguments, capsys):
    assert main([str(bag), *arguments]) == BROKEN
    said = capsys.readouterr().err
    assert said.startswith("rehearse: ") and said.count("\n") == 1
