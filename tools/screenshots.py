"""Takes the pictures of docs/images/ again: brings the system into each state on a display in memory, and checks what is drawn.

`make demo ARGS=screenshots`, or `ARGS="screenshots one console"`; needs no display. A picture in which something is missing ends
the script with 1. rviz and Gazebo are drawn by Xvfb and photographed by ImageMagick, the console's page by chromium.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "test/integration"), str(ROOT / "test/support"), str(ROOT / "benchmarks")]

import rospy  # noqa: E402
import yaml  # noqa: E402
from console_page import ConsolePage, launch  # noqa: E402
from construction_twin.msg import Rehearsal, SceneObject, Sync, WorkTasks  # noqa: E402
from construction_twin.srv import (  # noqa: E402
    AddObject,
    AttachObject,
    PlanToJoints,
    PreviewPlan,
    WorkPlanTask,
)
from geometry_msgs.msg import Point, Pose, Quaternion  # noqa: E402
from link_world import free_port, listens  # noqa: E402
from matplotlib import colors, image  # noqa: E402
from playwright.sync_api import Browser, expect, sync_playwright  # noqa: E402
from twin_client import Stream, TwinClient, wait  # noqa: E402

from construction_twin.core.errors import ConstructionTwinError  # noqa: E402
from construction_twin.core.units import radians  # noqa: E402
from construction_twin.review.rehearsal_report import FAILED  # noqa: E402

IMAGES = ROOT / "docs" / "images"
WORK = ROOT / "config" / "work"
#: Size of a picture [pixels], and the most that it, or the recording, may weigh [bytes].
SIZE, WEIGHT, WEIGHT_OF_RECORDING = (1100, 760), 300_000, 1_500_000
#: Longest wait for a state, for something to be drawn, and for a program to answer [s].
READY, DRAWN, TIMEOUT = 180.0, 150.0, 60.0
#: Time between two checks of what is drawn [s]: rviz draws without a graphics card and needs the processor.
LOOK = 0.5
#: Hues of what is looked for in a picture: lowest and highest, as a fraction of the colour circle; least saturation and brightness.
COLOURS = {
    "orange": (0.03, 0.095, 0.6, 0.35),
    "pink": (0.87, 0.96, 0.45, 0.5),
    "green": (0.25, 0.45, 0.15, 0.1),
    "violet": (0.68, 0.82, 0.15, 0.3),
    "red": (0.96, 0.02, 0.5, 0.3),
}
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


@contextmanager
def virtual_display():
    """Run an X server in memory with a number of its own choice; yield the environment of programs that show themselves there."""
    if shutil.which("Xvfb") is None:
        raise ConstructionTwinError("there is no program Xvfb; apt-get install xvfb")
    read, write = os.pipe()
    screen = f"{SIZE[0]}x{SIZE[1]}x24"
    # without TCP; the server writes the number of its display when it is ready
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", screen, "-nolisten", "tcp", "+extension", "GLX"],
        pass_fds=[write], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    try:
        if not number:
            raise ConstructionTwinError(f"Xvfb has no display: exit code {server.wait()}")
        yield os.environ | {"DISPLAY": f":{number}", "LIBGL_ALWAYS_SOFTWARE": "1"}
    finally:
        server.terminate()
        server.wait(TIMEOUT)


def fraction(picture: Path, colour: str) -> float:
    """Return which fraction of a PNG has one of the `COLOURS`, light or in shadow."""
    low, high, least_saturation, least_value = COLOURS[colour]
    pixels = image.imread(picture)
    if pixels.ndim == 2:  # grey: nothing is drawn yet
        return 0.0
    hue, saturation, value = colors.rgb_to_hsv(pixels[..., :3]).transpose(2, 0, 1)
    inside = (low <= hue) & (hue <= high) if low <= high else (low <= hue) | (hue <= high)
    return float((inside & (saturation >= least_saturation) & (value >= least_value)).mean())


def bare_view(text: str, camera: dict[str, object]) -> str:
    """Return a view file's text for a picture: no panels, the window as large as the display.

    Args:
        text: Of a file of rviz/.
        camera: Keys of the view that are to be different.
    """
    settings = yaml.safe_load(text)
    manager = settings["Visualization Manager"]
    manager["Views"]["Current"] |= camera
    # a low frame rate will do; without a graphics card every frame costs processor time
    manager["Global Options"]["Frame Rate"] = 4
    settings["Panels"] = []
    settings["Window Geometry"] = {"Width": SIZE[0], "Height": SIZE[1], "X": 0, "Y": 0}
    return yaml.safe_dump(settings, sort_keys=False)


def convert(words: list[str], name: str, most: int = WEIGHT) -> None:
    """Have ImageMagick write a file of docs/images; AssertionError when it is too heavy."""
    target = IMAGES / name
    subprocess.run(["convert", *words, f"PNG8:{target}" if target.suffix == ".png" else str(target)], check=True)
    size = target.stat().st_size
    assert size <= most, f"{target} has {size} bytes, at most {most} are wanted"
    print(f"{target.relative_to(ROOT)}: {size // 1000} kB", flush=True)


class Camera:
    """Photographs rviz and other programs on a display in memory.

    Args:
        folder: For files that are made on the way.
        display: Environment of programs that show themselves there.
    """

    def __init__(self, folder: Path, display: dict[str, str]):
        self.folder, self._display = folder, display

    def shoot(self, name: str, config: str, least: dict[str, float], **camera) -> None:
        """Show a view until enough of each colour is there, then write docs/images/NAME.png.

        Args:
            config: Name of the file in rviz/.
            least: Fraction of the picture that each colour must have; of ``a|b`` both together.
            **camera: Keys of the view that are to be different.
        """
        path = self.folder / f"{name}.rviz"
        path.write_text(bare_view((ROOT / "rviz" / f"{config}.rviz").read_text(), camera))
        self.shoot_program(name, ["rviz", "-d", str(path), "--fullscreen", f"__name:=camera_{name}"], least)

    def shoot_program(self, name: str, command: list[str], least: dict[str, float], **environment: str) -> None:
        """Do the same with the window of another program, which is as large as the display."""
        program = subprocess.Popen(
            command, env=self._display | environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        raw, fractions, settled = Path(tempfile.gettempdir()) / f"screenshots_{name}.png", {}, 0

        def drawn() -> bool:
            nonlocal fractions, settled
            assert program.poll() is None, f"{program.args[0]} ended with {program.returncode}"
            words = ["import", "-silent", "-window", "root", "-strip", str(raw)]
            subprocess.run(words, env=self._display, check=True, timeout=TIMEOUT)
            fractions = {each: sum(fraction(raw, one) for one in each.split("|")) for each in least}
            # several times in a row: meshes come one by one
            settled = settled + 1 if all(fractions[each] >= least[each] for each in least) else 0
            return settled > 3

        try:
            wait(drawn, f"the colours {least} in {name}.png", DRAWN, LOOK)
        except AssertionError as error:
            raise AssertionError(f"{error}; seen were {fractions}; the last picture is {raw}") from None
        finally:
            program.terminate()
            program.wait(30)
        convert([str(raw), "-strip", "-dither", "None", "-colors", "255"], f"{name}.png")
        raw.unlink()


def shoot_one(camera: Camera) -> None:
    """One robot: in sync, a plan under review with its ghost, a joint that stalls in motion."""
    client = ready_client()
    camera.shoot("in_sync", "twin", {"orange": 0.015, "green": 0.002}, **NEAR)
    plan = client.plan_to(GOAL, 8.0)
    with Stream("preview/joint_states") as ghost:
        rospy.ServiceProxy("preview_plan", PreviewPlan)(speed=2.0, loop=False)
        wait(lambda: ghost.moved(abs(GOAL[0]) - 1.0), "the ghost to reach the goal", READY)
    camera.shoot("plan", "twin", {"orange": 0.015, "pink": 0.0001}, **WITH_TEXT)
    with Stream("mock_rsi/joint_states") as arm:
        answer = client.review(plan.plan_id, plan.plan_hash)
        assert answer.success, answer.message
        wait(lambda: arm.moved(MOVED), "the arm to move", READY)
        client.stall(STALLED, True)
    client.wait(lambda: client.sync.state not in (Sync.IN_SYNC, Sync.WAITING), "the gate to close", READY)
    camera.shoot("holding", "twin", {"orange": 0.003, "violet|red": 0.003}, **WITH_TEXT | {"Focal Point": HIGHER})


def ready_client() -> TwinClient:
    """Return a client of the robot in this process's namespace, once it could execute a plan."""
    # the last one that a launch file loads
    wait(
        lambda: rospy.has_param("robot/name") and rospy.has_param("gateway/properties"), "the robot's parameters", READY
    )
    client = TwinClient()
    client.wait_until_ready(READY)
    return client


