"""Waypoint files: units by the header, any column order, and a sentence with line and column for everything else."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from construction_twin.extensions.planners.waypoint_file import format_waypoints, parse_waypoints
from construction_twin.planning.timing import time_path
from construction_twin.planning.waypoints import WaypointsError, from_points, plan_waypoints
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.trajectory import Trajectory

ROOT = Path(__file__).parents[3]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
TRACK = read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")
HOME = np.array(ROBOT.home)
HEADER = ",".join(f"joint_a{number}_deg" for number in range(1, 7))
NUMBERS = "0,-90,90,0,90,0\n10,-80,85,5,80,20\n"
GOOD = f"{HEADER}\n0,-90,90,0,90,0\n10,-80,85,5,80,20\n"


def test_degrees():
    waypoints = parse_waypoints(GOOD, ROBOT)
    assert waypoints.rows == (2, 3) and waypoints.times is None and waypoints.velocities is None
    assert np.allclose(np.degrees(waypoints.positions[1]), [10, -80, 85, 5, 80, 20], atol=1e-12)
    assert plan_waypoints(waypoints, HOME, ROBOT).positions[-1].tobytes() == waypoints.positions[-1].tobytes()


def test_radians_semicolons_comments_any_order_and_times():
    text = """\ufeff# from the slicer
    time_s ; joint_a6_rad; joint_a5_deg; joint_a4_deg; joint_a3_deg; joint_a2_deg; joint_a1_rad

    0.5; 0.0; 90; 0; 90; -90; 0.0   # home
    # half way
    3.5; 0.2; 91; 1; 91; -91; 0.1
    """
    waypoints = parse_waypoints(text, ROBOT)
    assert waypoints.rows == (4, 6) and waypoints.times.tolist() == [0.5, 3.5]
    expected = [0.1, *np.radians([-91, 91, 1, 91]), 0.2]
    assert np.allclose(waypoints.positions[1], expected, atol=1e-15)
    assert plan_waypoints(waypoints, HOME, ROBOT).duration == 3.0


@pytest.mark.parametrize(("unit", "value"), [("mm", 250.0), ("m", 0.25)])
def test_a_linear_joint_is_in_mm_or_m(unit, value):
    text = f"{HEADER},track_{unit}\n0,-90,90,0,90,0,{value}\n1,-90,90,0,90,0,{value}\n"
    assert parse_waypoints(text, TRACK).positions[0, 0] == pytest.approx(0.25)


def test_velocities():
    header = "time_s," + HEADER + "," + ",".join(f"joint_a{number}_deg_s" for number in range(1, 7))
    rows = ["0,0,-90,90,0,90,0,0,0,0,0,0,0", "2,5,-90,90,0,90,0,1,0,0,0,0,0", "4,10,-90,90,0,90,0,0,0,0,0,0,0"]
    waypoints = parse_waypoints("\n".join([header, *rows]), ROBOT)
    assert waypoints.velocities[1, 0] == pytest.approx(math.radians(1.0))
    assert plan_waypoints(waypoints, HOME, ROBOT).velocities[1, 0] == pytest.approx(math.radians(1.0))


@pytest.mark.parametrize(
    ("text", "row", "message"),
    [
        ("", None, "the file is empty"),
        ("# nothing\n\n", None, "the file is empty"),
        (HEADER, None, "0 waypoints"),
        (GOOD.replace("joint_a3_deg", "joint_b3_deg"), 1, "unknown column 'joint_b3_deg'"),
        (GOOD.replace("joint_a3_deg", "joint_a2_rad"), 1, "columns 'joint_a2_deg' and 'joint_a2_rad' are the same"),
        (GOOD.replace("joint_a3_deg", "joint_a3_mm"), 1, "of a revolute joint; expected its unit to be deg or rad"),
        (GOOD.replace(",joint_a6_deg", ""), 1, "no column for joint_a6"),
        (GOOD.replace("\n", ",x\n", 1), 1, "unknown column 'x'"),
        (NUMBERS, 1, "line 1: unknown column '0'; expected joint_a1_deg"),
        (GOOD.replace("\n", ",joint_a1_deg_s\n", 1), 1, "velocities need a column for every joint"),
        (GOOD.replace(",80,20", ",80"), 3, "line 3: 5 values between ','; expected 6"),
        (GOOD.replace(",80,20", ",80,20,"), 3, "line 3: 7 values between ','; expected 6"),
        (GOOD.replace(",80,20", ",80,"), 3, "joint_a6_deg is ''; expected a number"),
        (GOOD.replace("10,-80,85,5,80,20", "10,5,-80,0,85,0,5,0,80,0,20,0"), 3, "12 values .* with decimal points"),
        (GOOD.replace("10,-80,85,5,80,20", "10\t-80\t85\t5\t80\t20"), 3, "1 values between ','; expected 6"),
        (GOOD.replace("-80", "1_0"), 3, "joint_a2_deg is '1_0'"),
        (GOOD.replace("-80", "٣"), 3, "joint_a2_deg is '٣'"),
        (GOOD.replace(",80,20", ",abc,20"), 3, "joint_a5_deg is 'abc'"),
        (
            GOOD.replace(",", ";").replace("10;", "10,5;"),
            3,
            "joint_a1_deg is '10,5'; expected a number with a decimal point",
        ),
        (GOOD.replace("-80", "nan"), 3, "line 3: joint_a2 has nan"),
        (GOOD.replace("-80", "inf"), 3, "line 3: joint_a2 has inf"),
    ],
)
def test_what_is_not_understood_is_refused(text, row, message):
    with pytest.raises(WaypointsError, match=message) as caught:
        parse_waypoints(text, ROBOT)
    assert caught.value.row == row


def test_messages_about_limits_are_in_the_file_s_units():
    with pytest.raises(WaypointsError) as caught:
        plan_waypoints(parse_waypoints(GOOD.replace("-80", "12"), ROBOT), HOME, ROBOT)
    assert "line 3: joint_a2 is 12 deg; its range is -140 deg to -5 deg" in str(caught.value)
    assert (caught.value.row, caught.value.joint) == (3, "joint_a2")
    timed = f"time_s,{HEADER}\n0,0,-90,90,0,90,0\n0.2,90,-90,90,0,90,0\n"
    with pytest.raises(WaypointsError, match="^line 3 .*: joint_a1 has a velocity of .* deg/s; its limit is 123 deg/s"):
        plan_waypoints(parse_waypoints(timed, ROBOT), HOME, ROBOT)


# -- both ways


OTHERS = [
    read_robot_files(ROOT / f"test/data/{name}.urdf", ROOT / f"test/data/{name}.yaml")
    for name in ("ur_like", "panda_like")
]


@pytest.mark.parametrize("robot", [ROBOT, TRACK, *OTHERS], ids=["kr120", "track", "ur_like", "panda_like"])
def test_an_exported_plan_comes_back_with_its_hash(robot):
    home = np.array(robot.home)
    # within the ranges, whatever arm it is
    nearby = np.clip([home, home + 0.25, home - 0.1, home + 0.05], robot.lower, robot.upper)
    own = time_path(nearby, robot)
    text = format_waypoints(own, robot.linear, ["plan p", "by\nsomebody"])
    assert text.startswith("# plan p\n# by somebody\ntime_s,")
    assert plan_waypoints(parse_waypoints(text, robot), home, robot).content_hash() == own.content_hash()


def test_a_plan_in_degrees_comes_back_to_the_last_digits():
    home = np.array(TRACK.home)
    own = time_path(np.array([home, home + 0.25]), TRACK)
    text = format_waypoints(own, TRACK.linear, degrees=True)
    assert "track_mm,joint_a1_deg," in text and "joint_a6_deg_s2" in text
    assert np.max(np.abs(parse_waypoints(text, TRACK).positions - own.positions)) < 1e-14


FINITE = st.floats(-1e6, 1e6, allow_subnormal=True)


@settings(deadline=None)
@given(
    positions=arrays(float, (4, 6), elements=FINITE),
    velocities=arrays(float, (4, 6), elements=FINITE),
    accelerations=arrays(float, (4, 6), elements=FINITE),
    spans=st.lists(st.integers(1, 10**11), min_size=3, max_size=3),
)
def test_every_number_of_a_trajectory_survives_a_file_to_the_last_bit(positions, velocities, accelerations, spans):
    times = np.cumsum([0, *spans]) / 1e9
    own = Trajectory(ROBOT.joint_names, times, positions, velocities, accelerations)
    read = parse_waypoints(format_waypoints(own, ROBOT.linear), ROBOT)
    back = Trajectory(ROBOT.joint_names, read.times, read.positions, read.velocities, read.accelerations)
    assert back.content_hash() == own.content_hash()


@pytest.mark.parametrize("time", [None, 0.0, 4.0])
def test_a_single_line_is_the_goal_of_a_motion_from_the_present_pose(time):
    """As a single point of the action is: its time is how long the motion takes, 0 as short as the speed allows."""
    names, values = (HEADER, "10,-80,85,5,80,20") if time is None else (f"time_s,{HEADER}", f"{time},10,-80,85,5,80,20")
    motion = plan_waypoints(parse_waypoints(f"{names}\n{values}\n", ROBOT), HOME, ROBOT)
    point = from_points(ROBOT, ROBOT.joint_names, [np.radians([10, -80, 85, 5, 80, 20])], times=[time or 0.0])
    assert motion.content_hash() == plan_waypoints(point, HOME, ROBOT).content_hash()
    assert motion.positions[0].tolist() == list(HOME) and (not time or motion.duration == time)


def test_a_single_line_at_0_s_needs_no_velocities():
    rates = ",".join(f"joint_a{number}_deg_s" for number in range(1, 7))
    read = parse_waypoints(f"time_s,{HEADER},{rates}\n0,10,-80,85,5,80,20,0,0,0,0,0,0\n", ROBOT)
    assert read.times is None and read.velocities is None
