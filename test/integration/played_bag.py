"""Bags that are played into a live system: each stream by itself, so that each can be seen to be refused."""

from __future__ import annotations

import subprocess
from pathlib import Path

import genpy
import rosbag
import rosgraph

#: A stream's messages are played in turn for this long [s], which leaves every subscriber time to connect.
DURATION = 1.0
#: Their distance [s].
PERIOD = 0.05


def subscribers(topic: str) -> set[str]:
    """Return the names of the nodes that have subscribed to a topic."""
    return set(dict(rosgraph.Master("/test").getSystemState()[1]).get(topic, ()))


def excerpt(bag: Path, topic: str) -> Path:
    """Return a bag beside another one with messages of one of its topics alone."""
    with rosbag.Bag(str(bag)) as whole:
        return write(bag.parent, topic, [message for _, message, _ in whole.read_messages(topics=[topic])])


def write(folder: Path, topic: str, messages: list[genpy.Message]) -> Path:
    """Return a bag with messages of one topic, again and again, the last one at its end.

    Who listens to everybody, as the test's own client does, has then heard last what is still true.
    """
    assert messages, f"nothing was recorded of {topic}"
    path = folder / f"{topic.strip('/').replace('/', '_')}.bag"
    with rosbag.Bag(str(path), "w") as bag:
        count = round(DURATION / PERIOD)
        for number in range(count):
            bag.write(topic, messages[(number - count) % len(messages)], genpy.Time.from_sec(1.0 + number * PERIOD))
    return path


def play(bag: Path) -> None:
    """Play a bag to its end, as a person does who has forgotten that the system runs."""
    subprocess.run(["rosbag", "play", "--quiet", bag], check=True, timeout=60)
