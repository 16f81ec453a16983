"""A record of what the gateway really sent, one entry per answered telegram. rad and ns.

The file gets all its blocks at the start, and is mapped into memory: no system call in the cycle, nothing lost by a kill, and no
block missing later, which would end the process in mid motion without an exception (SIGBUS). A file that exists is replaced, not
emptied: another gateway may record in it.
"""

from __future__ import annotations

import errno
import mmap
import os
import shutil
import struct
from dataclasses import dataclass
from pathlib import Path

from construction_twin.controller.telegram import stamp_step
from construction_twin.core.errors import ConfigurationError
from construction_twin.gateway.states import State

#: Begins every trace; the number is the format's.
MAGIC = b"rsitrace1\n"
_HEADER = struct.Struct("<10sHI")
_STATES = tuple(State)
#: Between two entries of a session; a longer one its gateway would not have answered [ms].
_LONGEST_STEP = 1 << 30
#: Cycles that a trace holds by default: an hour.
DEFAULT_CYCLES = 900_000


def _entry(axes: int) -> struct.Struct:
    return struct.Struct(f"<QqHHB3x{axes}d")


def check_trace(path: str, axes: int, cycles: int = DEFAULT_CYCLES) -> Path:
    """Return the trace's path; ConfigurationError where `TraceWriter` would raise one."""
    file = Path(path).resolve()
    if file.exists() and not file.is_file():
        expected = "a regular file, or a path where none is yet; this is a device, a folder, a pipe or a socket"
        raise ConfigurationError("--trace", path, expected)
    # in /tmp nobody replaces what is another user's
    if not os.access(file.parent, os.W_OK) or (file.exists() and not os.access(file, os.W_OK)):
        problem = "no such folder" if not file.parent.is_dir() else "Permission denied"
        raise ConfigurationError("--trace", path, f"a file that can be written ({problem})")
    there, needed = file.stat().st_blocks * 512 if file.exists() else 0, _HEADER.size + cycles * _entry(axes).size
    if shutil.disk_usage(file.parent).free + there < needed:
        raise _no_room(path, needed, os.strerror(errno.ENOSPC))
    return file


def _no_room(path: str, size: int, problem: str | None) -> ConfigurationError:
    expected = f"a file on a disk with {size / 1e6:.1f} MB of room, reserved at the start ({problem})"
    return ConfigurationError("--trace", path, expected)


@dataclass(frozen=True)
class TraceEntry:
    """One answered telegram.

    Attributes:
        ipoc: [ms]
        stamp: Of the target played [ns, sender's clock]; 0 for none.
        session: Number of the controller session, from 1; counted modulo 65536.
        position: Shape (n,). Origin plus correction [rad].
        lost: The reply before this one did not arrive in time: this one is a step from what was before that.
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
    """Writes a trace; `record` is what `Gateway.trace` takes. What comes after so many cycles is counted in `dropped`."""

    def __init__(self, path: str, axes: int, cycles: int = DEFAULT_CYCLES):
        self._entry = _entry(axes)
        self._numbers = {state: number for number, state in enumerate(_STATES)}
        self._end = _HEADER.size + cycles * self._entry.size
        self._at = _HEADER.size
        self.dropped = 0
        file = check_trace(path, axes, cycles)
        try:
            file.unlink(missing_ok=True)
            self._file = file.open("x+b")
        except OSError as error:
            raise ConfigurationError("--trace", path, f"a file that can be written ({error.strerror})") from error
        try:
            os.posix_fallocate(self._file.fileno(), 0, self._end)
        except OSError as error:
            file.unlink(missing_ok=True)
            raise _no_room(path, self._end, error.strerror) from error
        self._memory = mmap.mmap(self._file.fileno(), self._end)
        _HEADER.pack_into(self._memory, 0, MAGIC, axes, self._entry.size)

    def record(
        self, ipoc: int, session: int, state: State, stamp: int, position: tuple[float, ...], lost: bool = False
    ) -> None:
        """Append an entry."""
        if self._at >= self._end:
            self.dropped += 1
            return
        self._entry.pack_into(
            self._memory, self._at, ipoc, stamp, self._numbers[state] + 1, session & 0xFFFF, lost, *position
        )
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
    _, axes, size = _HEADER.unpack_from(data)
    entry = _entry(axes)
    if size != entry.size:
        raise ConfigurationError(str(path), size, f"entries of {entry.size} bytes")
    entries = []
    for at in range(_HEADER.size, len(data) - size + 1, size):
        ipoc, stamp, state, session, lost, *position = entry.unpack_from(data, at)
        if not state:
            break
        entries.append(TraceEntry(ipoc, stamp, _STATES[state - 1], session, tuple(position), bool(lost)))
    return entries
