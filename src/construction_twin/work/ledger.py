"""The ledger: the log of what was done of a building model, one event per line, on the disk before anybody acts on it.

A chained file (`review.chained_file`), one per robot and name of the model. From its events `book.fold` computes the state of every
task, so that a node that was killed at any instant comes back with what is true. Its file is the only memory. When the model has
changed since, a person is asked about everything that was touched.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import LedgerError
from construction_twin.review.chained_file import ChainedFile, read_whole
from construction_twin.work.book import Book, fold
from construction_twin.work.events import CHANGED, MENDED, OPENED, Entry, entry_of
from construction_twin.work.task_memory import NotNow

#: Largest ledger that is read [bytes].
LARGEST = 256 * 2**20


class Ledger:
    """The file, and what its events say. Not for several threads at once.

    Args:
        after: See `Book`.
        model: SHA-256 of the model's file.
        clock: Returns the time since 1970 in UTC [ns].
        cell: Path of the cell file, for the record.
        elements, staying: As of `Book.doubts`.

    Attributes:
        book: What all lines so far say.

    Raises:
        LedgerError: If the file cannot be read or written, or a line of it cannot be true.
    """

    def __init__(
        self,
        path: str | Path,
        after: Mapping[str, tuple[str, ...]],
        model: str,
        clock: Callable[[], int],
        cell: str = "",
        elements: Mapping[str, str] | None = None,
        staying: Collection[str] = (),
    ):
        self.path = Path(path)
        self._clock = clock
        try:
            # read in full before every use: a ledger of this size is no ledger
            if self.path.exists() and self.path.stat().st_size > LARGEST:
                raise LedgerError(str(path), Sentence("work.ledger.size", most=LARGEST / 2**20))
            self._file = ChainedFile(self.path, LedgerError, "work node", mend=True)
        except ConfigurationError as error:
            raise LedgerError(str(path), _problem(error, str(path))) from error
        except OSError as error:
            raise LedgerError(str(path), str(error)) from error
        try:
            self.book = replay(self.path, after)
            if self._file.state.lines == 0:
                self.add(Entry(OPENED, model=model, cell=cell))
            if self._file.mended:
                self.add(Entry(MENDED, reason=f"{self._file.mended} bytes of a line without its end were cut off"))
            if self.book.model != model:
                for entry in self.book.doubts(elements or {}, staying):
                    self.add(entry)
            # last: killed before it, the next start asks again
            if (self.book.model, self.book.cell) != (model, cell):
                self.add(Entry(CHANGED, model=model, cell=cell))
        except ConstructionTwinError:
            self._file.close()
            raise

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self._file.state.lines

    @property
    def head(self) -> str:
        """SHA-256 of the last line."""
        return self._file.state.head

    def add(self, entry: Entry) -> None:
        """Write an event, then count with it; when this returns it is on the disk.

        Raises:
            NotNow: If it does not fit; nothing is written.
            LedgerError: If it cannot be written; nothing is taken.
        """
        self.book.check(entry)
        now = self._clock()
        self._file.append(now, entry.fields())
        self.book = self.book.then(replace(entry, time_ns=now))

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def _problem(error: ConfigurationError, path: str) -> str:
    """Return what is wrong without the path, which the error of a ledger names itself."""
    if error.where != path:
        return error.sentence
    found = Sentence("expected.nothing") if error.value is None else repr(error.value)
    return Sentence("expected.found", found=found, expected=error.expected)


def replay(path: Path, after: Mapping[str, tuple[str, ...]]) -> Book:
    """Return what the lines of a ledger say.

    Raises:
        LedgerError: Naming the line.
    """
    book = fold(after)
    for number, entry in enumerate(read_entries(path), start=1):
        if number == 1 and entry.event != OPENED:
            raise LedgerError(str(path), Sentence("work.ledger.first", found=repr(entry.event), opened=repr(OPENED)))
        try:
            book = book.then(entry)
        except NotNow as error:
            raise LedgerError(str(path), Sentence("expected.line", number=number, problem=error.sentence)) from error
    return book


def read_entries(path: Path) -> Iterator[Entry]:
    """Read the lines of a ledger; the chain is checked elsewhere.

    Raises:
        LedgerError: Naming the line that is none of a ledger.
    """
    try:
        content = read_whole(path)
    except ConfigurationError as error:
        raise LedgerError(str(path), Sentence("work.ledger.unread")) from error
    for number, line in enumerate(content.splitlines(), start=1):
        try:
            yield entry_of(json.loads(line))
        except (ValueError, TypeError, AttributeError) as error:
            raise LedgerError(str(path), Sentence("work.ledger.strange", number=number, problem=str(error))) from error
