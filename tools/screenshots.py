"""Takes the pictures of docs/images/: starts the system on a display in memory, brings it into each state, checks what is drawn.

`python tools/screenshots.py [NAME...]`; needs no display. A picture in which something is missing ends the script with 1.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test" / "integration"))

import numpy as np  # noqa: E402
import rospy  # noqa: E402
from construction_twin.msg import Rehearsal, SceneObject, Sync, WorkTasks  # noqa: E402
from construction_twin.srv import (  # noqa: E402
    AddObject,
    AttachObject,
    PlanToJoints,
    PlanToJointsResponse,
    PreviewPlan,
    WorkPlanTask,
)
from geometry_msgs.msg import Point, Pose, Quaternion  # noqa: E402
from screenshot import VirtualDisplay, bare_view, extent, fraction  # noqa: E402
from twin_client import Stream, TwinClient, wait  # noqa: E402

from construction_twin.core.errors import ConstructionTwinError  # noqa: E402
from construction_twin.review.rehearsal_report import FAILED  # noqa: E402

IMAGES = ROOT / "docs" / "images"
WORK = ROOT / "config" / "work"
#: Size of a picture [pixels], and the most it may weigh [bytes].
SIZE, WEIGHT = (1100, 760), 300_000
#: Longest wait for a state, and for something to be drawn [s].
READY, DRAWN = 180.0, 150.0
#: Time between two checks of what is drawn [s]: rviz draws without a graphics card and needs the processor.
LOOK = 0.5
#: Least fraction of the picture's width and height that the arm covers.
LARGE = 0.15
GOAL = (-40.0, -70.0, 75.0, 20.0, 60.0, -40.0)
#: The arm alone, large.
NEAR = {"Distance": 4.0, "Focal Point": {"X": 0.65, "Y": 0.0, "Z": 1.05}}
#: Further away and higher, so that the text over the arm is in the picture.
WITH_TEXT = {"Distance": 5.4, "Focal Point": {"X": 0.5, "Y": 0.0, "Z": 1.55}}
#: For two texts, one over the other.
HIGHER = {"X": 0.5, "Y": 0.0, "Z": 1.75}
#: From above, so that table, racks and arm are in the picture; elements that stand in it.
OF_THE_PANEL = {"Distance": 5.6, "Pitch": 0.75, "Yaw": 1.9, "Focal Point": {"X": 0.3, "Y": 0.4, "Z": 0.8}}
PLACED = 2
#: Edges of a block of 166 kg at the density that an unknown material is given [m], and a view with the torques behind the arm.
BLOCK = (0.55, 0.55, 0.55)
OF_THE_COLUMNS = {"Distance": 4.8, "Pitch": 0.2, "Yaw": 5.75, "Focal Point": {"X": 0.2, "Y": -0.35, "Z": 1.35}}
#: Joint that stalls, and how far the arm has moved when it does [deg].
STALLED, MOVED = "joint_a1", 12.0


class Camera:
    """rviz on a display in memory.

    Args:
        folder: For the view files.
    """

    def __init__(self, display: VirtualDisplay, folder: Path):
        self._display, self._folder = display, folder

    def shoot(self, name: str, config: str, least: dict[str, float], view: str = "", **camera) -> None:
        """Show a view until enough of each colour is there, then write docs/images/NAME.png.

        Args:
            name, config: Of the picture, and of the file in rviz/.
            least: Fraction of the picture that each colour must have; of ``a|b`` both together.
            view: Saved view.
            **camera: Keys of the view that are to be different.

        Raises:
            AssertionError: When a colour does not appear, or the picture is too heavy.
        """
        path = self._folder / f"{name}.rviz"
        text = (ROOT / "rviz" / f"{config}.rviz").read_text()
        path.write_text(bare_view(text, self._display.size, view, camera))
        self.shoot_program(name, ["rviz", "-d", str(path), "--fullscreen", f"__name:=camera_{name}"], least)

    def shoot_program(self, name: str, command: list[str], least: dict[str, float], **environment: str) -> None:
        """Do the same with the window of another program, which is as large as the display."""
        program = subprocess.Popen(
            command, env=self._display.environment | environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            self._wait(program, name, least)
        finally:
            program.terminate()
            program.wait(30)

    def home_of_gazebo(self) -> str:
        """Return a home folder with which gzclient opens a window as large as the display."""
        width, height = self._display.size
        (self._folder / ".gazebo").mkdir()
        (self._folder / ".gazebo/gui.ini").write_text(f"[geometry]\nx=0\ny=0\nwidth={width}\nheight={height}\n")
        return str(self._folder)

    def _wait(self, program: subprocess.Popen, name: str, least: dict[str, float]) -> None:
        target = IMAGES / f"{name}.png"
        raw = self._folder / f"{name}.png"
        fractions, settled = {}, 0

        def drawn() -> bool:
            nonlocal fractions, settled
            assert program.poll() is None, f"{program.args[0]} ended with {program.returncode}"
            pixels = self._display.capture(raw)
            fractions = {
                colours: round(sum(fraction(pixels, one) for one in colours.split("|")), 5) for colours in least
            }
            # several times in a row: meshes come one by one; all of the arm, not a patch of its colour
            whole = all(one > LARGE for one in extent(pixels, "orange"))
            settled = settled + 1 if whole and all(fractions[colour] >= least[colour] for colour in least) else 0
            return settled > 3

        try:
            wait(drawn, f"the colours {least} in {name}.png", DRAWN, LOOK)
        except AssertionError as error:
            raise AssertionError(f"{error}; seen were {fractions}; the last picture is {keep(raw)}") from None
        subprocess.run(
            ["convert", str(raw), "-strip", "-dither", "None", "-colors", "255", f"PNG8:{target}"], check=True
        )
        assert target.stat().st_size < WEIGHT, (
            f"{target} has {target.stat().st_size} bytes, at most {WEIGHT} are wanted"
        )
        print(f"{target.relative_to(ROOT)}: {target.stat().st_size // 1000} kB, {fractions}", flush=True)


def keep(picture: Path) -> Path:
    """Move a picture that failed to the results, for inspection."""
    kept = Path(tempfile.gettempdir()) / f"screenshots_{picture.name}"
    if picture.exists():
        kept.write_bytes(picture.read_bytes())
    return kept


def shoot_one(camera: Camera) -> None:
    """One robot: in sync, a plan under review with its ghost, a joint that stalls in motion."""
    client = ready_client()
    camera.shoot("in_sync", "twin", {"orange": 0.015, "green": 0.002}, **NEAR)
    plan = make_plan(client, GOAL)
    with Stream("preview/joint_states") as ghost:
        rospy.ServiceProxy("preview_plan", PreviewPlan)(speed=2.0, loop=False)
        wait(lambda: ghost.moved(abs(GOAL[0]) - 1.0), "the ghost to reach the goal", READY)
    camera.shoot("plan", "twin", {"orange": 0.015, "pink": 0.0001}, **WITH_TEXT)
    hold(client, plan.plan_id, plan.plan_hash)
    camera.shoot("holding", "twin", {"orange": 0.003, "violet|red": 0.003}, **WITH_TEXT | {"Focal Point": HIGHER})


def shoot_marker(camera: Camera) -> None:
    """The marker that plans by hand, at the tool, from near."""
    ready_client()
    camera.shoot("marker", "twin", {"orange": 0.05, "green": 0.02}, view="Tool")


def ready_client() -> TwinClient:
    """Return a client of the robot in this process's namespace, once it could execute a plan."""
    # the last one that a launch file loads
    wait(
        lambda: rospy.has_param("robot/name") and rospy.has_param("gateway/properties"), "the robot's parameters", READY
    )
    client = TwinClient()
    client.wait_until_ready(READY)
    return client


