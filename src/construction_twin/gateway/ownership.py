"""Who may command: a second session and a message that came before are refused. Standard library only."""

from __future__ import annotations

from construction_twin.mqtt.messages import Control

#: Ended sessions and answered control messages that are remembered.
MEMORY = 1000


class Ownership:
    """Who may command: one session at a time, never one that has ended, and no control message twice."""

    def __init__(self) -> None:
        self._had_their_turn: dict[object, None] = {}
        self._answered: dict[object, None] = {}
        #: The last session that was refused because another owns the arm, "" for none, and how often that happened.
        self.intruder = ""
        self.intrusions = 0

    def begin(self, session: str) -> None:
        """Give a session its turn."""
        _remember(self._had_their_turn, session)

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
        _remember(self._answered, key)
        return False


def _remember(known: dict[object, None], thing: object) -> None:
    """Keep a thing among the last `MEMORY`."""
    known.setdefault(thing)
    if len(known) > MEMORY:
        del known[next(iter(known))]
