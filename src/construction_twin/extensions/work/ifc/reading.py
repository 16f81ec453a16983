"""Reading IFC files, for everybody: in a process of its own, within bounds, and from a cache when the file is known.

That process is this module as a program, `python -m ...ifc.reading FILE SHA256 OUTPUT BYTES MEMORY CPU`: its limits are its own and
hold before ifcopenshell is imported. It writes the model into OUTPUT and ends with 0; where it cannot, `[what, found, expected]` as
JSON into OUTPUT.error. None of that is believed without a check: the process may have been taken over by a hostile file.

A model as a file is one JSON text, nothing of which can be executed. An array in it is ``{digest: [kind, base64, *shape]}``: no
property can be named by the SHA-256 of its own file.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import importlib.util
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.extensions.work.building import BuildingError, BuildingModel

#: Of the form of a cached file and of what the reader understands.
VERSION = 12
#: Largest file [bytes].
MOST_BYTES = 1 << 30
#: Longest text about what is wrong with one [characters].
_LONGEST_TEXT = 200
_KINDS = {"f": np.float64, "i": np.int32}
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
    """What the reading of one file may take: `memory_bytes` of address space, of which the libraries take 1 GiB, and seconds."""

    file_bytes: int = 512 << 20
    memory_bytes: int = 6 << 30
    cpu: float = 600.0
    wall: float = 1800.0


def read_building(path: str | Path, cache: str | Path | None = None, bounds: Bounds = Bounds()) -> BuildingModel:
    """Read an IFC file; raise BuildingError if it cannot be read within its bounds. `cache`: folder, by the file's SHA-256."""
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
    cached = None if cache is None else Path(cache) / f"{digest}-{VERSION}.json"
    if cached is not None and cached.exists():
        try:
            return load(cached, path.name, digest)
        except (BuildingError, OSError):
            # damaged: made anew below, over it
            pass
    if importlib.util.find_spec("ifcopenshell") is None:
        raise ConfigurationError("ifcopenshell", None, "that it is installed; run setup/setup.sh work")
    try:
        if cached is not None:
            cached.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cached and cached.parent) as folder:
            written = Path(folder) / "model.json"
            _run(path, digest, written, bounds)
            model = load(written, path.name, digest)
            if cached is not None:
                os.replace(written, cached)
    except OSError as error:
        where = str(cached.parent if cached is not None else tempfile.gettempdir())
        raise ConfigurationError(where, error.strerror or str(error), "a folder for the cache") from error
    return model


