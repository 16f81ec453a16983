"""The file from which an executor that was killed inside an engaged segment learns so when it is started again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ExecutionError, problem_of
from construction_twin.core.files import read_file, write_whole
from construction_twin.core.sentences import Sentence
from construction_twin.execution.engagement import Engagement, from_text, to_text

#: Largest file [bytes]: a path of some minutes.
MOST = 64 * 2**20
#: For an engagement that was only expected: the executor ended before it could say more.
ENDED = "the executor ended before the plan did"


class EngagementFile:
    """One file, there as long as the arm is inside an engaged segment."""

    def __init__(self, path: Path, joint_names: Sequence[str]):
        self._path = path
        self._joint_names = tuple(joint_names)

    def read(self) -> Engagement | None:
        """Return what the file says; None without one.

        Raises:
            ConfigurationError: When it cannot be read or understood.
        """
        try:
            text = read_file(self._path, MOST).decode("utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            expected = Sentence("expected.engagement_file")
            raise ConfigurationError(str(self._path), problem_of(error), expected) from error
        return from_text(str(self._path), text, self._joint_names)

    def write(self, engagement: Engagement | None) -> None:
        """Write an engagement, or remove the file.

        Raises ExecutionError.
        """
        try:
            if engagement is None:
                self._path.unlink(missing_ok=True)
            else:
                write_whole(self._path, to_text(engagement))
        except OSError as error:
            failed = {"path": str(self._path), "problem": error.strerror or str(error)}
            raise ExecutionError(Sentence("executor.engagement_not_written", **failed)) from error
