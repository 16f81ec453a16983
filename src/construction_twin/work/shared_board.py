"""The board as several threads share it: not there before the model is read, nor after its ledger or its model has failed."""

from __future__ import annotations

import threading

from construction_twin.work.task_board import TaskBoard, WorkRefused


class SharedBoard:
    """A board, or why there is none.

    Args:
        problem: Why there is none yet, as a sentence.

    Attributes:
        lock: Guards board and ledger; never held while somebody else is waited for who may wait for it.
        problem: Why there is none.
        broken: There will be none any more.
    """

    def __init__(self, problem: str):
        self.lock = threading.RLock()
        self.board: TaskBoard | None = None
        self.problem = problem
        self.broken = False

    def open(self, board: TaskBoard) -> None:
        """Let everybody use a board from now on."""
        with self.lock:
            self.problem, self.board = "", board

    def fail(self, problem: str) -> None:
        """Take the board away: its record or its model cannot be used."""
        with self.lock:
            self.problem, self.board, self.broken = problem, None, True

    def opened(self) -> TaskBoard:
        """Return the board.

        Raises:
            WorkRefused: If there is none.
        """
        if self.board is None:
            raise WorkRefused(self.problem)
        return self.board
