"""matlab/: every file parses, and what needs no toolbox is run, by GNU Octave; the rest is run against stubs of the toolboxes.

MATLAB itself is not here. The stubs know the calls as the toolboxes' documentation has them, and refuse others.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scene_samples import kr120, track7

from construction_twin.extensions.planners.waypoint_file import format_waypoints, parse_waypoints
from construction_twin.planning.timing import time_path
from construction_twin.planning.waypoints import plan_waypoints

ROOT = Path(__file__).resolve().parents[3]
MATLAB = ROOT / "matlab"
#: Functions of the toolboxes, so far as matlab/ calls them.
STUBS = Path(__file__).resolve().parent / "matlab_stubs"
#: A marker of our own, because Octave 7 may end with 0 after an error and print an error after its end.
_DONE = "the end was reached"


def octave(code: str, folder: Path) -> str:
    """Run code in a folder and return what it prints; AssertionError with Octave's words when it stops at an error."""
    script = folder / "run.m"
    paths = "".join(f"addpath('{path}');\n" for path in (STUBS, MATLAB))
    script.write_text(f"1;\n{paths}{code}\ndisp('{_DONE}');\n")
    assert shutil.which("octave-cli"), "GNU Octave is not installed; `setup/setup.sh tests` installs it"
    command = ["octave-cli", "--norc", "--no-history", str(script)]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120.0)
    assert _DONE in run.stdout, f"octave: {run.stderr}\n{run.stdout}"
    return run.stdout.replace(_DONE, "").strip()


def parse_errors(files: list[Path], folder: Path) -> dict[str, str]:
    """Return what Octave's parser says of each file that it cannot parse."""
    names = ", ".join(f"'{file}'" for file in files)
    loop = f"""files = {{{names}}};
for k = 1:numel(files)
  try
    __parse_file__(files{{k}});
    printf('parsed %s\\n', files{{k}});
  catch problem
    printf('wrong %s: %s\\n', files{{k}}, strrep(problem.message, sprintf('\\n'), ' '));
  end
end"""
    said = octave(loop, folder)
    assert said.count("parsed ") + said.count("wrong ") == len(files), said
    return dict(re.findall(r"^wrong (\S+): (.*)$", said, re.MULTILINE))


ROBOT = kr120()
HOME = np.array(ROBOT.home)
CORNERS = np.array([HOME, HOME + [0.3, 0.2, -0.1, 0.4, 0.1, -0.3], HOME + [0.1, 0.2, -0.3, 0.0, 0.2, 0.2]])


