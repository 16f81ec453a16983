"""A node's ports without ROS: what it declares is opened as calls, so that a test speaks and listens for the rest of the system."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from types import SimpleNamespace

import genpy

from construction_twin.ros.shared import node_shell as ports
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.transport.latest_pose import StampedPose


class Unplugged:
    """A node that runs without a master.

    Args:
        pose: Takes the oldest age; returns every pose that the node asks for.
        parameters: Shared ones that are on the parameter server; what the node keeps there is put in.
    """

    diagnose: Callable

    def __init__(self, monkeypatch, shell: NodeShell, settings, robot, pose: Callable = lambda *_: (), parameters=None):
        self.callbacks: dict[str, Callable] = {}
        self.services: dict[str, Callable] = {}
        self.timers: list[Callable] = []
        self.published: dict[str, list] = {}
        self.refused: list[tuple[str, str]] = []
        self.counted: list[tuple[str, str]] = []
        self.opened: list[tuple[str, str]] = []
        self.parameters: dict[str, object] = {} if parameters is None else parameters
        patch = monkeypatch.setattr
        patch(ports.rospy, "get_param", self.parameters.get)
        patch(ports.rospy, "set_param", self.parameters.__setitem__)
        patch(ports, "NodeDiagnostics", self._diagnostics)
        patch(ports, "Publisher", self._publisher)
        patch(ports, "JointPublisher", self._publisher)
        patch(ports, "Subscriber", Subscriber)
        patch(ports, "JointSubscriber", lambda topic, _names, callback, *_: self.subscribe(topic, callback))
        patch(ports, "LatestPose", lambda topic, *_: self._opens("reads", topic, newest_pose(pose)))
        patch(ports, "Service", self._serve)
        patch(ports.rospy, "Timer", lambda _period, callback: self.timers.append(callback))
        patch(Subscriber, "bench", self, raising=False)
        self.node = shell.open(settings, robot)

    def _diagnostics(self, _name: str, diagnose: Callable, _kind: str = "state"):
        Unplugged.diagnose = staticmethod(diagnose)
        return SimpleNamespace(
            refuse=lambda *said: self.refused.append(said), count=lambda *said: self.counted.append(said)
        )

    def _opens(self, what: str, name: str, made: object) -> object:
        self.opened.append((what, name))
        return made

    def _publisher(self, topic: str, *_, **__):
        sent = self.published.setdefault(topic, [])

        def publish(*content) -> None:
            sent.append(over_the_wire(content[0]) if isinstance(content[0], genpy.Message) else content)

        return self._opens("publishes", topic, SimpleNamespace(publish=publish))

    def subscribe(self, topic: str, callback: Callable) -> None:
        self.callbacks[topic] = callback
        self._opens("hears", topic, None)

    def _serve(self, name: str, _kind: type, handler: Callable) -> None:
        self.services[name] = handler
        self._opens("serves", name, None)


def newest_pose(pose: Callable) -> SimpleNamespace:
    """Return what stands in place of a `LatestPose`; `pose` takes the oldest age."""
    newest = lambda oldest: StampedPose(tuple(pose(oldest)), time.time_ns(), time.monotonic())  # noqa: E731
    return SimpleNamespace(pose=pose, newest=newest)


def ask(shell: NodeShell, node: object, name: str, request: object = None, refuse: Callable = lambda *_: None):
    """Return the answer of a service that a node declares, as its caller gets it."""
    (served,) = (each for each in shell.interface.serves if each.name == name)
    return served.answer(node, refuse, request)


def over_the_wire(message: genpy.Message) -> genpy.Message:
    """Return what arrives of a message."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


class Subscriber:
    """In place of the one that asks a master; its publisher is there."""

    bench: Unplugged

    def __init__(self, topic: str, _kind: type, callback: Callable, *_):
        self._topic = topic
        self.bench.subscribe(topic, callback)

    def get_num_connections(self) -> int:
        return 1

    def unregister(self) -> None:
        del self.bench.callbacks[self._topic]