def shoot_rehearsal(camera: Camera) -> None:
    """A plan whose rehearsal has failed: too heavy a block at the flange."""
    client = ready_client()
    client.plan_to(GOAL, 8.0)
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
        client.plan_to(GOAL, 8.0)
        return client.plans[-1].scene == answer.hash

    wait(planned, "a plan with the block", READY)
    plan = client.plans[-1]
    wait(lambda: heard and heard[-1].plan_id == plan.id, "its rehearsal", READY)
    assert heard[-1].state == FAILED, heard[-1].state
    camera.shoot("rehearsal_rviz", "twin", {"orange": 0.01, "red": 0.005, "pink": 0.0001}, **OF_THE_COLUMNS)


def shoot_two(camera: Camera) -> None:
    """Two robots in one cell, both in sync, and a plan of the one under review."""
    states: dict[str, int] = {}
    for robot in ("kr120_1", "kr120_2"):
        rospy.Subscriber(f"/{robot}/sync", Sync, lambda message, robot=robot: states.__setitem__(robot, message.state))
    wait(lambda: list(states.values()) == [Sync.IN_SYNC] * 2, "both robots to be in sync", READY)
    rospy.wait_for_service("/kr120_1/plan_to_joints", READY)
    plan = rospy.ServiceProxy("/kr120_1/plan_to_joints", PlanToJoints)
    answer = plan(goal=radians(GOAL), duration=8.0, source="the README")
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
    client.wait_for_outcome(client.start(GOAL, 8.0).plan_id, "finished", READY)
    # a window as large as the display
    (camera.folder / ".gazebo").mkdir()
    (camera.folder / ".gazebo/gui.ini").write_text(f"[geometry]\nx=0\ny=0\nwidth={SIZE[0]}\nheight={SIZE[1]}\n")
    camera.shoot_program("gazebo", [*GAZEBO, "gzclient"], {"orange": 0.01}, HOME=str(camera.folder))