@pytest.fixture(scope="module")
def twin_script():
    """matlab/reaching_task.py as a module."""
    spec = importlib.util.spec_from_file_location("reaching_task", MATLAB / "reaching_task.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def matrix(values) -> str:
    rows = (" ".join(map(repr, row)) for row in np.atleast_2d(values).tolist())
    return f"[{'; '.join(rows)}]"


def written(code: str, folder, name: str) -> np.ndarray:
    octave(f"{code}\ndlmwrite('{name}', {name}, 'precision', '%.17g');", folder)
    return np.loadtxt(folder / name, delimiter=",")


def test_every_file_parses_and_a_wrong_one_would_be_found(tmp_path):
    files = sorted(MATLAB.rglob("*.m"))
    assert len(files) > 10
    wrong = tmp_path / "wrong.m"
    wrong.write_text("function x = wrong(y)\n  x = [1 2;\nend\n")
    assert list(parse_errors([*files, wrong], tmp_path)) == [str(wrong)]


def test_every_call_into_the_package_names_a_file_of_it():
    called = {name for file in MATLAB.rglob("*.m") for name in re.findall(r"\btwin\.(\w+)\(", file.read_text())}
    assert called <= {file.stem for file in (MATLAB / "+twin").glob("*.m")} and "rest_to_rest" in called


def test_a_motion_is_the_same_in_matlab_and_in_the_script_that_stands_in(tmp_path, twin_script):
    code = f"[t, q, qd, qdd] = twin.rest_to_rest({matrix(CORNERS)}, 9.5, 120);\nmotion = [t q qd qdd];"
    motion = written(code, tmp_path, "motion")
    assert np.allclose(motion, np.column_stack(twin_script.rest_to_rest(CORNERS, 9.5, 120)), atol=1e-12, rtol=0.0)
    # and the planner takes it as it is: at rest at both ends, within every limit
    names = [f"{name}_rad{rate}" for rate in ("", "_s", "_s2") for name in ROBOT.joint_names]
    lines = [",".join(f"{value:.15g}" for value in row) for row in motion]
    planned = plan_waypoints(parse_waypoints("\n".join([",".join(["time_s", *names]), *lines]), ROBOT), HOME, ROBOT)
    assert planned.duration == 9.5 and np.abs(planned.positions - motion[:, 1:7]).max() < 1e-12


def test_a_motion_to_where_the_arm_is_is_refused(tmp_path):
    code = f"try; twin.rest_to_rest({matrix([HOME, HOME])}, 1, 9); catch e; disp(e.message); end"
    assert "all corners are the same pose" in octave(code, tmp_path)


def test_what_matlab_writes_is_read_here_to_the_last_bit(tmp_path):
    robot = track7()
    own = time_path(np.array([robot.home, np.add(robot.home, 0.2)]), robot)
    joints = ", ".join(f"'{name}'" for name in robot.joint_names)
    linear = " ".join(str(int(value)) for value in robot.linear)
    tables = ", ".join(matrix(table) for table in (own.positions, own.velocities, own.accelerations))
    octave(f"twin.write_csv('m.csv', {{{joints}}}, [{linear}], {matrix(own.times[:, None])}, {tables});", tmp_path)
    text = (tmp_path / "m.csv").read_text()
    assert plan_waypoints(parse_waypoints(text, robot), robot.home, robot).content_hash() == own.content_hash()


def test_what_is_exported_here_is_read_by_matlab_to_the_last_bit(tmp_path):
    own = time_path(CORNERS, ROBOT)
    (tmp_path / "plan.csv").write_text(format_waypoints(own, ROBOT.linear, ["plan p"]))
    table = written("[names, table] = twin.read_csv('plan.csv');\nassert(names{2}, 'joint_a1_rad');", tmp_path, "table")
    expected = np.column_stack((own.times, own.positions, own.velocities, own.accelerations))
    assert table.tobytes() == expected.tobytes()


def test_the_arm_s_lag_and_errors_are_found(tmp_path):
    t = np.arange(0.0, 6.0, 0.004)
    q = np.column_stack([np.sin(t), 0.5 * np.cos(2.0 * t)])
    late = np.column_stack([np.sin(t - 0.036) + 1e-5, 0.5 * np.cos(2.0 * (t - 0.036))])
    code = f"""r = twin.compare_arms({matrix(t[:, None])}, {matrix(q)}, {matrix(t[:, None])}, {matrix(late)});
found = [r.lag r.average r.maximum r.average_instant];"""
    lag, *errors = written(code, tmp_path, "found")
    assert lag == pytest.approx(0.036, abs=1e-9)
    assert errors[:4] == pytest.approx([1e-5, 0.0, 1e-5, 0.0], abs=5e-6) and min(errors[4:]) > 0.015


def test_a_goal_is_filled_sent_and_its_result_told(tmp_path):
    code = f"""global GOAL ANSWER
ANSWER = struct('ErrorCode', int32(0), 'ErrorString', 'goal reached');
[t, q, qd, qdd] = twin.rest_to_rest({matrix(CORNERS)}, 9.5, 20);
joints = {{'a', 'b', 'c', 'd', 'e', 'f'}};
[succeeded, sentence] = twin.send_by_action('/kr120', joints, t, q, qd, qdd, 60);
assert(succeeded && strcmp(sentence, 'goal reached'));
assert(isequal(GOAL.Trajectory.JointNames, joints') && numel(GOAL.Trajectory.Points) == 20);
point = GOAL.Trajectory.Points(7);
assert(isequal(point.Positions, q(7, :)') && isequal(point.Velocities, qd(7, :)') && isequal(point.Accelerations, qdd(7, :)'));
assert(isa(point.TimeFromStart.Sec, 'int32') && isa(point.TimeFromStart.Nsec, 'int32'));
assert(abs(double(point.TimeFromStart.Sec) + 1e-9 * double(point.TimeFromStart.Nsec) - t(7)) < 1e-12);
assert(GOAL.Trajectory.Header.Stamp.Sec == 0);
ANSWER = struct('ErrorCode', int32(-1), 'ErrorString', 'joint_a1 is out of range');
[succeeded, sentence] = twin.send_by_action('/kr120', joints, t, q, qd, qdd, 60);
assert(~succeeded && strcmp(sentence, 'joint_a1 is out of range'));
ANSWER = [];
[succeeded, sentence] = twin.send_by_action('/kr120', joints, t, q, qd, qdd, 60);
assert(~succeeded); disp(sentence);"""
    said = octave(code, tmp_path)
    assert "waits for /kr120/follow_joint_trajectory" in said
    assert "cancels /kr120/follow_joint_trajectory" in said and "no result within 60 s" in said


def test_the_robot_is_imported_planned_for_and_solved(tmp_path):
    code = """[robot, joints, linear] = twin.connect('http://pc:11311', '/kr120', '10.0.0.2');
assert(isequal(joints, {'joint_2', 'joint_3'}) && isequal(linear, [true false]));
[t, q, qd, qdd] = twin.plan_reach(robot, [0 0], [1 1], {}, 8, 50);
assert(isequal(q(1, :), [0 0]) && max(abs(q(end, :) - 1)) < 1e-12 && max(abs(qd(:))) > 0);
robot.Closed = true;
try; twin.plan_reach(robot, [0 0], [1 1], {}, 8, 50); catch e; disp(e.message); end
robot.Status = 'success';
assert(isequal(twin.solve_pose(robot, [1 0 0 2; 0 1 0 0; 0 0 1 0; 0 0 0 1], [0 1]), [2 3]));
robot.Status = 'best available';
try; twin.solve_pose(robot, eye(4), [0 1]); catch e; disp(e.message); end"""
    said = octave(code, tmp_path)
    assert "rosinit http://pc:11311 NodeHost 10.0.0.2 NodeName /matlab" in said
    assert "importrobot get /kr120/robot_description DataFormat row" in said
    assert "no path was found" in said and "the pose was not reached (best available" in said
