"""Reads a rosbag into a `Recording` with ROS's own reader. Needs no ROS master and no running node.

A bag may come from elsewhere: it is opened by `known_bag.open_bag`, which runs no code from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import genpy
import rosbag
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from construction_twin.evaluation.bag import PLAN, choose_robot, messages_of, recording_of
from construction_twin.evaluation.recording import Recording
from construction_twin.msg import Execution, Feedback, Link, Plan, Review, Sync
from construction_twin.robot.plan import Plan as PlanValue
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.shared.known_bag import open_bag

#: The bag is read with these classes; another definition of the same type is refused.
KINDS: tuple[type[genpy.Message], ...] = (
    JointState,
    Feedback,
    Execution,
    Plan,
    Link,
    Sync,
    Review,
    String,
)


class RosBag:
    """A bag that rosbag has open, as `construction_twin.evaluation.bag.Bag`."""

    def __init__(self, bag: rosbag.Bag):
        self._bag = bag
        self.types: Mapping[str, str] = {
            topic: info.msg_type for topic, info in bag.get_type_and_topic_info().topics.items()
        }

    def messages(self, topics: Iterable[str]) -> Iterator[tuple[str, Any, int]]:
        """Return topic, message and reception [ns]; see `known_bag.open_bag` for what is raised."""
        for topic, message, received in self._bag.read_messages(topics=list(topics)):
            yield topic, message, received.to_nsec()

    def nanoseconds(self, time: genpy.Time) -> int:
        """Return a time in a message [ns]."""
        return time.to_nsec()


def read_recording(path: str | Path, namespace: str | None = None) -> Recording:
    """Read one robot's run from a bag.

    Args:
        namespace: The robot's namespace, e.g. ``/kr120``; default: that of the only robot in the bag.

    Raises:
        ConstructionTwinError: If the file cannot be read as a bag, holds no or several robots, a topic of another type or of
            another definition of its type, or too little data.
    """
    with open_bag(path, KINDS) as bag:
        return recording_of(RosBag(bag), namespace)


def read_plans(path: str | Path, namespace: str | None = None) -> list[PlanValue]:
    """Return every plan of one robot in a bag, the oldest first.

    Args:
        path, namespace: As in `read_recording`.

    Raises:
        ConstructionTwinError: As `read_recording`.
        TrajectoryError: For a plan that is not what its hash says.
    """
    with open_bag(path, KINDS) as opened:
        bag = RosBag(opened)
        messages = messages_of(bag, choose_robot(bag.types, namespace, PLAN), (PLAN,))
    # a latched plan is recorded once more by whoever listens again
    return list({message.id: plan_from_msg(message) for _, message in messages[PLAN]}.values())
