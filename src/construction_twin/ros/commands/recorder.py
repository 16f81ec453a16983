"""A `rosbag record` process under the caller's control: started, known to be connected, closed properly."""

from __future__ import annotations

import signal
import subprocess
import xmlrpc.client
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rosgraph
import roslib.packages

from construction_twin.core.errors import ConstructionTwinError


class Recorder:
    """Records topics, by resolved names, into one bag while the ``with`` block runs, or until `stop`.

    It stays in the caller's process group, so that whatever ends the node (roslaunch, a terminal's Ctrl-C) ends it too.
    """

    def __init__(self, path: Path, topics: Sequence[str], name: str):
        programs = roslib.packages.find_node("rosbag", "record")
        if not programs:
            raise ConstructionTwinError("rosbag's recorder is not installed; install the package python3-rosbag")
        self.path = path
        self._topics = tuple(topics)
        self._name = name
        self._master = rosgraph.Master(name)
        namespace, _, base = name.rpartition("/")
        # --buffsize 0: no limit, so that a slow disk loses no samples
        options = ["--buffsize", "0", "-O", str(path), f"__name:={base}", f"__ns:={namespace or '/'}"]
        self._process = subprocess.Popen([programs[0], *options, *topics], stdout=subprocess.DEVNULL)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_) -> None:
        self._end(signal.SIGINT)

    def connected(self) -> bool:
        """Return whether every publisher of the topics sends to the recorder: they are asked, it counts a connection too early."""
        if self._process.poll() is not None:
            raise ConstructionTwinError(f"the recorder ended with status {self._process.returncode}; is the disk full?")
        try:
            publishers, subscribers, _ = self._master.getSystemState()
            subscribed = {topic for topic, nodes in subscribers if self._name in nodes}
            wanted = {(topic, node) for topic, nodes in publishers if topic in self._topics for node in nodes}
            return subscribed.issuperset(self._topics) and wanted <= self._sent_by({node for _, node in wanted})
        except (rosgraph.MasterException, rosgraph.MasterError, OSError, xmlrpc.client.Error):
            return False  # a node is still registering, or just left

    def _sent_by(self, nodes: set[str]) -> set[tuple[str, str]]:
        sent = set()
        for node in nodes:
            answer: Any = xmlrpc.client.ServerProxy(self._master.lookupNode(node)).getBusInfo(self._name)
            _, _, connections = answer
            for _, subscriber, direction, _, topic, connected, *_ in connections:
                if direction == "o" and subscriber == self._name and connected:
                    sent.add((topic, node))
        return sent

    def stop(self, timeout: float) -> None:
        """End the recording and wait until the bag is closed."""
        self._end(signal.SIGINT, timeout)
        if not self.path.exists():
            raise ConstructionTwinError(f"{self.path} was not closed within {timeout:g} s; see `rosbag reindex`")

    def _end(self, number: signal.Signals, timeout: float = 10.0) -> None:
        if self._process.poll() is None:
            self._process.send_signal(number)
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
