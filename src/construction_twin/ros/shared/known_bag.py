"""Bags read with the message definitions that this package knows, and with no other.

A bag carries the text of its messages' definitions. rosbag's reader generates Python code from that text and runs it, so a bag
from elsewhere is a program from elsewhere. `open_bag` replaces this step: a message is deserialised by the installed class of its
type, if the bag was recorded with the same definition (type name and md5), and refused otherwise.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import genpy
import rosbag
import rosbag.bag

from construction_twin.core.errors import NOT_OPENED, ConstructionTwinError, FileError, problem_of
from construction_twin.core.sentences import Sentence
from construction_twin.evaluation.bag import check_definition

#: rosbag's function from a connection to its message class is one per process.
_LOCK = threading.Lock()


@contextmanager
def open_bag(path: str | Path, kinds: Iterable[type[genpy.Message]]) -> Iterator[rosbag.Bag]:
    """Open a bag for reading. No code is generated from what it contains.

    Args:
        kinds: The types that may be read.

    Raises:
        ConstructionTwinError: When a message of another type, or of another definition of one of these types, is read; and when the
            file cannot be read as a bag, also if that shows while it is read.
    """
    known = {kind._type: kind for kind in kinds}

    def message_class(connection) -> type[genpy.Message]:
        return known_class(known, connection.topic, connection.datatype, connection.md5sum)

    with _LOCK:
        original = rosbag.bag._get_message_type
        # the only place in rosbag that generates code; a test checks that it is not called
        rosbag.bag._get_message_type = message_class
        try:
            with rosbag.Bag(str(path)) as bag:
                yield bag
        except rosbag.ROSBagUnindexedException as error:
            raise ConstructionTwinError(Sentence("view.bag.unclosed", path=str(path))) from error
        except NOT_OPENED as error:
            raise FileError(str(path), error) from error
        except (rosbag.ROSBagException, genpy.DeserializationError, OSError) as error:
            unreadable = Sentence("view.bag.unreadable", path=str(path), problem=problem_of(error))
            raise ConstructionTwinError(unreadable) from error
        except (ValueError, LookupError, EOFError) as error:
            # rosbag takes what it finds for text, lengths and numbers of connections
            damaged = Sentence("view.bag.damaged", path=str(path), problem=str(error))
            raise ConstructionTwinError(damaged) from error
        finally:
            rosbag.bag._get_message_type = original


def known_class(known: dict[str, type[genpy.Message]], topic: str, name: str, md5: str) -> type[genpy.Message]:
    """Return the installed class of a recorded message.

    Args:
        known: By type name.
        topic, name, md5: Of the bag's connection: topic, type name and md5 of the definition.

    Raises:
        ConstructionTwinError: If the type is not among them, or its definition is another one.
    """
    check_definition({each: kind._md5sum for each, kind in known.items()}, topic, name, md5)
    return known[name]