def _run(path: Path, digest: str, output: Path, bounds: Bounds) -> None:
    arguments = (path.absolute(), digest, output.absolute(), bounds.file_bytes, bounds.memory_bytes, int(bounds.cpu))
    paths = [_SOURCES, *filter(None, [os.environ.get("PYTHONPATH")])]
    code: int | None = None
    try:
        code = subprocess.run(
            [sys.executable, "-m", _PROGRAM, *map(str, arguments)],
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
    try:
        with Path(f"{output}.error").open("rb") as file:
            what, found, expected = (str(value)[:500] for value in json.loads(file.read(_LONGEST)))
    except (OSError, ValueError, TypeError, RecursionError):
        pass  # it says nothing that can be read
    else:
        raise BuildingError(path.name, what, found, expected)
    if code != 0 or not output.exists():
        what, expected = "the process that read the file", "a file that can be read within its bounds"
        raise BuildingError(path.name, what, _how_it_ended(code, bounds), expected)


def _how_it_ended(code: int | None, bounds: Bounds) -> str:
    if code is None:
        return f"more than {bounds.wall:g} s"
    if code == -signal.SIGXCPU:
        return f"more than {bounds.cpu:g} s of processor time"
    if code < 0:
        return f"an end by signal {-code} ({signal.Signals(-code).name})"
    return f"an end with code {code} and no result"


def check_form(contents: bytes, name: str) -> None:
    """Check that contents are a STEP file from its beginning to its end."""
    begun = contents.removeprefix(_MARK).lstrip()
    while begun.startswith(b"/*"):
        begun = begun.partition(b"*/")[2].lstrip()
    if not begun.startswith(_MAGIC):
        found = f"{contents[:20]!r} at its beginning" if contents else "nothing in it"
        raise BuildingError(name, "the file", found, f"an IFC file, which begins with {_MAGIC.decode()}")
    if not contents.rstrip(_SPACE).endswith(_END):
        found = f"no {_END.decode()} at its end: it is not whole"
        raise BuildingError(name, "the file", found, "a whole IFC file")


def save(model: BuildingModel, path: Path) -> None:
    """Write a model."""

    def described(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            kind = "i" if value.dtype.kind == "i" else "f"
            numbers = base64.b64encode(value.astype(_KINDS[kind]).tobytes()).decode()
            return {model.digest: [kind, numbers, *value.shape]}
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return dict(value)

    text = json.dumps({"version": VERSION, "model": model}, default=described, allow_nan=False)
    if len(text) > MOST_BYTES:
        found, most = f"{len(text) >> 20} MiB of text", f"at most {MOST_BYTES >> 20} MiB"
        raise BuildingError(model.file, "the model", found, most)
    path.write_text(text, encoding="ascii")


def load(path: Path, file: str, digest: str) -> BuildingModel:
    """Read a model; raise BuildingError if it is not what `save` writes."""

    def undescribed(item: dict[str, Any]) -> Any:
        if item.keys() != {digest}:
            return item
        kind, numbers, *shape = item[digest]
        array = np.frombuffer(base64.b64decode(numbers), _KINDS[kind]).reshape(shape)
        if not np.isfinite(array).all():
            raise ValueError("values that are no finite numbers")
        return array

    contents = read_file(path, MOST_BYTES)
    try:
        document = json.loads(contents, object_hook=undescribed)
        if document["version"] != VERSION or document["model"]["digest"] != digest:
            raise ValueError("another version, or of another file")
        (model,) = _MODEL.validate_python(({**document["model"], "file": file},))
        for body in (body for element in model.elements.values() for body in element.bodies):
            for array, kind in ((body.vertices, "f"), (body.triangles, "i")):
                if array.dtype.kind != kind or array.ndim != 2 or array.shape[1] != 3:
                    raise ValueError(f"an array of {array.dtype} and shape {array.shape} in a body")
            if body.triangles.size and not 0 <= body.triangles.min() <= body.triangles.max() < len(body.vertices):
                raise ValueError("triangles with corners that are not there")
        named = {task.parent for task in model.tasks.values()} | {""}
        named |= {one for each in model.sequences for one in (each.before, each.after)}
        if not named <= {"", *model.tasks}:
            raise ValueError("an order or a nesting of what is no task")
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())[:_LONGEST_TEXT]
        raise BuildingError(file, "what the reading process wrote", said, "a whole model") from error
    return model


def main(arguments: list[str]) -> int:
    """Read a file and write its model; return the exit code."""
    path, digest, output = arguments[:3]
    most_bytes, memory, cpu = map(int, arguments[3:])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # after the limits: what is imported is C++ of several hundred MB
    from construction_twin.extensions.work.ifc.reader import read_ifc

    def write_error(*values: str) -> int:
        Path(f"{output}.error").write_text(json.dumps(values))
        return 1

    try:
        model = read_ifc(path, most_bytes)
        if model.digest != digest:
            return write_error("the file", "other contents when it was read again", "a file that nobody writes")
        save(model, Path(output))
    except BuildingError as error:
        return write_error(error.what, error.found, error.expected)
    except MemoryError:
        return write_error("the file", f"more than {memory >> 20} MiB of memory needed", "a smaller model")
    except OSError as error:
        return write_error("the result", error.strerror or str(error), "room on the disk for it")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
