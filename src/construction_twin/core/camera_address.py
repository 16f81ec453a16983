"""Which cameras a site has: names, addresses, robots; and the MQTT topic that is the right to see one. Pure.

Addresses come from whoever starts the console, and from nobody else: a browser names a robot and a camera, and gets that one
or none.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import urlsplit

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence

_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
#: What a request line may hold (RFC 3986): no blank, no control character, no fragment.
_PATH = re.compile(r"/[!-\"$-~]{0,500}|")
#: Most cameras of a console.
MOST = 16


@dataclass(frozen=True)
class CameraAddress:
    """One camera.

    Attributes:
        robot: Beside whose picture it stands.
        path: With its query, as the request line has it.
    """

    name: str
    robot: str
    host: str
    port: int
    path: str

    def __str__(self) -> str:
        """Return what `camera_of` reads."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.name}=http://{host}:{self.port}{self.path}@{self.robot}"

    def topic(self, prefix: str) -> str:
        """Return the topic on which the robot's programs announce it: whoever may read that may see the camera."""
        return f"{prefix}/{self.robot}/camera/{self.name}"


def camera_of(words: str, robot: str = "") -> CameraAddress:
    """Return what ``front=http://10.0.0.7:8080/stream@kr120`` says; without ``@`` it is of `robot`.

    Raises:
        ConfigurationError: When it has another form.
    """
    name, _, rest = words.partition("=")
    # an address may hold an @ in its path; a robot's name holds no slash
    address, _, own = rest.rpartition("@")
    if not address or "/" in own:
        address, own = rest, robot
    expected = Sentence("expected.camera")
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or "", 80 if parts.port is None else parts.port
    except ValueError as error:
        raise ConfigurationError("--camera", words, expected) from error
    path = parts.path + (f"?{parts.query}" if parts.query else "")
    plain = parts.scheme == "http" and host and port > 0 and not parts.fragment and "@" not in parts.netloc
    if not (plain and _PATH.fullmatch(path) and _NAME.fullmatch(name) and _NAME.fullmatch(own)):
        raise ConfigurationError("--camera", words, expected)
    return CameraAddress(name, own, host, port, path or "/")


def cameras_of(lists: Iterable[str], robot: str = "") -> tuple[CameraAddress, ...]:
    """Return the cameras in lists, whose entries are separated by blanks; see `camera_of`.

    Raises:
        ConfigurationError: Also when two of a robot have one name, or there are more than `MOST`.
    """
    cameras = tuple(camera_of(words, robot) for each in lists for words in each.split())
    named = [(camera.robot, camera.name) for camera in cameras]
    if len(set(named)) < len(named) or len(named) > MOST:
        raise ConfigurationError("--camera", " ".join(lists), Sentence("expected.cameras", most=MOST))
    return cameras
