"""Reading IFC files, for everybody: in a process of its own, within bounds, and from a cache when the file is known.

Needs no ifcopenshell itself, so that whoever imports this can say what is missing.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import BuildingModel
from construction_twin.work.ifc.model_file import VERSION, load

#: Takes what is being done (`open`, `geometry`, `elements`), how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]

_MAGIC = b"ISO-10303-21;"
_END = b"END-ISO-10303-21;"
#: Folder that holds this package, for the process that reads.
_SOURCES = str(Path(__file__).resolve().parents[3])
#: Longest line that a reading process may send [bytes].
_LINE = 65536


@dataclass(frozen=True)
class Bounds:
    """What the reading of one file may take.

    Attributes:
        file_bytes: Largest file.
        memory_bytes: Address space of the process, of which the libraries take about 1 GiB.
        cpu: Processor time [s].
        wall: Time until it is ended [s]; more than `cpu`, for a machine that does something else as well.
    """

    file_bytes: int = 512 << 20
    memory_bytes: int = 6 << 30
    cpu: float = 600.0
    wall: float = 1800.0


def read_building(
    path: str | Path,
    cache: str | Path | None = None,
    bounds: Bounds | None = None,
    progress: Progress = lambda *_: None,
) -> BuildingModel:
    """Read an IFC file.

    Args:
        cache: Folder in which what was read is kept, by the file's SHA-256; made if it is not there. None: it is read every time.
        progress: For a progress bar; not called when the model comes from the cache.

    Raises:
        BuildingError: One sentence: what is wrong with the file, or which bound its reading went over.
        ConfigurationError: If ifcopenshell is not installed, or the cache cannot be written.
    """
    path, bounds = Path(path), bounds or Bounds()
    digest = _digest(path, bounds)
    if cache is None:
        with tempfile.TemporaryDirectory() as folder:
            return _read(path, digest, Path(folder) / "model.npz", bounds, progress)
    kept = Path(cache) / f"{digest}-{VERSION}.npz"
    if kept.exists():
        try:
            return load(kept, path.name, digest)
        except (BuildingError, OSError):
            # damaged: made anew below, over it
            pass
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
            written = Path(folder) / "model.npz"
            model = _read(path, digest, written, bounds, progress)
            os.replace(written, kept)
    except OSError as error:
        raise ConfigurationError(str(kept.parent), error.strerror or str(error), "a folder for the cache") from error
    return model


def _digest(path: Path, bounds: Bounds) -> str:
    try:
        contents = read_file(path, bounds.file_bytes)
    except OSError as error:
        raise BuildingError(
            path.name, "the file", error.strerror or str(error), "an IFC file that can be read"
        ) from error
    if not contents.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(_MAGIC):
        found = f"{contents[:20]!r} at its beginning" if contents else "nothing in it"
        raise BuildingError(path.name, "the file", found, f"an IFC file, which begins with {_MAGIC.decode()}")
    # ifcopenshell reads what is there and does not miss the rest
    if _END not in contents[-65536:]:
        found = f"no {_END.decode()} at its end: it is not whole"
        raise BuildingError(path.name, "the file", found, "a whole IFC file")
    return hashlib.sha256(contents).hexdigest()


def _read(path: Path, digest: str, output: Path, bounds: Bounds, progress: Progress) -> BuildingModel:
    if importlib.util.find_spec("ifcopenshell") is None:
        raise ConfigurationError("ifcopenshell", None, "that it is installed; run setup/setup.sh work")
    last = _run(path, output, bounds, progress)
    if last["ok"] != digest:
        raise BuildingError(path.name, "the file", "other contents when it was read again", "a file that nobody writes")
    try:
        return load(output, path.name, digest)
    except OSError as error:
        raise BuildingError(path.name, "what the reading process wrote", str(error), "a whole model") from error


def _run(path: Path, output: Path, bounds: Bounds, progress: Progress) -> dict[str, Any]:
    """Let another process read, and return its last message."""
    reader, writer = os.pipe()
    late = threading.Event()
    with os.fdopen(reader, "rb") as pipe:
        try:
            process = _start(path, output, bounds, writer)
        finally:
            os.close(writer)

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(bounds.wall, stop)
        timer.start()
        heard = _Heard()
        try:
            if not heard.listen(pipe, progress):
                process.kill()
            code = process.wait()
        finally:
            timer.cancel()
            process.kill()
            process.wait()
    if heard.error is not None:
        raise BuildingError(path.name, *heard.error)
    if code != 0 or heard.last is None or late.is_set():
        found = f"{_how_it_ended(code, late.is_set(), bounds)}{heard.where}"
        raise BuildingError(
            path.name, "the process that read the file", found, "a file that can be read within its bounds"
        )
    return heard.last


class _Heard:
    """What the reading process said.

    Attributes:
        last: Its message of success.
        error: What, found, expected.
    """

    def __init__(self) -> None:
        self.last: dict[str, Any] | None = None
        self.error: tuple[str, str, str] | None = None
        self._progress: tuple[str, int, int] | None = None

    @property
    def where(self) -> str:
        """How far it came, for a sentence."""
        if self._progress is None:
            return " before it began"
        what, done, whole = self._progress
        return f" after {done} of {whole} in step {what!r}"

    def listen(self, pipe: BinaryIO, progress: Progress) -> bool:
        """Listen until it ends, and return True; or until it says what is no message, and return False."""
        while line := pipe.readline(_LINE):
            try:
                self._take(json.loads(line), progress)
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                self.last = self.error = None
                return False
        return True

    def _take(self, message: dict[str, Any], progress: Progress) -> None:
        if "progress" in message:
            what, done, whole = message["progress"]
            self._progress = (str(what)[:40], int(done), int(whole))
            progress(*self._progress)
        elif "error" in message:
            what, found, expected = (str(each)[:500] for each in message["error"])
            self.error = (what, found, expected)
        else:
            self.last = {"ok": str(message["ok"])}


def _how_it_ended(code: int, late: bool, bounds: Bounds) -> str:
    if late:
        return f"more than {bounds.wall:g} s"
    if code == -signal.SIGXCPU:
        return f"more than {bounds.cpu:g} s of processor time"
    if code < 0:
        return f"an end by signal {-code} ({signal.Signals(-code).name})"
    return f"an end with code {code} and no result"


def _start(path: Path, output: Path, bounds: Bounds, pipe: int) -> subprocess.Popen:
    numbers = (bounds.file_bytes, bounds.memory_bytes, int(bounds.cpu), pipe)
    paths = [_SOURCES, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            f"{__package__}.child",
            str(path.absolute()),
            str(output.absolute()),
            *map(str, numbers),
        ],
        # one thread: more would be counted as memory each
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        pass_fds=(pipe,),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
