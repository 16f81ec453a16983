"""A record of what the gateway really sent, one entry per answered telegram. rad and ns.

The file gets all its blocks at the start, and is mapped into memory: no system call in the cycle, nothing lost by a kill, and no
block missing later, which would end the process in mid motion without an exception (SIGBUS). A file that exists is replaced, not
emptied: another gateway may record in it.
"""

from __future__ import annotations

import mmap
import os
import struct
from dataclasses import dataclass
from pathlib import Path

from construction_twin.controller.telegram import stamp_step
from construction_twin.core.errors import ConfigurationError
from construction_twin.gateway.states import State

#: Begins every trace; the number is the format's.
MAGIC = b"rsitrace2\n"
_HEADER = struct.Struct("<10sH")
_STATES = tuple(State)
#: Between two entries of a session; a longer one its gateway would not have answered [ms].
_LONGEST_STEP = 1 << 30
#: Cycles that a trace holds: an hour.
_CYCLES = 900_000


def _entry(axes: int) -> struct.Struct:
    return struct.Struct(f"<QqHHB3x{axes}d")


def check_trace(path: str) -> None:
    """Raise ConfigurationError where no trace can be written."""
    file = Path(path).resolve()
    if (file.exists() and not file.is_file()) or not os.access(file.parent, os.W_OK):
        raise ConfigurationError("--trace", path, "a file, or none yet, in a folder that can be written")


@dataclass(frozen=True)
class TraceEntry:
    """One answered telegram.

    Attributes:
        stamp: Of the target played, on the sender's clock; 0 for none.
        session: Number of the controller session, from 1; modulo 65536.
        position: Shape (n,). Origin plus correction.
        lost: The reply before this one did not arrive in time: this one is a step from the one before that.
    """

    ipoc: int
    stamp: int
    state: State
    session: int
    position: tuple[float, ...]
    lost: bool = False

    def time_since(self, earlier: TraceEntry) -> int:
        """Return the controller's time since an earlier entry of the same session [ms]."""
        return stamp_step(earlier.ipoc, self.ipoc, _LONGEST_STEP)


class TraceWriter:
    """Writes a trace; `record` is what `Gateway.trace` takes. It ends after `cycles`."""

    def __init__(self, path: str, axes: int, cycles: int = _CYCLES):
        check_trace(path)
        self._entry = _entry(axes)
        self._numbers = {state: number for number, state in enumerate(_STATES, 1)}
        self._at, self._end = _HEADER.size, _HEADER.size + cycles * self._entry.size
        file = Path(path)
        try:
            file.unlink(missing_ok=True)
            self._file = file.open("x+b")
            try:
                os.posix_fallocate(self._file.fileno(), 0, self._end)
            except OSError:
                file.unlink()
                raise
        except OSError as error:
            expected = (
                f"a file on a disk with {self._end / 1e6:.1f} MB of room, reserved at the start ({error.strerror})"
            )
            raise ConfigurationError("--trace", path, expected) from error
        self._memory = mmap.mmap(self._file.fileno(), self._end)
        _HEADER.pack_into(self._memory, 0, MAGIC, axes)

    def record(
        self, ipoc: int, session: int, state: State, stamp: int, position: tuple[float, ...], lost: bool = False
    ) -> None:
        """Append an entry."""
        if self._at < self._end:
            number = self._numbers[state]
            self._entry.pack_into(self._memory, self._at, ipoc, stamp, number, session & 0xFFFF, lost, *position)
            self._at += self._entry.size

    def close(self) -> None:
        """Cut the file to what was recorded."""
        self._memory.close()
        self._file.truncate(self._at)
        self._file.close()


def read_trace(path: str | Path) -> list[TraceEntry]:
    """Read a trace, also one whose writer was killed or is still at it."""
    data = Path(path).read_bytes()
    if len(data) < _HEADER.size or not data.startswith(MAGIC):
        raise ConfigurationError(str(path), data[:16], "a file written by rsi_gateway --trace")
    entry = _entry(_HEADER.unpack_from(data)[1])
    entries = []
    for at in range(_HEADER.size, len(data) - entry.size + 1, entry.size):
        ipoc, stamp, state, session, lost, *position = entry.unpack_from(data, at)
        if not state:
            break
        entries.append(TraceEntry(ipoc, stamp, _STATES[state - 1], session, tuple(position), bool(lost)))
    return entries
