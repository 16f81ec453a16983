"""examples/grasshopper with compas_eve and compas_fab from PyPI, against the real mosquitto, our node, and the planner's checks.

The packages are in a venv of their own, .ws/grasshopper, which is made once: by the first run of this file.
"""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rospy
import schemas
from bridge_bench import Refusals
from construction_twin.msg import Execution, Link, Sync
from construction_twin.srv import PlanTrajectoryRequest, PlanTrajectoryResponse
from processes import ROOT, wait_until
from site_broker import SiteBroker

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.feed import ARM, TWIN, ConsoleFeed
from construction_twin.extensions.console.nodes.requests import ConsoleRequests
from construction_twin.extensions.console.remote_view import ViewWriter
from construction_twin.kinematics.chain import Chain
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import make_client, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.planning.waypoints import plan_waypoints
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.nodes.planner import trajectory_waypoints
from construction_twin.ros.transport.latest_pose import StampedPose

XACRO = ROOT / "urdf/kr120r2500.urdf.xacro"
ROBOT = read_robot_files(XACRO, ROOT / "config/kr120.yaml")
REQUIREMENTS = ROOT / "setup/requirements-grasshopper.txt"
VENV = ROOT / ".ws/grasshopper"
COMPONENTS = sorted((ROOT / "examples/grasshopper").glob("*.py"))
SESSION = ROOT / "test/unit/repository/grasshopper_session.py"


@pytest.fixture(scope="module")
def python():
    """The Python of a designer's Grasshopper; made here once, 20 s."""
    stamp, wanted = VENV / ".requirements", REQUIREMENTS.read_text()
    if not stamp.exists() or stamp.read_text() != wanted:
        shutil.rmtree(VENV, ignore_errors=True)
        subprocess.run(["/usr/bin/python3", "-m", "venv", "--without-pip", VENV], check=True)
        pip = [sys.executable, "-m", "pip", "--python", VENV / "bin/python", "--quiet", "--disable-pip-version-check"]
        # of all that comes with it two short programs import a little
        done = subprocess.run([*pip, "install", "--no-compile", "-r", REQUIREMENTS], capture_output=True, text=True)
        assert done.returncode == 0, f"pip could not install {REQUIREMENTS.name}: {done.stderr[-1000:]}"
        stamp.write_text(wanted)
    return VENV / "bin/python"


class Planner:
    """In place of the service: checks and times motions as the planner does, without scene and review."""

    resolved_name = "/kr120/plan_trajectory"

    def __init__(self):
        self.made, self.sources = [], []

    def __call__(self, **fields):
        asked = PlanTrajectoryRequest(**fields)
        self.sources.append(asked.source)
        try:
            waypoints = trajectory_waypoints(asked.trajectory, ROBOT)
            trajectory = plan_waypoints(
                waypoints, ROBOT.home, ROBOT, asked.speed_scale or 0.3, asked.acceleration_scale or None
            )
        except ConstructionTwinError as error:
            return PlanTrajectoryResponse(success=False, message=str(error))
        self.made.append(trajectory)
        name = f"plan {len(self.made)}"
        return PlanTrajectoryResponse(True, "waiting for review", name, "cafe", trajectory.duration, "")


class Stream:
    """In place of a LatestPose: the arm at home."""

    def newest(self, oldest: float) -> StampedPose:
        return StampedPose(tuple(ROBOT.home), time.time_ns(), time.monotonic())


class Cell:
    """A site's broker, our node with its real client, and what it hears from ROS."""

    def __init__(self, folder):
        self.site = SiteBroker(folder, robots=("kr120",), persons=("ada:operate",))
        self.site.start()
        self.planner = Planner()
        self.refusals = Refusals(None)
        joints = Joints(tuple(ROBOT.joint_names), tuple(ROBOT.linear))
        broker = self.site.broker(self.site.account("kr120-bridge"))
        writer = ViewWriter("kr120", "cafe", joints)
        self._client = make_client(
            broker, unique_id("kr120", "planner"), "twin/kr120/view", writer.offline().decode(), will_retained=False
        )
        connection = Connection(broker, self._client, Topics("twin", "kr120"), self.refusals.refuse)
        self.feed = ConsoleFeed("base_link", connection, writer, {TWIN: Stream(), ARM: Stream()})
        self.requests = ConsoleRequests(joints, {}, self.planner, connection, 2_000_000, lambda: False, lambda: False)
        self.feed.on_execution(Execution(text="IDLE", reason="at rest"))
        connection.connect(self.feed.first, self.feed.republish_retained)
        wait_until(self._client.is_connected, what="the node's connection")
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=run) for run in (self._show, self._check)]
        for thread in self._threads:
            thread.start()

    def _show(self) -> None:
        while not self._ended.wait(0.04):
            self.feed.on_sync(Sync(text="IN_SYNC", reason="agree", agreed=True, error=[0.0] * 6, threshold=[0.01] * 6))
            self.feed.on_link(Link(text="ARMED", reason="well", gateway_state="armed"))
            self.feed.publish_view()

    def _check(self) -> None:
        while not self._ended.is_set():
            self.requests.queue.run(0.05)

    def close(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()
        self._client.disconnect()
        self._client.loop_stop()
        self.site.stop()


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rospy, "wait_for_service", lambda *_: None)
        patch.setattr(rospy, "loginfo", lambda *_: None)
        cell = Cell(tmp_path_factory.mktemp("cell"))
        yield cell
        cell.close()