def make_plan(client: TwinClient, goal: tuple[float, ...]) -> PlanToJointsResponse:
    """Have a motion planned; the goal in deg, and mm for linear joints."""
    rospy.wait_for_service("plan_to_joints", READY)
    answer = rospy.ServiceProxy("plan_to_joints", PlanToJoints)(goal=client.si(goal), duration=8.0, source="the README")
    assert answer.success, answer.message
    return answer


def hold(client: TwinClient, plan_id: str, plan_hash: str) -> None:
    """Approve a plan and let a joint stall in motion."""
    with Stream("mock_rsi/joint_states") as arm:
        answer = client.review(plan_id, plan_hash)
        assert answer.success, answer.message
        wait(lambda: arm.moved(MOVED), "the arm to move", READY)
        client.stall(STALLED, True)
    client.wait(lambda: client.sync.state not in (Sync.IN_SYNC, Sync.WAITING), "the gate to close", READY)


def shoot_rehearsal(camera: Camera) -> None:
    """A plan whose rehearsal has failed: too heavy a block at the flange."""
    client = ready_client()
    make_plan(client, GOAL)
    above = Pose(Point(0.0, 0.0, 4.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    block = SceneObject(name="block", shape="box", size=BLOCK, pose=above)
    rospy.wait_for_service("attach_object", READY)
    answer = rospy.ServiceProxy("add_object", AddObject)(object=block)
    assert answer.success, answer.message
    held = Pose(Point(0.0, 0.0, BLOCK[2] / 2), Quaternion(0.0, 0.0, 0.0, 1.0))
    attach = rospy.ServiceProxy("attach_object", AttachObject)
    answer = attach(name="block", touch=["link_3", "link_4", "link_5", "link_6", "flange"], use_pose=True, pose=held)
    assert answer.success, answer.message
    heard: list[Rehearsal] = []
    rospy.Subscriber("rehearsal", Rehearsal, heard.append)

    def planned() -> bool:
        # the planner hears of the scene for itself
        made = make_plan(client, GOAL)
        client.wait(lambda: client.plans and client.plans[-1].id == made.plan_id, "the plan")
        return client.plans[-1].scene == answer.hash

    wait(planned, "a plan with the block", READY)
    plan = client.plans[-1]
    wait(lambda: heard and heard[-1].plan_id == plan.id, "its rehearsal", READY)
    assert heard[-1].state == FAILED, heard[-1].state
    camera.shoot("rehearsal_rviz", "twin", {"orange": 0.01, "red": 0.005, "pink": 0.0001}, **OF_THE_COLUMNS)


def shoot_track(camera: Camera) -> None:
    """The arm on its track, with a plan that moves both."""
    client = ready_client()
    make_plan(client, (600.0, *GOAL))
    camera.shoot("track", "twin", {"orange": 0.01, "pink": 0.0001}, **WITH_TEXT | {"Distance": 6.4})


def shoot_two(camera: Camera) -> None:
    """Two robots in one cell, both in sync, and a plan of the one under review."""
    states: dict[str, int] = {}
    for robot in ("kr120_1", "kr120_2"):
        rospy.Subscriber(f"/{robot}/sync", Sync, lambda message, robot=robot: states.__setitem__(robot, message.state))
    wait(lambda: list(states.values()) == [Sync.IN_SYNC] * 2, "both robots to be in sync", READY)
    rospy.wait_for_service("/kr120_1/plan_to_joints", READY)
    plan = rospy.ServiceProxy("/kr120_1/plan_to_joints", PlanToJoints)
    answer = plan(goal=np.deg2rad(GOAL).tolist(), duration=8.0, source="the README")
    assert answer.success, answer.message
    camera.shoot("two_robots", "two_robots", {"orange": 0.02, "pink": 0.0001}, Distance=7.0, Pitch=0.3)


def shoot_work(camera: Camera) -> None:
    """Work from a building model: two elements stand, the ghost carries the third one to its place."""
    client = ready_client()
    tasks: list[WorkTasks] = []
    rospy.Subscriber("work/tasks", WorkTasks, tasks.append)
    wait(lambda: tasks and tasks[-1].tasks, "the model to be read", READY)
    rospy.wait_for_service("work/plan", READY)
    plan_next = rospy.ServiceProxy("work/plan", WorkPlanTask)

    def states() -> dict[str, str]:
        return {task.id: task.state for task in tasks[-1].tasks}

    while list(states().values()).count("done") < PLACED:
        answer = plan_next("")
        assert answer.success, answer.message
        client.wait(lambda plan_id=answer.plan_id: client.plans and client.plans[-1].id == plan_id, "the plan")
        verdict = client.review(answer.plan_id, answer.plan_hash)
        assert verdict.success, verdict.message
        client.wait_for_outcome(answer.plan_id, "finished", READY)
        client.wait(lambda task=answer.task: states()[task] == "done", "the task", READY)
        client.wait_until_ready(READY)
    answer = plan_next("")
    assert answer.success, answer.message
    with Stream("preview/joint_states") as ghost:
        rospy.ServiceProxy("preview_plan", PreviewPlan)(speed=1.0, loop=True)
        wait(lambda: ghost.moved(5.0), "the ghost to move", READY)
    camera.shoot("work", "twin", {"orange": 0.01, "green": 0.02, "pink": 0.0001}, **OF_THE_PANEL)


def shoot_gazebo(camera: Camera) -> None:
    """Gazebo's own window, with the arm where a plan has led it."""
    client = ready_client()
    plan = make_plan(client, GOAL)
    verdict = client.review(plan.plan_id, plan.plan_hash)
    assert verdict.success, verdict.message
    client.wait_for_outcome(plan.plan_id, "finished", READY)
    camera.shoot_program("gazebo", [*GAZEBO, "gzclient"], {"orange": 0.01}, HOME=camera.home_of_gazebo())


#: What stands before a program of Gazebo where it is not installed.
GAZEBO = () if shutil.which("gzserver") else (str(ROOT / "scripts/gazebo_chroot.sh"), "run")
os.environ["GZSERVER"] = " ".join((*GAZEBO, "gzserver"))
#: Launch file and arguments, namespace, and what is photographed.
SCENES: dict[str, tuple[tuple[str, ...], str, Callable[[Camera], None]]] = {
    "one": (("bringup.launch",), "kr120", shoot_one),
    "marker": (("bringup.launch", "gui:=marker"), "kr120", shoot_marker),
    "rehearsal": (("bringup.launch", "rehearsal:=require"), "kr120", shoot_rehearsal),
    "track": (("bringup.launch", "track:=true"), "kr120", shoot_track),
    "work": (
        (
            "bringup.launch",
            "track:=true",
            f"work_model:={ROOT}/models/timber_panel.ifc",
            f"work_cell:={WORK}/timber_panel.yaml",
            f"scene:={WORK}/timber_panel_scene.yaml",
            f"tool:={ROOT}/config/tools/vacuum_frame.yaml",
        ),
        "kr120",
        shoot_work,
    ),  # fmt: skip
    # without arms: two whole robots want two cores for themselves, and rviz takes one
    "two_robots": (("two_robots.launch", "arm:=none"), "", shoot_two),
    "gazebo": (("gazebo.launch",), "kr120", shoot_gazebo),
}
#: Photographed only when it is named: not every machine has Gazebo, or root for a chroot.
BY_NAME = {"gazebo"}


def free_port(kind: int) -> int:
    """Return a port of the loopback that nothing uses now."""
    with socket.socket(socket.AF_INET, kind) as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]


@contextmanager
def system(launch: tuple[str, ...], folder: Path):
    """Run a launch file on a master, broker and RSI ports of its own; yield the environment for its clients."""
    tcp, udp = [free_port(socket.SOCK_STREAM) for _ in range(2)], [free_port(socket.SOCK_DGRAM) for _ in range(2)]
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{tcp[0]}", "ROS_HOME": str(folder / "ros_home")}
    numbers = ("_1", "_2") if launch[0] == "two_robots.launch" else ("",)
    ports = [f"broker_port:={tcp[1]}", *(f"rsi_port{number}:={port}" for number, port in zip(numbers, udp))]
    with open(folder / "launch.log", "w") as log:
        run = subprocess.Popen(
            ["roslaunch", "-p", str(tcp[0]), "construction_twin", *launch, *ports],
            env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            yield environment
        finally:
            run.send_signal(signal.SIGINT)  # lets it end its nodes
            run.wait(60)


def photograph(scene: str) -> int:
    """Take one scene's pictures in the environment of a running system; return the exit code."""
    rospy.init_node("screenshots", anonymous=True)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        display = stack.enter_context(VirtualDisplay(SIZE))
        try:
            SCENES[scene][2](Camera(display, folder))
        except (AssertionError, ConstructionTwinError, rospy.ROSException, rospy.ServiceException) as error:
            print(f"screenshots: {scene}: {error}", file=sys.stderr)
            return 1
    return 0


def main(arguments: list[str]) -> int:
    """Take the pictures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help=f"of {list(SCENES)}; none: all but {sorted(BY_NAME)}"
    )
    parser.add_argument(
        "--photograph", action="store_true", help="take one scene's pictures of a system that runs already"
    )
    options = parser.parse_args(arguments)
    unknown = set(options.scenes) - set(SCENES)
    if unknown:
        parser.error(f"there is no scene {sorted(unknown)}; expected some of {list(SCENES)}")
    if options.photograph:
        return photograph(options.scenes[0])
    IMAGES.mkdir(parents=True, exist_ok=True)
    failed = []
    for scene in options.scenes or [name for name in SCENES if name not in BY_NAME]:
        launch, namespace, _ = SCENES[scene]
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as folder, system(launch, Path(folder)) as environment:
            command = [sys.executable, __file__, scene, "--photograph"]
            if subprocess.run(command, env=environment | {"ROS_NAMESPACE": f"/{namespace}"}).returncode:
                failed.append(scene)
                print((Path(folder) / "launch.log").read_text()[-4000:], file=sys.stderr)
        print(f"scene {scene}: {time.monotonic() - started:.0f} s", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
