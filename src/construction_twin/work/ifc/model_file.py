"""A `BuildingModel` as a file, and back: NumPy arrays and one JSON text in an .npz; nothing in it can be executed.

Reading trusts nothing: the file may come from a process that a hostile IFC file took over, or from a damaged disk. Its size is
bounded before anything is unpacked, and every index and number is checked.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from construction_twin.core.work_errors import BuildingError
from construction_twin.kinematics.chain import Pose
from construction_twin.work.building import Body, BuildingModel, Element, Extrusion, Sequence, Task

#: Of the form below and of what the reader understands: another number, and what is in a cache is read anew.
VERSION = 3
#: Largest file [bytes].
MOST_BYTES = 1 << 30
_ARRAYS = {
    "text": (np.uint8, 1),
    "poses": (np.float64, 12),
    "vertices": (np.float64, 3),
    "triangles": (np.int32, 3),
    "extrusions": (np.float64, 16),
    "corners": (np.float64, 2),
}
_TEXTS = ("id", "ifc_class", "name", "type_name", "tag", "storey", "material", "assembly", "status", "doubt")


def save(model: BuildingModel, path: Path) -> None:
    """Write a model.

    Raises:
        BuildingError: If it is larger than what would be read again.
        OSError: If it cannot be written.
    """
    elements: list[dict[str, Any]] = []
    vertices, triangles, extrusions, corners = [], [], [], []
    for element in model.elements.values():
        bodies = []
        for body in element.bodies:
            vertices.append(body.vertices)
            triangles.append(body.triangles)
            loops = None
            if (given := body.extrusion) is not None:
                pose = given.element_T_profile
                extrusions.append([*pose.position, *pose.rotation.ravel(), *given.direction, given.depth])
                corners += [given.outline, *given.holes]
                loops = [len(given.outline), *map(len, given.holes)]
            bodies.append([len(body.vertices), len(body.triangles), loops])
        texts = {name: getattr(element, name) for name in _TEXTS}
        elements.append(texts | {"properties": element.properties, "mass": element.mass, "bodies": bodies})
    document = {
        "version": VERSION,
        "digest": model.digest,
        "schema": model.schema,
        "project": model.project,
        "unit": model.unit,
        "elements": elements,
        "tasks": [asdict(task) for task in model.tasks.values()],
        "sequences": [asdict(sequence) for sequence in model.sequences],
        "notes": model.notes,
        "remarks": model.remarks,
    }
    poses = [[*e.model_T_element.position, *e.model_T_element.rotation.ravel()] for e in model.elements.values()]
    text = np.frombuffer(json.dumps(document, allow_nan=False).encode(), dtype=np.uint8)
    arrays: dict[str, np.ndarray] = {
        "text": text,
        "poses": np.array(poses, dtype=np.float64).reshape(-1, 12),
        "vertices": _joined(vertices, np.float64, 3),
        "triangles": _joined(triangles, np.int32, 3),
        "extrusions": np.array(extrusions, dtype=np.float64).reshape(-1, 16),
        "corners": _joined(corners, np.float64, 2),
    }
    size = sum(array.nbytes for array in arrays.values())
    if size > MOST_BYTES // 2:
        raise BuildingError(
            model.file, "the model", f"{size / 2**20:.0f} MiB as arrays", f"at most {MOST_BYTES >> 21} MiB"
        )
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _joined(arrays: list[np.ndarray], kind: type, width: int) -> np.ndarray:
    return np.concatenate([np.zeros((0, width), kind), *arrays]).astype(kind)


def load(path: Path, file: str, digest: str) -> BuildingModel:
    """Read a model.

    Args:
        file: Name of the IFC file.
        digest: SHA-256 of the IFC file that it must be of.

    Raises:
        BuildingError: If it is not what `save` writes.
        OSError: If it cannot be read.
    """
    arrays = _arrays(path, file)
    try:
        document = json.loads(arrays["text"].tobytes())
        if document["version"] != VERSION or document["digest"] != digest:
            _refuse(file, "another version, or of another file")
        return _Decoder(file, arrays).model(document)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise _refused(file, f"{type(error).__name__}: {error}"[:200]) from error


def _refused(file: str, found: str) -> BuildingError:
    return BuildingError(file, "what the reading process wrote", found, "a whole model")


def _refuse(file: str, found: str) -> NoReturn:
    raise _refused(file, found)


def _arrays(path: Path, file: str) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > MOST_BYTES:
                _refuse(file, f"more than {MOST_BYTES >> 20} MiB")
            if sorted(member.filename for member in members) != sorted(f"{name}.npy" for name in _ARRAYS):
                _refuse(file, "other arrays")
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in _ARRAYS}
    except (zipfile.BadZipFile, zipfile.LargeZipFile, ValueError, EOFError, KeyError, NotImplementedError) as error:
        raise _refused(file, f"{type(error).__name__}: {error}"[:200]) from error
    for name, (kind, width) in _ARRAYS.items():
        array = arrays[name]
        if array.dtype != kind or array.ndim != (1 if width == 1 else 2) or (width > 1 and array.shape[1] != width):
            _refuse(file, f"array {name!r} of {array.dtype} and shape {array.shape}")
        if array.dtype == np.float64 and not np.isfinite(array).all():
            _refuse(file, f"array {name!r} with values that are no finite numbers")
    return arrays


class _Decoder:
    """Takes the arrays apart, in the order in which they were written."""

    def __init__(self, file: str, arrays: dict[str, np.ndarray]):
        self._file, self._arrays = file, arrays
        self._next = dict.fromkeys(arrays, 0)

    def model(self, document: dict[str, Any]) -> BuildingModel:
        """Return the model; the exceptions of a wrong document are the caller's."""
        elements = {}
        for fields in document["elements"]:
            element = self._element(fields)
            if element.id in elements:
                _refuse(self._file, "an element twice")
            elements[element.id] = element
        for name in ("poses", "vertices", "triangles", "extrusions", "corners"):
            if self._next[name] != len(self._arrays[name]):
                _refuse(self._file, f"array {name!r} longer than its elements")
        tasks = {fields["id"]: _task(fields) for fields in document["tasks"]}
        sequences = tuple(
            Sequence(_text(each["before"]), _text(each["after"]), _text(each["kind"]), float(each["lag"]))
            for each in document["sequences"]
        )
        if any(end not in tasks for each in sequences for end in (each.before, each.after)):
            _refuse(self._file, "an order of tasks that are not there")
        return BuildingModel(
            self._file,
            _text(document["digest"]),
            _text(document["schema"]),
            _text(document["project"]),
            float(document["unit"]),
            elements,
            tasks,
            sequences,
            tuple(map(_text, document["notes"])),
            {_text(name): tuple(map(_text, remarks)) for name, remarks in document["remarks"].items()},
        )

    def _take(self, name: str, count: int) -> np.ndarray:
        start = self._next[name]
        if type(count) is not int or count < 0 or start + count > len(self._arrays[name]):
            _refuse(self._file, f"array {name!r} shorter than its elements")
        self._next[name] = start + count
        return self._arrays[name][start : start + count]

    def _element(self, fields: dict[str, Any]) -> Element:
        pose = self._take("poses", 1)[0]
        mass = fields["mass"]
        return Element(
            **{name: _text(fields[name]) for name in _TEXTS},
            model_T_element=_pose(pose),
            bodies=tuple(self._body(*each) for each in fields["bodies"]),
            properties={_text(name): _values(values) for name, values in fields["properties"].items()},
            mass=None if mass is None else float(mass),
        )

    def _body(self, vertices: int, triangles: int, loops: list[int] | None) -> Body:
        corners, faces = self._take("vertices", vertices), self._take("triangles", triangles)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(corners)):
            _refuse(self._file, "triangles with corners that are not there")
        return Body(corners, faces, None if loops is None else self._extrusion(loops))

    def _extrusion(self, loops: list[int]) -> Extrusion:
        values = self._take("extrusions", 1)[0]
        outline, *holes = (self._take("corners", count) for count in loops)
        return Extrusion(outline, tuple(holes), _pose(values[:12]), values[12:15], float(values[15]))


def _pose(values: np.ndarray) -> Pose:
    return Pose(values[:3], values[3:12].reshape(3, 3))


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


def _values(values: dict[str, Any]) -> dict[str, Any]:
    if any(not isinstance(value, (str, int, float, bool, type(None))) for value in values.values()):
        raise TypeError("a property that is no single value")
    return values


def _task(fields: dict[str, Any]) -> Task:
    lists = {name: tuple(map(_text, fields[name])) for name in ("products", "inputs", "robots")}
    texts = {name: _text(fields[name]) for name in ("id", "name", "description", "parent", "start", "finish", "kind")}
    duration = None if fields["duration"] is None else float(fields["duration"])
    marks = {name: bool(fields[name]) for name in ("milestone", "completed")}
    return Task(**texts, **lists, **marks, duration=duration)  # type: ignore[arg-type]
