"""Bags that are played into a live system; each node's log says of each stream by itself that it is refused."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import genpy
import rosbag
import rosgraph
import rospy
from rosgraph_msgs.msg import Log
from twin_client import wait

#: The messages of all streams are played for this long [s], which leaves every subscriber time to connect to each.
DURATION = 12.0
#: Their distance [s].
PERIOD = 0.05


def subscribers(topic: str) -> set[str]:
    """Return the names of the nodes that have subscribed to a topic."""
    return set(dict(rosgraph.Master("/test").getSystemState()[1]).get(topic, ()))


def excerpt(bag: Path, topics: Iterable[str]) -> dict[str, list[genpy.Message]]:
    """Return what a bag holds of some of its topics."""
    with rosbag.Bag(str(bag)) as whole:
        return {topic: [message for _, message, _ in whole.read_messages(topics=[topic])] for topic in topics}


def write(path: Path, streams: Mapping[str, Sequence[genpy.Message]]) -> Path:
    """Write a bag with the messages of each stream again and again, the last one at its end; return its path.

    Who listens to everybody, as the test's own client does, has then heard last what is still true.
    """
    count = round(DURATION / PERIOD)
    with rosbag.Bag(str(path), "w") as bag:
        for topic, messages in streams.items():
            assert messages, f"nothing was recorded of {topic}"
            for number in range(count):
                bag.write(topic, messages[(number - count) % len(messages)], genpy.Time.from_sec(1.0 + number * PERIOD))
    return path


def play(bag: Path) -> None:
    """Play a bag to its end, as a person does who has forgotten that the system runs."""
    subprocess.run(["rosbag", "play", "--quiet", bag], check=True, timeout=60)


class RefusalLog:
    """What nodes log of messages that they refuse for their sender."""

    def __init__(self) -> None:
        self._entries: list[Log] = []
        rospy.Subscriber("/rosout", Log, self._entries.append)

    def _named(self, node: str, rule: str) -> list[str]:
        line = re.compile(rf"^{node} refused \(publisher\): message from \S*/play_\d+; only {rule}$")
        return [entry.msg for entry in list(self._entries) if entry.name == node and line.search(entry.msg)]

    def assert_named_once(self, node: str, rule: str) -> None:
        """Each stream of a bag is one line in the log of a node, with the names of its sender and of who may publish it.

        Args:
            rule: After "only", as a pattern.
        """
        wait(lambda: self._named(node, rule), f"{node} to name who played what only {rule}")
        named = self._named(node, rule)
        assert len(named) == 1, (node, rule, named)
