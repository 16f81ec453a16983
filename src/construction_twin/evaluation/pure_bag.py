"""Reads a rosbag without ROS, by the package rosbags.

A bag carries the text of its messages' definitions, and rosbags generates Python code from the definitions that it is given. It is
given this package's (``msg``) beside its own of ROS's common messages, and nothing from the bag: what was recorded with another
definition (type name and md5) is refused, as `construction_twin.ros.shared.known_bag` does it for ROS's reader.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from construction_twin.core.errors import NOT_OPENED, ConstructionTwinError, FileError, problem_of
from construction_twin.core.sentences import Sentence
from construction_twin.core.share import share_file
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.bag import TYPES, Bag, check_definition, recording_of
from construction_twin.evaluation.recording import Recording

#: What rosbags raises for a file that is damaged or another one's: it takes what it finds for text, lengths and offsets.
_DAMAGED = (
    ReaderError, SerdeError, ValueError, LookupError, EOFError, TypeError, AssertionError, OverflowError, MemoryError, RuntimeError,
    struct.error,
)  # fmt: skip


class PureBag:
    """A bag that rosbags has open, as `bag.Bag`."""

    def __init__(self, reader: Reader):
        self._reader = reader
        self._store, self._known = _definitions()
        self.types: Mapping[str, str] = {each.topic: _ros1(each) for each in reader.connections}

    def messages(self, topics: Iterable[str]) -> Iterator[tuple[str, Any, int]]:
        """Return topic, message and reception [ns]; see `open_bag` for what is raised."""
        wanted = set(topics)
        chosen = [each for each in self._reader.connections if each.topic in wanted]
        for each in chosen:
            check_definition(self._known, each.topic, _ros1(each), each.digest)
        # rosbags takes no connection for all of them
        for connection, received, data in self._reader.messages(chosen) if chosen else ():
            yield connection.topic, self._store.deserialize_ros1(data, connection.msgtype), received

    def nanoseconds(self, time: Any) -> int:
        """Return a time in a message [ns]."""
        return int(time.sec) * NANOSECONDS + int(time.nanosec)


def read_recording(path: str | Path, namespace: str | None = None) -> Recording:
    """Read one robot's run from a bag, without ROS.

    Args:
        namespace: The robot's namespace, e.g. ``/kr120``; default: that of the only robot in the bag.

    Raises:
        ConstructionTwinError: If the file cannot be read as a bag, holds no or several robots, a topic of another type or of
            another definition of its type, or too little data.
    """
    with open_bag(path) as bag:
        return recording_of(bag, namespace)


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """Open a bag for reading. No code is generated from what it contains.

    Raises:
        ConstructionTwinError: If the file cannot be read as a bag, also if that shows while it is read.
    """
    try:
        # rosbags says of a file that is not there that it is damaged
        Path(path).open("rb").close()
        with Reader(path) as reader:
            yield PureBag(reader)
    except NOT_OPENED as error:
        raise FileError(str(path), error) from error
    except (*_DAMAGED, OSError) as error:
        if "not indexed" in str(error):
            raise ConstructionTwinError(Sentence("view.bag.unclosed", path=str(path))) from error
        raise ConstructionTwinError(
            Sentence("view.bag.unreadable", path=str(path), problem=problem_of(error))
        ) from error


@cache
def _definitions() -> tuple[Typestore, Mapping[str, str]]:
    """Return how messages are read, and the md5 of each type of `TYPES`."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for file in sorted(share_file("msg").glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"construction_twin/msg/{file.stem}"))
    names = sorted(set(TYPES.values()))
    return store, {name: store.generate_msgdef(name.replace("/", "/msg/"), ros_version=1)[1] for name in names}


def _ros1(connection: Connection) -> str:
    """Return a type's name as ROS 1 has it."""
    return connection.msgtype.replace("/msg/", "/")
