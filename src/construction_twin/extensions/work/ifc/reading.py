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
from dataclasses import dataclass
from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.extensions.work.building import BuildingModel
from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.model_file import VERSION, load
from construction_twin.extensions.work.ifc.step_text import check_form

#: Folder that holds this package, for the process that reads.
_SOURCES = str(Path(__file__).resolve().parents[3])
#: Most that is read of what a reading process says is wrong [bytes].
_LONGEST = 4096


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


def read_building(path: str | Path, cache: str | Path | None = None, bounds: Bounds = Bounds()) -> BuildingModel:
    """Read an IFC file.

    Args:
        cache: Folder in which what was read is kept, by the file's SHA-256; made if it is not there. None: it is read every time.

    Raises:
        BuildingError: One sentence: what is wrong with the file, or which bound its reading went over.
        ConfigurationError: If ifcopenshell is not installed, or the cache cannot be written.
    """
    path = Path(path)
    try:
        contents = read_file(path, bounds.file_bytes)
    except OSError as error:
        found = error.strerror or str(error)
        raise BuildingError(path.name, "the file", found, "an IFC file that can be read") from error
    check_form(contents, path.name)
    digest = hashlib.sha256(contents).hexdigest()
    # it can be large
    del contents
    if cache is None:
        with tempfile.TemporaryDirectory() as folder:
            return _read(path, digest, Path(folder) / "model.npz", bounds)
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
            model = _read(path, digest, written, bounds)
            os.replace(written, kept)
    except OSError as error:
        raise ConfigurationError(str(kept.parent), error.strerror or str(error), "a folder for the cache") from error
    return model


def _read(path: Path, digest: str, output: Path, bounds: Bounds) -> BuildingModel:
    if importlib.util.find_spec("ifcopenshell") is None:
        raise ConfigurationError("ifcopenshell", None, "that it is installed; run setup/setup.sh work")
    _run(path, digest, output, bounds)
    try:
        return load(output, path.name, digest)
    except OSError as error:
        raise BuildingError(path.name, "what the reading process wrote", str(error), "a whole model") from error


def _run(path: Path, digest: str, output: Path, bounds: Bounds) -> None:
    """Let another process read, and return when it has written the model."""
    given = (path.absolute(), digest, output.absolute(), bounds.file_bytes, bounds.memory_bytes, int(bounds.cpu))
    paths = [_SOURCES, *filter(None, [os.environ.get("PYTHONPATH")])]
    code: int | None = None
    try:
        code = subprocess.run(
            [sys.executable, "-m", f"{__package__}.child", *map(str, given)],
            # one thread: more would be counted as memory each
            env=os.environ
            | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=bounds.wall,
            check=False,
        ).returncode
    except subprocess.TimeoutExpired:
        pass  # no code
    error = _error(Path(f"{output}.error"))
    if error is not None:
        raise BuildingError(path.name, *error)
    if code != 0 or not output.exists():
        what, expected = "the process that read the file", "a file that can be read within its bounds"
        raise BuildingError(path.name, what, _how_it_ended(code, bounds), expected)


def _error(path: Path) -> tuple[str, str, str] | None:
    """Return what the reading process says is wrong: what, found, expected; None: nothing that can be read."""
    try:
        with path.open("rb") as file:
            what, found, expected = (str(value)[:500] for value in json.loads(file.read(_LONGEST)))
        return what, found, expected
    except (OSError, ValueError, TypeError, RecursionError):
        return None


def _how_it_ended(code: int | None, bounds: Bounds) -> str:
    if code is None:
        return f"more than {bounds.wall:g} s"
    if code == -signal.SIGXCPU:
        return f"more than {bounds.cpu:g} s of processor time"
    if code < 0:
        return f"an end by signal {-code} ({signal.Signals(-code).name})"
    return f"an end with code {code} and no result"
