"""A `BuildingModel` as a file, and back: NumPy arrays and one JSON text in an .npz; nothing in it can be executed.

The JSON is the record as it is. An array in it is ``{digest: [name, start, *shape]}``, its numbers in one of the two arrays: no
property can be named by the SHA-256 of the file that it is in. What is read back is bounded before it is unpacked and checked
against the records' types, and triangles against their corners: the process that wrote it may have been taken over by a hostile
IFC file, and a disk may be damaged.
"""

from __future__ import annotations

import dataclasses
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from construction_twin.extensions.work.building import BuildingModel, Element
from construction_twin.extensions.work.errors import BuildingError

#: Of the form below and of what the reader understands: another number, and what is in a cache is read anew.
VERSION = 8
#: Largest file [bytes].
MOST_BYTES = 1 << 30
#: Longest text about what is wrong with one [characters].
_LONGEST = 200
_KINDS = {"text": np.uint8, "numbers": np.float64, "indices": np.int32}
_MODEL: TypeAdapter[tuple[BuildingModel]] = TypeAdapter(
    tuple[BuildingModel], config=ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
)


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
        raise BuildingError(file, "what the reading process wrote", said[:_LONGEST], "a whole model") from error


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
