"""The ledger: the log of what was done of a building model, one event per line, on the disk before anybody acts on it.

An append-only file (`core.append_only`), one per robot and site. From its events `book.fold` computes the state of every task, so
that a node that was killed at any instant comes back with what is true. Its file is the only memory, with the bodies beside it that
its lines name by digest. When the model has changed since, a person is asked about everything that was touched.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from construction_twin.core.append_only import AppendOnlyFile, read_lines
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.files import write_whole
from construction_twin.core.work_errors import LedgerError
from construction_twin.scene.objects import SceneObject
from construction_twin.work.book import Book, Present, fold
from construction_twin.work.task_memory import CHANGED, MENDED, OPENED, Entry, NotNow, entry_of

#: Largest ledger that is read [bytes].
LARGEST = 256 * 2**20


class Ledger:
    """The file, and what its events say. Not for several threads at once.

    Args:
        clock: Returns the time since 1970 in UTC [ns].
        robot: Its name, in whose frame the poses are.

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
        placing: Mapping[str, str] = MappingProxyType({}),
        standing: Collection[str] = (),
        robot: str = "",
        present: Mapping[str, Present] = MappingProxyType({}),
    ):
        self.path = Path(path)
        self._bodies = self.path.parent / "standing"
        self._clock = clock
        try:
            # read in full before every use: a ledger of this size is no ledger
            if self.path.exists() and self.path.stat().st_size > LARGEST:
                raise LedgerError(str(path), f"larger than {LARGEST / 2**20:g} MiB; move it away")
            self._file = AppendOnlyFile(self.path, LedgerError, "work node")
        except ConfigurationError as error:
            raise LedgerError(str(path), _problem(error, str(path))) from error
        except OSError as error:
            raise LedgerError(str(path), str(error)) from error
        try:
            self.book = replay(self.path, after)
            if self._file.lines == 0:
                self.add(Entry(OPENED, model=model, cell=cell, robot=robot))
            if self._file.mended:
                self.add(Entry(MENDED, reason=f"{self._file.mended} bytes of a line without its end were cut off"))
            for entry in self.book.handed_over(present):
                self.add(entry)
            for entry in self.book.doubts(model, placing, standing, present):
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
        return self._file.lines

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

    # -- bodies

    def keep(self, bodies: Sequence[SceneObject]) -> str:
        """Keep an element's pieces, whatever becomes of model and cache; return their digest. They are on the disk then."""
        try:
            for item in bodies:
                if item.mesh:
                    self._write(_mesh_name(item), Path(item.mesh).read_bytes())
            text = _contents(bodies)
            digest = hashlib.sha256(text).hexdigest()
            self._write(f"{digest}.json", text)
        except OSError as error:
            raise LedgerError(str(self._bodies), str(error)) from error
        return digest

    def _write(self, name: str, contents: bytes) -> None:
        path = self._bodies / name
        if path.exists() and path.read_bytes() == contents:
            return
        write_whole(path, contents)
        for each in (path, self._bodies, self._bodies.parent):
            handle = os.open(each, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)

    def body(self, element: str, digest: str) -> tuple[SceneObject, ...]:
        """Return the pieces of an element that were kept, called ``<element>/0``, ..., in its frame."""
        path = self._bodies / f"{digest}.json"
        try:
            content = path.read_bytes()
            if hashlib.sha256(content).hexdigest() != digest:
                raise ValueError("it is not what it was when it was written; restore the folder")
            pieces = tuple(
                SceneObject(
                    f"{element}/{number}", **{**kept, "mesh": kept["mesh"] and str(self._bodies / kept["mesh"])}
                )
                for number, kept in enumerate(json.loads(content))
            )
            if any(item.mesh and item.mesh_digest != Path(item.mesh).stem for item in pieces):
                raise ValueError("it is not what it was when it was written; restore the folder")
        except (OSError, ValueError, ConstructionTwinError) as error:
            raise LedgerError(str(path), str(error)) from error
        return pieces


#: What is kept of each piece, besides its mesh.
_OF_BODY = ("shape", "size", "position", "quaternion", "padding")


def body_digest(bodies: Sequence[SceneObject]) -> str:
    """Return the digest by which an element's pieces are kept."""
    return hashlib.sha256(_contents(bodies)).hexdigest()


def _contents(bodies: Sequence[SceneObject]) -> bytes:
    each = [{**{key: getattr(item, key) for key in _OF_BODY}, "mesh": _mesh_name(item)} for item in bodies]
    return json.dumps(each).encode()


def _mesh_name(item: SceneObject) -> str:
    return f"{item.mesh_digest}{Path(item.mesh).suffix}" if item.mesh else ""


def _problem(error: ConfigurationError, path: str) -> str:
    """Return what is wrong without the path, which the error of a ledger names itself."""
    if error.where != path:
        return str(error)
    return f"found {'nothing' if error.value is None else repr(error.value)}, expected {error.expected}"


def replay(path: Path, after: Mapping[str, tuple[str, ...]]) -> Book:
    """Return what the lines of a ledger say."""
    book = fold(after)
    for number, entry in enumerate(read_entries(path), start=1):
        if number == 1 and entry.event != OPENED:
            raise LedgerError(str(path), f"line 1 is {entry.event!r}; expected {OPENED!r}: this is no ledger")
        try:
            book = book.then(entry)
        except NotNow as error:
            raise LedgerError(str(path), f"line {number}: {str(error)}") from error
    return book


def read_entries(path: Path) -> Iterator[Entry]:
    """Read the lines of a ledger."""
    try:
        lines = read_lines(path)
    except ConfigurationError as error:
        raise LedgerError(str(path), _problem(error, str(path))) from error
    for number, fields in enumerate(lines, start=1):
        try:
            yield entry_of(fields)
        except (ValueError, TypeError, AttributeError) as error:
            raise LedgerError(str(path), f"line {number} is none of a ledger: {error}") from error
