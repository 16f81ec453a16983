"""A failure as a file, and the same again without ROS: `python3 -m construction_twin.replay FILE` says what happens now.

One JSON object, small enough to send, written by `twin save-failure`. Keys of every kind: `kind`, `sentence` (how it ended),
`versions`, `state` (of the running system, by topic).

| kind | more keys | what is done again |
|---|---|---|
| ``plan`` | `robot`, `settings` (the planner's), `scene`, `request` | the request, from its own start, in its scene |
| ``hold`` | `robot`, `settings` (the gate's), `decimals`, `twin`, `physical` | a gate that is in sync sees both poses |
| ``model`` | `name`, `contents` (base64 of zlib) | the model is read: ``.ifc``, or a URDF |

`robot`: `urdf`, `description` (the robot YAML), `self_collision`. Exit code 0: it ends in the same sentence; 1: it ends otherwise;
2: the file cannot be replayed, after one sentence on standard error.
"""

from __future__ import annotations

import argparse
import base64
import json
import platform
import sys
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, command_message
from construction_twin.core.extensions import import_extension
from construction_twin.core.files import read_file
from construction_twin.core.freshness import Moment
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import NANOSECONDS
from construction_twin.kinematics.chain import Pose
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncState
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.planning.pipeline import FailedRequest, PlanningPipeline
from construction_twin.planning.planner import PlannerSettings, PlanRequest
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.waypoints import Unit, Waypoints
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import RobotModel, load_robot
from construction_twin.robot.executed_path import ExecutedPath
from construction_twin.robot.new_robot import robot_of_urdf
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import Scene, SceneObject, read_mesh_file
from construction_twin.scene.scene_change import SceneChange
from construction_twin.scene.self_collision import read_self_collision

#: Largest file [bytes], and largest model in one.
MOST_BYTES, MOST_MODEL = 64 << 20, 16 << 20
#: What a plan that is made now is called.
PLANNED = "a plan was made"
#: What poses do that close no gate.
AGREED = "the poses agree within the thresholds"
#: What a request may be made of.
_RECORDS = {
    each.__name__: each
    for each in (
        Pose, PlanRequest, Moment, ToolWaypoint, Unit, Waypoints, Trajectory, WorkSegment, Signal, Switch, SceneChange,
        ExecutedPath, SceneObject, Scene,
    )
}  # fmt: skip
_PACKAGES = ("construction_twin", "numpy", "scipy", "ompl", "coal", "toppra", "py-opw-kinematics")
_CYCLE = NANOSECONDS // 250


# -- writing


def failure(kind: str, sentence: str, state: Mapping[str, Any], **more: Any) -> str:
    """Return a failure as JSON, meshes of its scene included; `more`: the keys of its kind."""
    document = {"kind": kind, "sentence": sentence, "versions": versions(), "state": dict(state), **_with_meshes(more)}
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a plan depends on."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue  # the package itself, run from a checkout
    return found


def model_failure(path: Path) -> str:
    """Return the failure of a model that is refused; ConfigurationError where it is not."""
    contents = read_file(path, MOST_MODEL)
    sentence = _read_model(path.name, contents)
    if not sentence:
        raise ConfigurationError(str(path), "a model that can be read", "one that is refused")
    return failure("model", sentence, {}, name=path.name, contents=base64.b64encode(zlib.compress(contents)).decode())


def request_json(failed: FailedRequest) -> dict[str, Any]:
    """Return a request for a plan, with its scene, as JSON; meshes by the paths of their files."""
    request = {"method": failed.method, "arguments": _encoded(failed.arguments)}
    return {"request": request, "scene": _encoded(failed.scene)}


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"array": value.tolist()}
    if is_dataclass(value) or hasattr(value, "_fields"):
        names = [each.name for each in fields(value) if each.init] if is_dataclass(value) else value._fields
        return {"record": type(value).__name__, **{name: _encoded(getattr(value, name)) for name in names}}
    if isinstance(value, Mapping):
        return {"mapping": {key: _encoded(item) for key, item in value.items()}}
    return [_encoded(item) for item in value] if isinstance(value, (list, tuple)) else value


def _with_meshes(value: Any) -> Any:
    """Return JSON in which each object of a scene has the contents of its mesh; SceneError where the file is gone."""
    if isinstance(value, list):
        return [_with_meshes(item) for item in value]
    if not isinstance(value, dict):
        return value
    held = {key: _with_meshes(item) for key, item in value.items()}
    if held.get("record") == "SceneObject" and held["mesh"]:
        held["mesh_contents"] = base64.b64encode(read_mesh_file(held["name"], held["mesh"])).decode()
    return held


# -- reading


