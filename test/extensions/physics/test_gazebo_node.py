"""The node `gazebo`: in which scene it starts Gazebo's server, and what it says when that ends. The server is a small program."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
import rospy
from executor_bench import ROBOT
from unplugged import Unplugged

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.physics.gazebo_world import GazeboWorld
from construction_twin.extensions.physics.nodes import gazebo as module
from construction_twin.extensions.physics.nodes.gazebo import GazeboNode, Settings
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.scene.objects import Scene, SceneObject

SCENE = Scene((SceneObject("cube", "box", (0.1,) * 3, (1.0, 1.0, 1.0)),))
#: No test waits longer than this for what must come [s].
SOON = 60.0


class Server:
    """A server that ends when a test says so."""

    def __init__(self, world: Path):
        self.world, self.files = world, sorted(each.name for each in world.parent.iterdir())
        self.text = world.read_text()
        self.code: int | None = None
        self.signals: list[int] = []
        self.asked, self.obeys = 0, True

    def wait(self, timeout=None):
        self.asked += 1
        if self.code is None:
            raise subprocess.TimeoutExpired("gzserver", timeout)
        return self.code

    def send_signal(self, number):
        self.signals.append(number)
        if self.obeys:
            self.code = 0

    def kill(self):
        self.code = -9


class Bench:
    """The node around it. `over`: the shutdown has begun; `at_wait`: called while a server runs."""

    def __init__(self, monkeypatch, tmp_path):
        self.servers: list[Server] = []
        self.over = False
        self.problem = ""
        self.refused: list[tuple[str, str]] = []
        self.at_wait = lambda server: None
        monkeypatch.setattr(rospy, "is_shutdown", self.is_over)
        monkeypatch.setattr(module, "PAUSE", 0.0)
        for said in ("loginfo", "logerr"):
            monkeypatch.setattr(rospy, said, lambda *_: None)
        monkeypatch.setattr(module, "world_of", self.make)
        monkeypatch.setattr(module, "launch_server", lambda words, path: self.launch(path))
        monkeypatch.setenv("ROS_HOME", str(tmp_path))
        ports = SimpleNamespace(diagnostics=SimpleNamespace(refuse=lambda *said: self.refused.append(said)))
        self.node = GazeboNode(Settings(gzserver=sys.executable, drives="", realtime=0), ROBOT, ports)

    def is_over(self) -> bool:
        if self.servers and self.servers[-1].code is None:
            self.at_wait(self.servers[-1])
        return self.over

    def make(self, _bodies, scene: Scene, *_) -> GazeboWorld:
        if self.problem:
            raise ConstructionTwinError(self.problem)
        return GazeboWorld(f"<sdf>{scene.hash}</sdf>", {"0_mesh.stl": b"solid"}, ("a remark",))

    def launch(self, path: Path) -> Server:
        self.servers.append(Server(path))
        return self.servers[-1]

    def tell(self, scene: Scene) -> None:
        self.node.on_scene(scene_to_msg(scene, rospy.Time(1), "base_link"))


@pytest.fixture
def bench(monkeypatch, tmp_path):
    return Bench(monkeypatch, tmp_path)


def test_nothing_starts_before_the_scene_is_known(bench):
    bench.node.work(0.0)
    assert bench.servers == []
    assert bench.node.report().sentence == "Gazebo is started when the scene is known"


def test_a_server_that_ends_is_told_and_started_again_in_the_present_scene(bench):
    def crash(server: Server) -> None:
        bench.tell(Scene())
        report = bench.node.report()
        assert report.level == module.WARN and Scene().hash[:12] in report.sentence
        server.code = -11

    bench.tell(SCENE)
    bench.at_wait = crash
    bench.node.work(0.0)
    report = bench.node.report()
    assert report.level == module.ERROR and "(SIGSEGV)" in report.sentence
    assert report.values["ended"] == 1
    bench.at_wait = lambda server: setattr(server, "code", 3)
    bench.node.work(0.0)
    assert [server.text for server in bench.servers] == [f"<sdf>{each.hash}</sdf>" for each in (SCENE, Scene())]
    assert "code 3" in bench.node.report().sentence and "2 times" in bench.node.report().sentence


@pytest.mark.parametrize("obeys", [True, False])
def test_a_shutdown_ends_the_server(bench, obeys):
    def shut_down(server: Server) -> None:
        server.obeys, bench.over = obeys, True

    bench.tell(SCENE)
    bench.at_wait = shut_down
    bench.node.run()
    assert len(bench.servers) == 1
    assert bench.servers[0].code == (0 if obeys else -9)
    assert bench.node.report().values["ended"] == 0


def test_the_started_node_simulates_its_robot_with_the_program_that_it_was_told(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    for said in ("loginfo", "logerr"):
        monkeypatch.setattr(rospy, said, lambda *_: None)
    program = tmp_path / "server.py"
    program.write_text("import pathlib, sys; pathlib.Path(sys.argv[1] + '.seen').write_text(open(sys.argv[1]).read())")
    settings = Settings(gzserver=f"{sys.executable} {program}", drives="", realtime=7)
    node = Unplugged(monkeypatch, module.NODE, settings, ROBOT).node
    over = threading.Event()
    monkeypatch.setattr(rospy, "is_shutdown", over.is_set)
    node.on_scene(scene_to_msg(SCENE, rospy.Time(1), "base_link"))
    monkeypatch.setattr(module, "PAUSE", 0.0)
    node.work(0.0)
    seen = tmp_path / "construction_twin" / f"{ROBOT.name}_gazebo" / "twin.world.seen"
    assert "<realtime>7</realtime>" in seen.read_text() and 'name="cube_' in seen.read_text()


def test_the_server_ends_when_the_node_is_killed(tmp_path):
    """By Linux: nothing of the node is left to end it."""
    server = tmp_path / "server.py"
    server.write_text("import os, sys, time; print(os.getpid(), flush=True); time.sleep(600)")
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time; from pathlib import Path; from construction_twin.extensions.physics.nodes import gazebo;"
            f"gazebo.launch_server([sys.executable, {str(server)!r}], Path('/none')); time.sleep(600)",
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    pid = int(parent.stdout.readline())
    with open(os.pidfd_open(pid)) as ended:
        parent.kill()
        parent.wait(SOON)
        assert select.select([ended], [], [], 10.0)[0]
    parent.stdout.close()