ROBOT = "kr120"
TABLET, PHONE, RECORDED = (1280, 800), (390, 844), (1000, 700)
#: The goal of the pictures, by joint [deg]: what a person types beside the sliders.
CONSOLE_GOAL = {"joint_a1": "-40", "joint_a2": "-70", "joint_a3": "75", "joint_a5": "45"}
GOAL_A1 = math.radians(float(CONSOLE_GOAL["joint_a1"]))
#: Fraction of the limits that is asked for: slow enough to be watched.
SPEED = "0.25"
#: Of the recording: time between two pictures [s], width [px] and number of colours that are kept.
STEP, WIDTH, KEPT_COLOURS = 0.2, 600, 48


#: Of the page; the process that photographs has it from its parent.
CONSOLE_PORT = int(os.environ.setdefault("CONSOLE_PORT", str(free_port())))


def shoot_page(camera: Camera, page: ConsolePage, name: str) -> None:
    """Take one picture of the page."""
    raw = camera.folder / name
    page.wait_frame()
    page.page.screenshot(path=raw)
    convert([str(raw), "-strip", "-dither", "None", "-colors", "255"], name)


def open_page(browser: Browser, **more) -> ConsolePage:
    """Return a page in which the arm is drawn."""
    page = ConsolePage(browser, f"http://127.0.0.1:{CONSOLE_PORT}/", picture=True, **more).open()
    page.wait_drawn(ROBOT, "it.twin.joints !== null && it.arm.joints !== null", 1000 * READY)
    return page


def ask_for_plan(camera: Camera, page: ConsolePage) -> None:
    """Set the goal, take a picture of that, and ask for the plan."""
    plan = page.tab("plan")
    plan.locator(".plan-begin").click(timeout=1000 * READY)
    for joint, value in CONSOLE_GOAL.items():
        field = plan.locator(".plan-joint", has_text=joint).locator("input[type=text]")
        field.fill(value)
        field.press("Enter")
    page.wait_drawn(ROBOT, f"it.goal.joints !== null && Math.abs(it.goal.joints.joint_a1 - {GOAL_A1}) < 1e-3")
    shoot_page(camera, page, "console_goal.png")
    plan.get_by_label("Speed").select_option(SPEED)
    plan.locator(".plan-ask").click()
    expect(plan.locator(".plan-answer")).to_contain_text("There is a plan", timeout=1000 * READY)


