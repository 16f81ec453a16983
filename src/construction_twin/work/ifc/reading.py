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

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.core.sentences import Sentence, understood
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import BuildingModel
from construction_twin.work.ifc.model_file import VERSION, load
from construction_twin.work.ifc.step_text import check_form

#: Takes what is being done (`open`, `geometry`, `elements`), how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]

#: Folder that holds this package, for the process that reads.
_SOURCES = str(Path(__file__).resolve().parents[3])
#: Longest line that a reading process may send [bytes].
_LINE = 65536


@dataclass(frozen=True)
class Bounds:
    """What the reading of one file may take.

    Attributes:
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
        raise ConfigurationError(str(kept.parent), error.strerror or str(error), Sentence("ifc.cache")) from error
    return model


def _digest(path: Path, bounds: Bounds) -> str:
    try:
        contents = read_file(path, bounds.file_bytes)
    except OSError as error:
        raise BuildingError(
            path.name, Sentence("ifc.file"), error.strerror or str(error), Sentence("ifc.readable")
        ) from error
    check_form(contents, path.name)
    return hashlib.sha256(contents).hexdigest()


def _read(path: Path, digest: str, output: Path, bounds: Bounds, progress: Progress) -> BuildingModel:
    if importlib.util.find_spec("ifcopenshell") is None:
        raise ConfigurationError("ifcopenshell", None, Sentence("expected.extras.installed", group="work"))
    _run(path, digest, output, bounds, progress)
    try:
        return load(output, path.name, digest)
    except OSError as error:
        raise BuildingError(path.name, Sentence("ifc.written"), str(error), Sentence("ifc.whole_model")) from error


def _run(path: Path, digest: str, output: Path, bounds: Bounds, progress: Progress) -> None:
    """Let another process read, and return when it has written the model."""
    late = threading.Event()
    error: list[str] | None = None
    where: str = Sentence("ifc.found.before")
    with _start(path, digest, output, bounds) as process:

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(bounds.wall, stop)
        timer.start()
        try:
            assert process.stdout is not None
            while line := process.stdout.readline(_LINE):
                if (message := _message(line)) is None:
                    error = None
                    process.kill()
                    break
                if message[0] == "error":
                    error = message[1:]
                    continue
                what, done, whole = message[1], int(message[2]), int(message[3])
                where = Sentence("ifc.found.after", done=done, whole=whole, step=repr(what))
                progress(what, done, whole)
            code = process.wait()
        finally:
            timer.cancel()
            process.kill()
    if error is not None:
        # texts cross the pipe; what they say is found in them again
        raise BuildingError(path.name, *(understood(text) or text for text in error))
    if code != 0 or late.is_set() or not output.exists():
        found = Sentence("building.ended", how=_how_it_ended(code, late.is_set(), bounds), where=where)
        raise BuildingError(path.name, Sentence("ifc.process"), found, Sentence("ifc.within_bounds"))


def _message(line: bytes) -> list[str] | None:
    """Return what a line of the reading process says: ``error`` or ``progress`` and three texts; None: it is no message."""
    try:
        ((kind, values),) = json.loads(line).items()
        first, second, third = map(str, values)
        if kind == "progress":
            return [kind, first[:40], str(int(second)), str(int(third))]
        return [kind, first[:500], second[:500], third[:500]] if kind == "error" else None
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None


def _how_it_ended(code: int, late: bool, bounds: Bounds) -> str:
    if late:
        return Sentence("ifc.found.wall", seconds=bounds.wall)
    if code == -signal.SIGXCPU:
        return Sentence("ifc.found.cpu", seconds=bounds.cpu)
    if code < 0:
        return Sentence("ifc.found.signal", number=-code, name=signal.Signals(-code).name)
    return Sentence("ifc.found.code", code=code)


def _start(path: Path, digest: str, output: Path, bounds: Bounds) -> subprocess.Popen[bytes]:
    given = (path.absolute(), digest, output.absolute(), bounds.file_bytes, bounds.memory_bytes, int(bounds.cpu))
    paths = [_SOURCES, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", f"{__package__}.child", *map(str, given)],
        # one thread: more would be counted as memory each
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
