"""Who may see which camera: whom the broker lets read the camera's topic. Pure; time is an argument.

The robot's programs say on ``<prefix>/<robot>/camera/<name>``, again and again, that the camera is there. The broker passes that to
whom its rules let read it, and to nobody else. So a message on this topic, on its way from the broker to a browser's session, is
the broker's word that the session's account may see the camera. That the broker has granted the subscription is not: mosquitto
grants every one where its rules stand in a file (2.0), and then delivers nothing. A browser cannot make up the message: it comes
from the broker's side of the pipe.
"""

from __future__ import annotations

from collections.abc import Iterable

_PUBLISH = 3
#: Longest topic that is looked at [bytes].
_LONGEST = 200


class TopicScanner:
    """Finds the topics of the messages in what a broker sends, and keeps nothing else of it.

    A message with an alias in place of its topic (MQTT 5.0, section 3.3.2.3.4) has none: the one that has set the alias had it.
    """

    def __init__(self) -> None:
        self._head = bytearray()
        self._skip = 0
        self._lost = False

    @property
    def kept(self) -> int:
        """How much is kept until more has come [bytes]."""
        return len(self._head)

    def feed(self, data: bytes) -> list[str]:
        """Take bytes; return the topics that are complete now. After what is no MQTT there are none any more."""
        topics: list[str] = []
        at = 0
        while at < len(data) and not self._lost:
            if self._skip:
                step = min(self._skip, len(data) - at)
                self._skip -= step
                at += step
                continue
            self._head.append(data[at])
            at += 1
            self._look(topics)
        return topics

    def _look(self, topics: list[str]) -> None:
        """Look whether the packet's head is complete; then pass over the rest of the packet."""
        head = self._head
        # first byte, one to four bytes of length, of a message the topic's length and the topic
        end = next((k for k in range(1, min(len(head), 5)) if not head[k] & 0x80), 0)
        if not end:
            self._lost = len(head) >= 5
            return
        length = sum((head[k] & 0x7F) << 7 * (k - 1) for k in range(1, end + 1))
        taken = len(head) - end - 1
        if head[0] >> 4 == _PUBLISH and length >= 2:
            if taken < 2:
                return
            name = int.from_bytes(head[end + 1 : end + 3], "big")
            if name <= min(_LONGEST, length - 2):
                if taken < 2 + name:
                    return
                topics.append(bytes(head[end + 3 :]).decode("utf-8", "replace"))
        self._skip = length - taken
        head.clear()


class CameraRights:
    """What the broker has let each account read lately, on sessions that are open.

    Args:
        topics: Of the cameras; others are forgotten at once.
        valid_s: A message counts for so long [s]: it is repeated, and a right that was taken away ends with it.
    """

    def __init__(self, topics: Iterable[str], valid_s: float):
        self._topics = frozenset(topics)
        self._valid_s = valid_s
        #: By account and topic, of each session the time of the last message [s].
        self._heard: dict[tuple[str, str], dict[int, float]] = {}

    def delivered(self, session: int, account: str, topic: str, now: float) -> None:
        """Note that the broker has sent a message on a topic to a session that it has logged in to an account."""
        if topic in self._topics:
            self._heard.setdefault((account, topic), {})[session] = now

    def ended(self, session: int) -> None:
        """Note that a session has ended."""
        for key, sessions in tuple(self._heard.items()):
            sessions.pop(session, None)
            if not sessions:
                del self._heard[key]

    @property
    def kept(self) -> int:
        """Of how many pairs of account and camera something is kept."""
        return len(self._heard)

    def may_see(self, accounts: Iterable[str], topic: str, now: float) -> bool:
        """Return whether one of the accounts of a browser may see the camera of a topic."""
        times = (time for account in accounts for time in self._heard.get((account, topic), {}).values())
        return any(now - time <= self._valid_s for time in times)