def distance(point: np.ndarray, path: np.ndarray) -> float:
    """Return how far a point is from a path of lines."""
    begin, along = path[:-1], np.diff(path, axis=0)
    fraction = np.clip(np.sum((point - begin) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
    return float(np.linalg.norm(begin + fraction[:, None] * along - point, axis=1).min())


@pytest.fixture(scope="module")
def designer(cell, python, tmp_path_factory):
    """A designer's session, which prints what it sees."""
    urdf = tmp_path_factory.mktemp("urdf") / "kr120.urdf"
    urdf.write_text(expand_xacro(str(XACRO), {}))
    account = cell.site.folder / "accounts/ada/account.json"
    schema = urdf.with_name("view.schema.json")
    schema.write_text(schemas.view_schema())
    command = [python, SESSION, *map(str, (cell.site.site.port, account, urdf, schema))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


@pytest.fixture(scope="module")
def session(designer):
    """What the designer saw and sent."""
    return json.loads(designer.stdout.readline())


def test_the_designer_sees_twin_and_arm(session):
    assert session["connect"] == "connected" and session["schema"] == []
    assert session["names"] == list(ROBOT.joint_names)
    assert session["twin"] == session["arm"] == pytest.approx(ROBOT.home, abs=1e-9)
    assert session["view"].splitlines() == ["link: ARMED, well", "sync: IN_SYNC, agree", "execution: IDLE, at rest"]


def test_frames_are_in_the_unit_that_was_said(session):
    pose = Chain(ROBOT).forward(ROBOT.home)
    axes = [*pose.rotation[:, 0], *pose.rotation[:, 1]]
    assert session["twin_frame_m"] == pytest.approx([*pose.position, *axes], abs=1e-6)
    assert session["twin_frame_mm"] == pytest.approx([*(pose.position * 1000.0), *axes], abs=1e-3)
    for key in ("units_not_said", "plan_units_not_said"):
        assert "say that of the Rhino document, mm or m: it is never guessed" in session[key]
    assert "frame 0 cannot be reached" in session["plan_wrong_units"]


def test_the_motion_that_is_reviewed_passes_the_designer_s_frames(session, cell):
    assert session["planned"] == "3 points"
    assert session["answer"]["ok"] is True and session["answer"]["plan_id"] == "plan 1", session["answer"]
    trajectory, chain = cell.planner.made[0], Chain(ROBOT)
    passed = np.array([chain.forward(q).position * 1000.0 for q in trajectory.positions])
    for frame in session["frames_mm"]:
        assert distance(np.array(frame[:3]), passed) < 0.1
    end = chain.forward(trajectory.positions[-1])
    assert [*end.rotation[:, 0], *end.rotation[:, 1]] == pytest.approx(session["frames_mm"][-1][3:], abs=1e-5)


def test_the_reviewer_reads_which_account_sent_it(session, cell):
    assert cell.planner.sources[0] == "MQTT account ada, which says it is 'Ada'"


def test_a_component_that_runs_again_sends_nothing_again(session, cell):
    assert session["sent"] == session["sent_again"] and len(cell.planner.sources) == 3


def test_times_are_kept_and_what_is_too_fast_is_refused_with_the_planner_s_sentence(session, cell):
    assert session["timed"]["ok"] is True and cell.planner.made[1].duration == pytest.approx(4.5)
    assert session["fast"]["ok"] is False and "joint_a1" in session["fast"]["text"]
    assert session["no trajectory"] == "a str is no JointTrajectory of compas_fab"


def test_a_view_that_was_lost_comes_back_when_the_broker_does(cell, designer, session):
    """compas_eve subscribes once, and a broker that was started again has forgotten it."""
    cell.site.stop()
    lost = json.loads(designer.stdout.readline())
    assert lost["fresh"] is False and "the last view came" in lost["text"]
    cell.site.start()
    assert json.loads(designer.stdout.readline())["fresh"] is True
    assert json.loads(designer.stdout.readline()) == "off" and designer.wait(20.0) == 0


@pytest.mark.parametrize("path", COMPONENTS, ids=lambda path: path.name)
def test_the_components_are_for_the_python_of_rhino_8(path):
    ast.parse(path.read_text(), feature_version=(3, 9))
    if path.name != "twin_grasshopper.py":
        wanted = path.read_text().splitlines()[0].removeprefix("# r: ").split(", ")
        assert set(wanted) <= set(REQUIREMENTS.read_text().split())
