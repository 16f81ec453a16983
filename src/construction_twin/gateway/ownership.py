"""Who may command: a second session and a message that came before are refused. Standard library only."""

from __future__ import annotations

from collections import deque

from construction_twin.mqtt.messages import Control

#: Ended sessions and answered control messages that are remembered.
MEMORY = 1000


class _Memory:
    """The last `MEMORY` things that were put in."""

    def __init__(self) -> None:
        self._order: deque = deque()
        self._known: set = set()

    def __contains__(self, thing: object) -> bool:
        return thing in self._known

    def add(self, thing: object) -> None:
        """Remember a thing; of too many the oldest is forgotten."""
        if thing in self._known:
            return
        self._known.add(thing)
        self._order.append(thing)
        if len(self._order) > MEMORY:
            self._known.remove(self._order.popleft())


class Ownership:
    """Who may command: one session at a time, never one that has ended, and no control message twice."""

    def __init__(self) -> None:
        self._had_their_turn = _Memory()
        self._answered = _Memory()
        #: The last session that was refused because another owns the arm, "" for none, and how often that happened.
        self.intruder = ""
        self.intrusions = 0

    def begin(self, session: str) -> None:
        """Give a session its turn."""
        self._had_their_turn.add(session)

    def knows(self, session: str) -> bool:
        """Return whether a session has had its turn; what still comes from it was sent before its end."""
        return session in self._had_their_turn

    def refuse(self, session: str) -> None:
        """Note a session that wanted what another has."""
        self.intruder = session
        self.intrusions += 1

    def is_repeated(self, control: Control) -> bool:
        """Return whether a control message came before: QoS 1 may deliver twice, and recordings can be replayed."""
        key = (control.session, control.id, control.verb)
        if key in self._answered:
            return True
        self._answered.add(key)
        return False