def _decoded(value: Any, folder: Path) -> Any:
    if isinstance(value, list):
        return tuple(_decoded(item, folder) for item in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return np.array(value["array"], dtype=float)
    if "mapping" in value:
        return {key: _decoded(item, folder) for key, item in value["mapping"].items()}
    kind = _RECORDS.get(value.get("record", ""))
    if kind is None:
        raise ConfigurationError("record", value.get("record"), f"one of {', '.join(_RECORDS)}")
    held = {key: _decoded(item, folder) for key, item in value.items() if key not in ("record", "mesh_contents")}
    if "mesh_contents" in value:
        mesh = folder / f"{len(list(folder.iterdir()))}_{Path(held['mesh']).name}"
        mesh.write_bytes(base64.b64decode(value["mesh_contents"]))
        held["mesh"] = str(mesh)
    return kind(**held)


def replay(document: Mapping[str, Any]) -> str:
    """Return how a failure ends now, in one sentence; also raises LookupError, TypeError, ValueError for what is no failure."""
    kinds = {"plan": _replayed_plan, "hold": _replayed_hold, "model": _replayed_model}
    if document["kind"] not in kinds:
        raise ConfigurationError("kind", document["kind"], f"one of {', '.join(kinds)}")
    return kinds[document["kind"]](document)


def _robot(described: Mapping[str, Any]) -> RobotModel:
    return load_robot(described["urdf"], described["description"])


def _replayed_plan(document: Mapping[str, Any]) -> str:
    robot = _robot(document["robot"])
    with tempfile.TemporaryDirectory(prefix="replay_") as name:
        folder = Path(name)
        pairs = folder / "self_collision.yaml"
        pairs.write_text(document["robot"]["self_collision"], encoding="utf-8")
        settings = PlannerSettings.read(document["settings"], "settings")
        pipeline = PlanningPipeline(robot, None, settings, read_self_collision(str(pairs), robot))
        request = document["request"]
        if request["method"] not in PlanningPipeline.METHODS:
            raise ConfigurationError("method", request["method"], f"one of {', '.join(PlanningPipeline.METHODS)}")
        pipeline.set_scene(_decoded(document["scene"], folder))
        try:
            getattr(pipeline, request["method"])(**_decoded(request["arguments"], folder))
        except ConstructionTwinError as error:
            return str(error)
    return PLANNED


def _replayed_hold(document: Mapping[str, Any]) -> str:
    robot = _robot(document["robot"])
    settings = GateSettings.read(document["settings"], "settings")
    gate = Gate(MotionLimits.of(robot), JointStringCodec.of(robot, document["decimals"]), settings)
    twin, physical = tuple(document["twin"]), tuple(document["physical"])
    opens = round(settings.agree_time * 250) + 10
    for cycle in range(1, opens + 250):
        now = cycle * _CYCLE
        gate.pass_next(now, twin, now)
        gate.on_twin(now, twin)
        in_sync = cycle > opens and gate.state is SyncState.IN_SYNC
        gate.on_physical(physical if in_sync or gate.cause else twin, now, now)
        if cycle > opens and gate.state is not SyncState.IN_SYNC:
            return gate.reason
    return AGREED


def _replayed_model(document: Mapping[str, Any]) -> str:
    contents = zlib.decompressobj().decompress(base64.b64decode(document["contents"]), MOST_MODEL)
    return _read_model(document["name"], contents) or "the model is read"


def _read_model(name: str, contents: bytes) -> str:
    """Return why a model is refused; "": it is read."""
    with tempfile.TemporaryDirectory(prefix="replay_") as folder:
        path = Path(folder) / Path(name).name
        path.write_bytes(contents)
        try:
            if path.suffix.lower() == ".ifc":
                import_extension("work.ifc.reading").read_building(path)
            else:
                robot_of_urdf(path)
        except ConstructionTwinError as error:
            return str(error).replace(f"{folder}/", "")
    return ""


def main(arguments: list[str] | None = None) -> int:
    """Replay the file named on the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python3 -m construction_twin.replay", description="Do again what failed, without ROS: what happens now?"
    )
    parser.add_argument("file", type=Path, help="JSON, as `twin save-failure` writes it")
    path = parser.parse_args(arguments).file
    try:
        document = json.loads(read_file(path, MOST_BYTES))
        now, then = replay(document), document["sentence"]
    except (ConstructionTwinError, OSError) as error:
        problem = command_message(error)
    except (LookupError, TypeError, ValueError, zlib.error) as error:
        problem = f"no JSON of twin save-failure ({error!r})"
    else:
        print(f"then: {then}\nnow:  {now}")
        return 0 if now == then else 1
    print(f"replay: {path} cannot be replayed: {problem}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
