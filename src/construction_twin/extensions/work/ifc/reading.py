"""Reading IFC files, for everybody: in a process of its own, within bounds, and from a cache when the file is known.

That process is this module as a program, `python -m ...ifc.reading FILE SHA256 OUTPUT BYTES MEMORY CPU`: its limits are its own and
hold before ifcopenshell is imported. It writes the model into OUTPUT and ends with 0; where it cannot, `[what, found, expected]` as
JSON into OUTPUT.error. None of that is believed without a check: the process may have been taken over by a hostile file.

A model as a file is NumPy arrays and one JSON text in an .npz, nothing of which can be executed. An array in the JSON is
``{digest: [name, start, *shape]}``, its numbers in one of the two arrays: no property can be named by the SHA-256 of its own file.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.extensions.work.building import BuildingModel, Element
from construction_twin.extensions.work.errors import BuildingError

#: Of the form of its file and of what the reader understands: another number, and what is in a cache is read anew.
VERSION = 9
#: Largest file [bytes].
MOST_BYTES = 1 << 30
#: Longest text about what is wrong with one [characters].
_LONGEST_TEXT = 200
_KINDS = {"text": np.uint8, "numbers": np.float64, "indices": np.int32}
_MODEL: TypeAdapter[tuple[BuildingModel]] = TypeAdapter(
    tuple[BuildingModel], config=ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
)
_MAGIC = b"ISO-10303-21;"
_END = b"END-ISO-10303-21;"
_MARK = b"\xef\xbb\xbf"
_SPACE = b" \t\r\n\0\x1a"
#: This module as a program, and the folder that holds the package.
_PROGRAM = "construction_twin.extensions.work.ifc.reading"
_SOURCES = str(Path(__file__).resolve().parents[4])
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
            [sys.executable, "-m", _PROGRAM, *map(str, given)],
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


# -- the bytes of a file


def check_form(contents: bytes, name: str) -> None:
    """Check that contents are a STEP file from its beginning to its end."""
    begun = _from_start(contents)
    if not begun.startswith(_MAGIC):
        found = f"{contents[:20]!r} at its beginning" if contents else "nothing in it"
        raise BuildingError(name, "the file", found, f"an IFC file, which begins with {_MAGIC.decode()}")
    if not contents.rstrip(_SPACE).endswith(_END):
        found = f"no {_END.decode()} at its end: it is not whole"
        raise BuildingError(name, "the file", found, "a whole IFC file")


def _from_start(contents: bytes) -> bytes:
    """Return contents without what may stand before the first line: a byte order mark, comments."""
    begun = contents.removeprefix(_MARK).lstrip()
    while begun.startswith(b"/*"):
        begun = begun.partition(b"*/")[2].lstrip()
    return begun


# -- a model as a file


def save(model: BuildingModel, path: Path) -> None:
    """Write a model."""
    arrays: dict[str, list[np.ndarray]] = {"numbers": [np.empty(0)], "indices": [np.empty(0, np.int32)]}
    places = dict.fromkeys(arrays, 0)

    def described(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            name = "indices" if value.dtype.kind == "i" else "numbers"
            arrays[name].append(value.ravel())
            places[name] += value.size
            return {model.digest: [name, places[name] - value.size, *value.shape]}
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return dict(value)

    text = json.dumps({"version": VERSION, "model": model}, default=described, allow_nan=False).encode()
    size = len(text) + 8 * places["numbers"] + 4 * places["indices"]
    if size > MOST_BYTES // 2:
        raise BuildingError(
            model.file, "the model", f"{size / 2**20:.0f} MiB as arrays", f"at most {MOST_BYTES >> 21} MiB"
        )
    joined = {name: np.concatenate(parts).astype(_KINDS[name]) for name, parts in arrays.items()}
    with path.open("wb") as file:
        np.savez(file, text=np.frombuffer(text, np.uint8), **joined)  # type: ignore[arg-type]


def load(path: Path, file: str, digest: str) -> BuildingModel:
    """Read a model.

    Raises:
        BuildingError: If it is not what `save` writes.
        OSError: If it cannot be read.
    """
    try:
        return _load(path, file, digest)
    except _UNREADABLE as error:
        said = " ".join(str(error).split())
        said = said if isinstance(error, _NotWhole) else f"{type(error).__name__}: {said}"
        raise BuildingError(file, "what the reading process wrote", said[:_LONGEST_TEXT], "a whole model") from error


class _NotWhole(ValueError):
    """What the reading process wrote is no whole model; says why."""


#: What NumPy, zipfile, json and pydantic raise for a damaged file.
_UNREADABLE = (zipfile.BadZipFile, ValueError, TypeError, LookupError, EOFError, NotImplementedError, RecursionError)


def _load(path: Path, file: str, digest: str) -> BuildingModel:
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > MOST_BYTES:
            raise _NotWhole(f"more than {MOST_BYTES >> 20} MiB")
    with np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in _KINDS}
    for name, kind in _KINDS.items():
        if arrays[name].dtype != kind or arrays[name].ndim != 1:
            raise _NotWhole(f"array {name!r} of {arrays[name].dtype} and shape {arrays[name].shape}")
    if not np.isfinite(arrays["numbers"]).all():
        raise _NotWhole("values that are no finite numbers")

    def undescribed(item: dict[str, Any]) -> Any:
        if item.keys() != {digest}:
            return item
        name, start, *shape = item[digest]
        stop = start + math.prod(shape)
        if not 0 <= start <= stop <= len(arrays[name]):
            raise _NotWhole(f"array {name!r} shorter than its elements")
        return arrays[name][start:stop].reshape(shape)

    document = json.loads(arrays["text"].tobytes(), object_hook=undescribed)
    if document["version"] != VERSION or document["model"]["digest"] != digest:
        raise _NotWhole("another version, or of another file")
    (model,) = _MODEL.validate_python(({**document["model"], "file": file},))
    for element in model.elements.values():
        _check(element)
    return model


def _check(element: Element) -> None:
    """Check the shapes of an element's arrays, and that its triangles have the corners that they name."""
    pose = element.model_T_element
    wanted: list[tuple[np.ndarray, tuple[int, ...]]] = [(pose.position, (3,)), (pose.rotation, (3, 3))]
    for body in element.bodies:
        wanted += [(body.vertices, (-1, 3)), (body.triangles, (-1, 3))]
    for array, shape in wanted:
        if array.ndim != len(shape) or any(size not in (-1, have) for size, have in zip(shape, array.shape)):
            raise _NotWhole(f"an array of shape {array.shape} instead of {shape} in element {element.id!r}")
    for body in element.bodies:
        if body.triangles.dtype.kind != "i" or body.vertices.dtype.kind != "f":
            raise _NotWhole("triangles that are no indices, or corners that are no numbers")
        if body.triangles.size and not 0 <= body.triangles.min() <= body.triangles.max() < len(body.vertices):
            raise _NotWhole("triangles with corners that are not there")


# -- the process that reads


def main(arguments: list[str]) -> int:
    """Read a file and write what is in it.

    Args:
        arguments: File, its SHA-256, output, and the bounds: its largest size [bytes], memory [bytes], processor time [s].

    Returns:
        The exit code.
    """
    path, digest, output = arguments[:3]
    most_bytes, memory, cpu = map(int, arguments[3:])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # after the limits: what is imported is C++ of several hundred MB
    from construction_twin.extensions.work.ifc.reader import read_ifc

    def say(*values: str) -> int:
        Path(f"{output}.error").write_text(json.dumps(values))
        return 1

    try:
        model = read_ifc(path, most_bytes)
        if model.digest != digest:
            return say("the file", "other contents when it was read again", "a file that nobody writes")
        save(model, Path(output))
    except BuildingError as error:
        return say(error.what, error.found, error.expected)
    except MemoryError:
        return say("the file", f"more than {memory >> 20} MiB of memory needed", "a smaller model")
    except OSError as error:
        return say("the result", error.strerror or str(error), "room on the disk for it")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
