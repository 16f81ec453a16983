"""The desk as several threads share it: not there before the model is read, nor after its ledger or its model has failed."""

from __future__ import annotations

import threading

from construction_twin.work.desk import Desk, WorkRefused


class SharedDesk:
    """A desk, or why there is none.

    Args:
        problem: Why there is none yet, as a sentence.

    Attributes:
        lock: Guards desk and ledger; never held while somebody else is waited for who may wait for it.
        problem: Why there is none.
        broken: There will be none any more.
    """

    def __init__(self, problem: str):
        self.lock = threading.RLock()
        self.desk: Desk | None = None
        self.problem = problem
        self.broken = False

    def open(self, desk: Desk) -> None:
        """Let everybody use a desk from now on."""
        with self.lock:
            self.problem, self.desk = "", desk

    def fail(self, problem: str) -> None:
        """Take the desk away: its record or its model cannot be used."""
        with self.lock:
            self.problem, self.desk, self.broken = problem, None, True

    def opened(self) -> Desk:
        """Return the desk.

        Raises:
            WorkRefused: If there is none.
        """
        if self.desk is None:
            raise WorkRefused(self.problem)
        return self.desk
