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

from construction_twin.core.sentences import Sentence, understood
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import BuildingModel, Element

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
            model.file,
            Sentence("ifc.model"),
            Sentence("ifc.found.mib", size=size / 2**20),
            Sentence("ifc.at_most_mib", most=MOST_BYTES >> 21),
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
    except (
        zipfile.BadZipFile,
        ValueError,
        TypeError,
        LookupError,
        EOFError,
        NotImplementedError,
        RecursionError,
    ) as error:
        raise BuildingError(file, Sentence("ifc.written"), _said(error), Sentence("ifc.whole_model")) from error


def _said(error: Exception) -> str:
    """Return what an exception says, short: one of ours its sentence, with its key."""
    own = next(iter(error.args), None)
    if isinstance(own, Sentence) and len(own) <= _LONGEST:
        return own
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:_LONGEST]


def _load(path: Path, file: str, digest: str) -> BuildingModel:
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > MOST_BYTES:
            raise ValueError(Sentence("ifc.found.stored_size", most=MOST_BYTES >> 20))
    with np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in _KINDS}
    for name, kind in _KINDS.items():
        if arrays[name].dtype != kind or arrays[name].ndim != 1:
            raise ValueError(
                Sentence(
                    "ifc.found.array", name=repr(name), kind=str(arrays[name].dtype), shape=str(arrays[name].shape)
                )
            )
    if not np.isfinite(arrays["numbers"]).all():
        raise ValueError(Sentence("ifc.found.not_finite"))

    def undescribed(item: dict[str, Any]) -> Any:
        if item.keys() != {digest}:
            return item
        name, start, *shape = item[digest]
        stop = start + math.prod(shape)
        if not 0 <= start <= stop <= len(arrays[name]):
            raise ValueError(Sentence("ifc.found.short_array", name=repr(name)))
        return arrays[name][start:stop].reshape(shape)

    document = json.loads(arrays["text"].tobytes(), object_hook=undescribed)
    if document["version"] != VERSION or document["model"]["digest"] != digest:
        raise ValueError(Sentence("ifc.found.other_version"))
    (model,) = _MODEL.validate_python(({**document["model"], "file": file},))
    for element in model.elements.values():
        _check(element)
    return dataclasses.replace(
        model,
        elements={
            name: dataclasses.replace(element, doubt=_with_key(element.doubt)) if element.doubt else element
            for name, element in model.elements.items()
        },
        notes=tuple(map(_with_key, model.notes)),
        remarks={name: tuple(map(_with_key, remarks)) for name, remarks in model.remarks.items()},
    )


def _with_key(text: str) -> str:
    """Return a note with its key and values, which its text alone has crossed the file."""
    return understood(text) or text


def _check(element: Element) -> None:
    """Check the shapes of an element's arrays, and that its triangles have the corners that they name."""
    pose = element.model_T_element
    wanted: list[tuple[np.ndarray, tuple[int, ...]]] = [(pose.position, (3,)), (pose.rotation, (3, 3))]
    for body in element.bodies:
        wanted += [(body.vertices, (-1, 3)), (body.triangles, (-1, 3))]
    for array, shape in wanted:
        if array.ndim != len(shape) or any(size not in (-1, have) for size, have in zip(shape, array.shape)):
            raise ValueError(
                Sentence("ifc.found.shape", shape=str(array.shape), id=repr(element.id), expected=str(shape))
            )
    for body in element.bodies:
        if body.triangles.dtype.kind != "i" or body.vertices.dtype.kind != "f":
            raise ValueError(Sentence("ifc.found.no_indices"))
        if body.triangles.size and not 0 <= body.triangles.min() <= body.triangles.max() < len(body.vertices):
            raise ValueError(Sentence("ifc.found.no_corners"))
