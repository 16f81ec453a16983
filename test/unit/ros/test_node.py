"""An unexpected exception ends a node's process with a code that roslaunch respawns on, in whatever thread it occurs.

Each kind in a process of its own, without a master: what is injected goes through rospy's own code.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest
import rospy

from construction_twin.ros.shared import node as module

BEGIN = """
import threading, time, types
import rospy
from std_srvs.srv import Trigger, TriggerResponse
from construction_twin.core.errors import PayloadError
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.transport.subscriber import Subscriber

rospy.init_node = lambda name: rospy.rostime.set_rostime_initialized(True)
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
    assert ended.returncode == 1 and "cannot run: nan" in ended.stderr and "Traceback" not in ended.stderr


def test_while_ros_shuts_down_an_error_is_only_written_down(monkeypatch):
    said = []
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: True)
    monkeypatch.setattr(rospy, "logfatal", lambda *words: said.append(words[0] % words[1:]))
    monkeypatch.setattr(rospy, "get_name", lambda: "/node")
    monkeypatch.setattr(module, "os", SimpleNamespace(_exit=lambda code: pytest.fail("ended")))
    error = ValueError("closed")
    module.end_on_error(threading.ExceptHookArgs((ValueError, error, None, threading.current_thread())))
    assert len(said) == 1 and "during shutdown" in said[0]


def test_a_thread_may_end_itself(monkeypatch):
    monkeypatch.setattr(module, "os", SimpleNamespace(_exit=lambda code: pytest.fail("ended")))
    module.end_on_error(threading.ExceptHookArgs((SystemExit, SystemExit(0), None, threading.current_thread())))