def record(camera: Camera, page: ConsolePage) -> None:
    """Record how a plan is played, approved and carried out, as fast as it happened; the last picture stays for two seconds."""
    frames: list[tuple[Path, float]] = []

    def until(condition: Callable[[], bool], what: str) -> None:
        def come_true() -> bool:
            frames.append((camera.folder / f"frame{len(frames):04d}.png", time.monotonic()))
            page.page.screenshot(path=frames[-1][0])
            page.page.wait_for_timeout(1000 * max(0.0, frames[-1][1] + STEP - time.monotonic()))
            return condition()

        wait(come_true, what, READY)

    status = page.page.locator("#status")
    # a broker without accounts knows nobody's name
    page.page.locator(".verdict-name input").fill("ada")
    page.page.locator(".playback-play").click()
    until(page.approve_button.is_enabled, "the plan played to its end")
    # again where this machine was too busy for a press of a second
    for _ in range(10):
        page.press_approve()
        until(lambda: page.notice.is_visible() and "Sending" not in page.notice.inner_text(), "the approval")
        page.page.mouse.up()
        if not page.is_disturbed():
            break
    expect(page.notice).to_contain_text("accepted")
    until(lambda: "moves" in status.inner_text() or "playing" in status.inner_text(), "the motion")
    until(lambda: abs(page.drawn(ROBOT)["arm"]["joints"]["joint_a1"] - GOAL_A1) < 0.003, "the end of the motion")
    times = [at for _, at in frames]
    shown = [after - before for before, after in zip(times, times[1:])] + [2.0]
    pieces = [
        word for (file, _), time_s in zip(frames, shown) for word in ("-delay", str(round(100 * time_s)), str(file))
    ]
    smaller = ["-resize", f"{WIDTH}x", "-dither", "None", "-colors", str(KEPT_COLOURS), "-layers", "Optimize"]
    convert(["-loop", "0", *pieces, *smaller], "console.gif", WEIGHT_OF_RECORDING)


def shoot_console(camera: Camera) -> None:
    """The page: a goal is set and its plan asked for, looked at from a tablet and a phone, played, approved, and the arm moves."""
    wait(lambda: listens(CONSOLE_PORT), "the console listening", READY)
    with sync_playwright() as playwright:
        browser = launch(playwright)
        page = open_page(browser, size=TABLET, color_scheme="light")
        ask_for_plan(camera, page)
        for name, size, scheme in (
            ("console.png", TABLET, "light"), ("console_dark.png", TABLET, "dark"), ("console_phone.png", PHONE, "light"),
        ):  # fmt: skip
            if name != "console.png":
                page.close()
                page = open_page(browser, size=size, color_scheme=scheme, has_touch=size == PHONE)
            page.wait_drawn(ROBOT, "it.path !== null")
            shoot_page(camera, page, name)
        page.close()
        page = open_page(browser, size=RECORDED, color_scheme="light")
        page.wait_drawn(ROBOT, "it.path !== null")
        record(camera, page)
        assert not page.errors, page.errors
        browser.close()


#: What stands before a program of Gazebo where it is not installed.
GAZEBO = () if shutil.which("gzserver") else (str(ROOT / "scripts/gazebo_chroot.sh"), "run")
os.environ["GZSERVER"] = " ".join((*GAZEBO, "gzserver"))
#: Launch file and arguments, namespace, and what is photographed.
SCENES: dict[str, tuple[tuple[str, ...], str, Callable[[Camera], None]]] = {
    "one": (("bringup.launch",), "kr120", shoot_one),
    "rehearsal": (("bringup.launch", "rehearsal:=require"), "kr120", shoot_rehearsal),
    "console": (("bringup.launch", "console:={folder}/console.yaml"), "kr120", shoot_console),
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


@contextmanager
def system(launch: tuple[str, ...], folder: Path):
    """Run a launch file on a master, broker and RSI ports of its own; yield the environment for its clients."""
    tcp, udp = [free_port() for _ in range(2)], free_port(socket.SOCK_DGRAM)
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{tcp[0]}", "ROS_HOME": str(folder / "ros_home")}
    ports = [f"broker_port:={tcp[1]}", f"rsi_port:={udp}"]
    shipped = (ROOT / "config/console.yaml").read_text()
    (folder / "console.yaml").write_text(shipped.replace("port: 8480", f"port: {CONSOLE_PORT}"))
    words = [word.format(folder=folder) for word in launch]
    with open(folder / "launch.log", "w") as log:
        run = subprocess.Popen(
            ["roslaunch", "-p", str(tcp[0]), "construction_twin", *words, *ports],
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
    try:
        with tempfile.TemporaryDirectory() as folder, virtual_display() as display:
            SCENES[scene][2](Camera(Path(folder), display))
    except (AssertionError, ConstructionTwinError, rospy.ROSException, rospy.ServiceException) as error:
        print(f"screenshots: {scene}: {error}", file=sys.stderr)
        return 1
    return 0


def main() -> int:
    """Take the pictures; return the exit code."""
    parser = argparse.ArgumentParser(prog="make demo ARGS=screenshots", description=__doc__.splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help=f"of {list(SCENES)}; none: all but {sorted(BY_NAME)}"
    )
    parser.add_argument(
        "--photograph", action="store_true", help="take one scene's pictures of a system that runs already"
    )
    options = parser.parse_args()
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
    sys.exit(main())
