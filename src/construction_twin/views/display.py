"""Whether a display can show a window; and a view file for a robot of another name."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable

from construction_twin.core.sentences import Sentence

#: Robot that the files in rviz/ are written for.
ROBOT = "kr120"
#: First TCP port of X11 displays, and how long a display may take to answer [s].
_X11_PORT, _TIMEOUT = 6000, 3.0


def display_problem(display: str, connect: Callable[[str, int], None]) -> str:
    """Return in one sentence why no window can be shown; empty when one can.

    Args:
        display: Environment variable DISPLAY.
        connect: ``connect(host, number)`` reaches display `number`; host "" is this machine. Raises OSError when it cannot.
    """
    if not display:
        return Sentence("view.display.none")
    found = re.fullmatch(r"(?:unix)?([^:]*):(\d+)(?:\.\d+)?", display)
    if found is None:
        return Sentence("view.display.wrong", display=repr(display))
    try:
        connect(found[1], int(found[2]))
    except OSError as error:
        return Sentence("view.display.silent", display=display, problem=str(error))
    return ""


def connect_display(host: str, number: int) -> None:
    """Open a connection to an X11 display and close it again.

    Raises:
        OSError: If nothing answers.
    """
    if host:
        socket.create_connection((host, _X11_PORT + number), _TIMEOUT).close()
        return
    address = f"/tmp/.X11-unix/X{number}"
    # servers listen on the file, on Linux's abstract name, or both
    for name in (address, f"\0{address}"):
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(_TIMEOUT)
            try:
                link.connect(name)
                return
            except OSError as error:
                problem = error
    raise problem


def view_for(text: str, robot: str) -> str:
    """Return a view file's text for a robot of another name: `kr120` as a whole word becomes its name."""
    return re.sub(rf"\b{ROBOT}\b", robot, text)
