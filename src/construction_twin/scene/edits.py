"""The edits of a scene at run time, in a file: a scene node that restarts within the same run continues with them.

The file holds the whole scene after the last edit, for one run and one initial scene.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pydantic

from construction_twin.core.files import read_file, write_atomically
from construction_twin.core.validation import wrong_value
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.objects import Scene, SceneObject

#: Largest file [bytes]: tens of thousands of objects.
_LARGEST = 32 * 2**20


class _File(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    run: Annotated[str, pydantic.Field(min_length=1)]
    start: str
    hash: str
    padding: float
    objects: tuple[dict[str, Any], ...]


_OBJECTS = pydantic.TypeAdapter(tuple[SceneObject, ...])


@dataclass(frozen=True)
class SceneFile:
    """The file of one run's edits of the scene that it began with; that of another run is ignored."""

    path: Path
    run: str
    start: Scene

    def load(self) -> Scene:
        """Return the scene after the last edit of this run; the start if there was none."""
        try:
            contents = read_file(self.path, _LARGEST)
        except FileNotFoundError:
            return self.start
        except OSError as error:
            raise self._wrong(str(error.strerror), "a file that can be read") from error
        try:
            found = _File.model_validate_json(contents)
        except pydantic.ValidationError as error:
            wrong = wrong_value(error, _File.model_json_schema())
            expected = f"a scene as the scene node writes it: {wrong.expected}"
            raise self._wrong(f"{wrong.key}: {wrong.value!r:.200}", expected) from error
        if found.run != self.run:
            return self.start
        if found.start != self.start.hash:
            expected = f"edits of {self.start.hash[:12]}, the one given now"
            raise self._wrong(f"edits of a scene that began as {found.start[:12]}", expected)
        try:
            scene = Scene(_OBJECTS.validate_python(found.objects), found.padding)
        except (SceneError, pydantic.ValidationError) as error:
            raise self._wrong(str(error), "objects that can be used") from error
        if scene.hash != found.hash:
            raise self._wrong(f"contents with the hash {scene.hash[:12]}", f"{found.hash[:12]}, which it names")
        return scene

    def save(self, scene: Scene) -> None:
        """Write the scene, as a whole or not at all."""
        contents = {"run": self.run, "start": self.start.hash, "hash": scene.hash, "padding": scene.padding}
        contents["objects"] = _OBJECTS.dump_python(scene.objects, mode="json")
        try:
            write_atomically(self.path, json.dumps(contents, indent=1) + "\n")
        except OSError as error:
            expected = "a file that can be written: an edit that would not survive a restart is refused"
            raise SceneError(str(self.path), error.strerror, expected) from error

    def _wrong(self, found: str, expected: str) -> SceneError:
        to_do = f"{expected}; look at the scene, move the file away and start again: the scene then begins as given"
        return SceneError(f"the scene's edits in {self.path}", found, to_do)
