"""An unexpected exception ends a node's process with a code that roslaunch respawns on, in whatever thread it occurs.

Each kind in a process of its own, without a master: what is injected goes through rospy's own code.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path
from types import SimpleNamespace

import pytest
import rosgraph
import rospy
import yaml
from ros_master import Server, ros_master

from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.nodes.neighbour import await_robot
from construction_twin.ros.shared import node as module
from construction_twin.ros.shared import start_refusal

ROOT = Path(__file__).resolve().parents[3]
BEGIN = """
import threading, time, types
import rospy
from std_srvs.srv import Trigger, TriggerResponse
from construction_twin.core.errors import PayloadError
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.transport.subscriber import Subscriber

from construction_twin.ros.shared import node as shared_node

shared_node.wait_for_master = lambda name: None
rospy.init_node = lambda name, argv, disable_signals: rospy.rostime.set_rostime_initialized(True)
rospy.get_param = lambda name, default: default
rospy.resolve_name = lambda name, caller_id=None: "/kr120/" + name

def fail(*_):
    raise IndexError("injected")

class Node:
    def run(self):
        time.sleep(20)
"""
#: How an error gets into a running node.
INJECTED = {
    "thread": "threading.Thread(target=fail, name='mqtt', daemon=True).start()",
    "timer": "rospy.Timer(rospy.Duration(0.01), fail)",
    "callback": """
        rospy.Subscriber = lambda topic, kind, receive, **_: types.SimpleNamespace(receive=receive)
        stream = Subscriber("sync", object, fail, fail, queue_size=1)
        from rospy.topics import _SubscriberImpl
        impl = _SubscriberImpl.__new__(_SubscriberImpl)
        message = types.SimpleNamespace(_connection_header={"callerid": "/kr120/pca_monitor"})
        invoke = (message, stream._subscriber.receive, None)
        threading.Thread(target=impl._invoke_callback, args=invoke, daemon=True).start()""",
    "service": """
        from rospy.impl.tcpros_service import ServiceImpl
        made = object.__new__(Service)
        made.resolved_name = "/kr120/stop"
        impl = object.__new__(ServiceImpl)
        impl.handler, impl.error_handler, impl.seq = fail, made._end, 0
        impl._write_service_error = lambda transport, sentence: print("answered:", sentence, flush=True)
        threading.Thread(target=impl._handle_request, args=(None, None), daemon=True).start()""",
    "main thread": "self.run = fail",
}


def run(body: str) -> subprocess.CompletedProcess:
    """Run a node whose constructor does something."""
    lines = [line.strip() for line in body.strip().splitlines()]
    code = BEGIN + "    def __init__(self):\n" + "".join(f"        {line}\n" for line in lines)
    code += "run_node('node', Node)\n"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("kind", INJECTED)
def test_an_unexpected_exception_ends_the_process(kind):
    ended = run(INJECTED[kind])
    assert ended.returncode == module.UNFORESEEN, ended.stderr
    assert "IndexError" in ended.stderr and "injected" in ended.stderr
    assert ("answered: error processing request: injected" in ended.stdout) is (kind == "service")


def test_a_typed_error_is_one_sentence():
    ended = run("raise PayloadError('values', 'nan')")
    assert ended.returncode == 1 and "cannot start: nan" in ended.stderr and "Traceback" not in ended.stderr


def test_simulated_time_is_refused_in_one_sentence(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    with ros_master() as uri:
        rosgraph.Master("/roslaunch", uri).setParam("/use_sim_time", True)
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        ended = run("raise TypeError('a clock that has not begun')")
    assert ended.returncode == 1 and "cannot start: /use_sim_time: found True, expected false" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_master_that_is_killed_while_a_node_starts_is_one_sentence(monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    ended = run("raise ConnectionResetError(104, 'Connection reset by peer')")
    assert ended.returncode == 1
    assert ended.stderr.splitlines() == [
        "node ends: http://127.0.0.1:1: no ROS master answers ([Errno 111] Connection refused); start bringup, "
        "or set ROS_MASTER_URI"
    ]


@pytest.mark.parametrize("asked", [True, False])
def test_ctrl_c_while_ros_is_initialised_is_no_traceback(asked):
    """rospy says so itself, by an exception; one for another reason is no known end."""
    body = "def init_node(name, argv, disable_signals):\n"
    body += "    rospy.signal_shutdown('signal-2')\n" if asked else ""
    body += "    raise rospy.exceptions.ROSInitException('init_node interrupted before it could complete')\n"
    code = f"{BEGIN}\n{body}\nrospy.init_node = init_node\nrun_node('node', Node)\n"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ended.returncode == 0, "Traceback" in ended.stderr) == (asked, not asked), ended.stderr


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def wait_for(condition, what: str, timeout: float = 60.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


@pytest.fixture
def started(tmp_path):
    """Start a program of nodes/ with its standard error in a file; it is killed at the end."""
    processes = []

    def start(name: str | Path, environment: dict[str, str]) -> tuple[subprocess.Popen, Path]:
        said = tmp_path / "said"
        with said.open("w") as file:
            command = [sys.executable, str(ROOT / "nodes" / name)]
            # into a file what INFO says would wait in a buffer
            settings = {**os.environ, "PYTHONUNBUFFERED": "1", **environment}
            process = subprocess.Popen(command, stdout=file, stderr=file, env=settings)
        processes.append(process)
        return process, said

    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.parametrize("name", ["executor", "rsi_gateway"])
def test_a_node_without_a_master_waits_and_says_so_in_one_line(started, name):
    port = free_port()
    process, said = started(name, {"ROS_MASTER_URI": f"http://127.0.0.1:{port}"})
    wait_for(lambda: "\n" in said.read_text(), "a line")
    sentence = (
        f"{name} waits: http://127.0.0.1:{port}: no ROS master answers ([Errno 111] Connection refused); start bringup"
    )
    assert said.read_text().startswith(sentence)
    # questions to a master that is not one, each tried again once by xmlrpc: the third connection is of the second question, and
    # the first was dealt with, without another word
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(60.0)
        for _ in range(3):
            server.accept()[0].close()
    assert said.read_text().count("\n") == 1 and process.poll() is None
    process.send_signal(signal.SIGINT)
    process.wait(60.0)
    assert said.read_text().count("\n") == 1


@pytest.mark.parametrize("killed", [False, True])
def test_a_running_node_says_one_line_at_most_when_its_master_is_killed_and_ctrl_c_is_no_warning(
    started, monkeypatch, killed
):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    port = free_port()
    uri = f"http://127.0.0.1:{port}"
    master = subprocess.Popen(["rosmaster", "--core", "-p", str(port)])
    try:
        wait_for(lambda: rosgraph.is_master_online(uri), "the master")
        parameters = rosgraph.Master("/bringup", uri)
        description = yaml.safe_load((ROOT / "config" / "kr120.yaml").read_text())
        parameters.setParam("/kr120/robot", description | {"name": "kr120"})
        parameters.setParam("/kr120/robot_description", expand_xacro(ROOT / "urdf" / "kr120r2500.urdf.xacro"))
        parameters.setParam("/kr120/display", {"arm": "none", "twin": "kinematic", "servo_model": ""})
        process, said = started("display", {"ROS_MASTER_URI": uri, "ROS_NAMESPACE": "kr120"})
        wait_for(lambda: "scheduling" in said.read_text(), "the last word of its start")
        before = said.read_text()
        if killed:
            master.kill()
            master.wait()
        process.send_signal(signal.SIGINT)
        process.wait(60.0)
    finally:
        master.kill()
        master.wait()
    text = said.read_text()
    assert "Traceback" not in text and "WARN" not in text and "ERROR" not in text
    assert text.removeprefix(before).count("\n") <= 1


class HeldMaster:
    """A master whose answers about one name are held back until they are let go; everything else goes through."""

    def __init__(self, master: str, name: str):
        self._master, self._name = master, name
        self.asked, self.let_go = threading.Event(), threading.Event()
        self.server = Server(("127.0.0.1", 0), logRequests=False)
        self.server.register_instance(self)
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}"

    def _dispatch(self, method: str, values: tuple):
        if self._name in values:
            self.asked.set()
            self.let_go.wait(60.0)
        return getattr(xmlrpc.client.ServerProxy(self._master), method)(*values)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_main_thread_asks_the_master_ends_the_node(started, tmp_path, monkeypatch, number):
    """Every log line asks it, once: whoever unregisters from within that question waits for himself."""
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    program = tmp_path / "node.py"
    program.write_text("""
import rospy
from std_msgs.msg import String
from construction_twin.ros.shared.node import run_node

class Node:
    def __init__(self):
        rospy.on_shutdown(lambda: print("shutting down", flush=True))
        self.topic = rospy.Publisher("t", String, queue_size=1)
    def run(self):
        rospy.get_param("~held", "")

run_node("node", Node)
""")
    with ros_master() as uri:
        held = HeldMaster(uri, "/node/held")
        process, said = started(program, {"ROS_MASTER_URI": held.uri})
        try:
            assert held.asked.wait(60.0)
            process.send_signal(number)
            wait_for(lambda: "shutting down" in said.read_text(), "the node to shut down")
            held.let_go.set()
            wait_for(lambda: process.poll() is not None, "the node to end", 20.0)
        finally:
            held.let_go.set()
            held.server.shutdown()
            held.server.server_close()
        assert "/t" not in dict(rosgraph.Master("/test", uri).getPublishedTopics("")), "it has unregistered"


def test_no_address_of_a_master_is_one_sentence(started):
    process, said = started("executor", {"ROS_MASTER_URI": "localhost:11311"})
    assert process.wait(60.0) == 1
    assert (
        said.read_text() == "executor cannot run: ROS_MASTER_URI: found 'localhost:11311', expected http://HOST:PORT\n"
    )


def test_a_node_that_cannot_start_says_why_and_ends_where_nobody_ends_its_launch(monkeypatch):
    said = []
    monkeypatch.setenv(start_refusal.VARIABLE, "launch_1")
    monkeypatch.setattr(start_refusal, "RESTART_DELAY", 0.0)
    monkeypatch.setattr(rospy, "on_shutdown", lambda _: None)
    publisher = SimpleNamespace(publish=lambda *fields: said.append(fields))
    monkeypatch.setattr(rospy, "Publisher", lambda topic, *_, latch, **__: publisher)
    with pytest.raises(SystemExit):
        start_refusal.refuse("no room on the disk")
    assert said == [("launch_1", "no room on the disk")]


def test_where_the_other_robot_of_the_cell_is_not_launched_yet_it_is_waited_for(monkeypatch):
    there, waited = {"/kr120_2/executor/arm"}, []
    monkeypatch.setattr(rospy, "get_namespace", lambda: "/kr120_1/")
    monkeypatch.setattr(rospy, "has_param", there.__contains__)
    monkeypatch.setattr(rospy, "logwarn", lambda *_: None)
    monkeypatch.setattr(
        rospy, "sleep", lambda _: (waited.append(1), len(waited) == 3 and there.add("/kr120_2/robot_description"))
    )
    await_robot("kr120_2")
    assert len(waited) == 3
