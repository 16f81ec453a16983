"""A designer at work: runs the components of examples/grasshopper as Grasshopper does, with inputs as globals, outputs read back.

Run by test_grasshopper with the Python of .ws/grasshopper: ``python grasshopper_session.py PORT ACCOUNT URDF SCHEMA``.
Prints lines of JSON: what it saw, then how the view goes and comes back, and the end. It knows nothing of construction_twin.
"""

import json
import re
import runpy
import sys
import time
from pathlib import Path
from types import SimpleNamespace

FOLDER = Path(__file__).resolve().parents[3] / "examples" / "grasshopper"
sys.path.append(str(FOLDER))

import jsonschema  # noqa: E402
from compas.geometry import Frame  # noqa: E402
from compas_fab.robots import JointTrajectory, JointTrajectoryPoint  # noqa: E402
from compas_fab.robots.time_ import Duration  # noqa: E402


def component(name, **inputs):
    """Run a component; return what it left in its outputs."""
    found = runpy.run_path(str(FOLDER / f"{name}.py"), init_globals={"folder": str(FOLDER), **inputs})
    return SimpleNamespace(**{key: value for key, value in found.items() if not key.startswith("__")})


def until(run, done, seconds=20.0):
    """Run a component again and again, as Grasshopper's trigger does."""
    end = time.monotonic() + seconds
    while True:
        found = run()
        if done(found) or time.monotonic() > end:
            return found
        time.sleep(0.05)


def send(twin, trajectory):
    """Send a motion, again where it came too soon after the one before; return the answer."""
    while True:
        sent = component("send", twin=twin, trajectory=trajectory, source="", send=True).sent
        answered = until(lambda: component("answer", twin=twin, sent=sent), lambda seen: seen.ok is not None)
        soon = re.search(r"try again in ([\d.]+) s", answered.text)
        if not soon:
            return answered
        time.sleep(float(soon[1]))


def numbers(frame):
    return [*frame.point, *frame.xaxis, *frame.yaxis]


def plane(frame):
    """Return a frame as Rhino's planes are made."""
    names = {"Origin": frame.point, "XAxis": frame.xaxis, "YAxis": frame.yaxis}
    return SimpleNamespace(**{key: SimpleNamespace(X=v[0], Y=v[1], Z=v[2]) for key, v in names.items()})


def designer(port, account, urdf, schema):
    validator = jsonschema.Draft202012Validator(json.loads(Path(schema).read_text()))
    where = {"host": "localhost", "port": int(port), "account": account, "robot": "kr120", "prefix": ""}
    connected = until(lambda: component("connect", on=True, **where), lambda seen: seen.text == "connected")
    twin = connected.twin
    seen = until(lambda: component("view", twin=twin, urdf=urdf, units="mm"), lambda seen: seen.arm_frame is not None)
    said = {"connect": connected.text, "view": seen.text}
    said["schema"] = [error.message for error in validator.iter_errors(twin.view().document)]
    said["twin"] = list(seen.twin_configuration.joint_values)
    said["arm"] = list(seen.arm_configuration.joint_values)
    said["names"] = list(seen.twin_configuration.joint_names)
    said["twin_frame_mm"] = numbers(seen.twin_frame)
    said["twin_frame_m"] = numbers(component("view", twin=twin, urdf=urdf, units="m").twin_frame)
    said["units_not_said"] = component("view", twin=twin, urdf=urdf, units=None).text

    # 300 mm along y in two steps, and 200 mm down
    x, y, z = seen.twin_frame.point
    places = [(x, y + 150.0, z - 100.0), (x, y + 300.0, z - 200.0)]
    frames = [Frame(place, seen.twin_frame.xaxis, seen.twin_frame.yaxis) for place in places]
    planes = [plane(frame) for frame in frames]
    planned = component("plan", twin=twin, urdf=urdf, planes=planes, units="mm")
    said["planned"] = planned.text
    said["frames_mm"] = [numbers(frame) for frame in frames]
    said["plan_units_not_said"] = component("plan", twin=twin, urdf=urdf, planes=planes, units="").text
    said["plan_wrong_units"] = component("plan", twin=twin, urdf=urdf, planes=planes, units="m").text

    first = component("send", twin=twin, trajectory=planned.trajectory, source="Ada", send=True)
    said["sent"] = first.sent
    answered = until(lambda: component("answer", twin=twin, sent=first.sent), lambda seen: seen.ok is not None)
    said["answer"] = {"ok": answered.ok, "plan_id": answered.plan_id, "text": answered.text}
    # Grasshopper runs a component again without the button
    again = component("send", twin=twin, trajectory=planned.trajectory, source="Ada", send=False)
    said["sent_again"] = again.sent

    # with times and velocities, made by hand
    names, values = list(seen.twin_configuration.joint_names), list(seen.twin_configuration.joint_values)
    moved = [values[0] + 0.2, *values[1:]]
    points = [
        JointTrajectoryPoint(values, [0] * 6, joint_names=names),
        JointTrajectoryPoint(moved, [0] * 6, time_from_start=Duration(4, 500_000_000), joint_names=names),
    ]
    answered = send(twin, JointTrajectory(points, names))
    said["timed"] = {"ok": answered.ok, "text": answered.text}

    # too fast: 60 deg in 10 ms
    points[1] = JointTrajectoryPoint(
        [values[0] + 1.0, *values[1:]], [0] * 6, time_from_start=Duration(0, 10_000_000), joint_names=names
    )
    answered = send(twin, JointTrajectory(points, names))
    said["fast"] = {"ok": answered.ok, "text": answered.text}
    said["no trajectory"] = component("send", twin=twin, trajectory="x", source="", send=True).text
    print(json.dumps(said), flush=True)

    # the view goes and comes back: a line for each
    for fresh in (False, True):
        seen = until(
            lambda: component("view", twin=twin, urdf=urdf, units="mm"), lambda seen: seen.fresh is fresh, 60.0
        )
        print(json.dumps({"fresh": seen.fresh, "text": seen.text}), flush=True)
    print(json.dumps(component("connect", on=False, **where).text), flush=True)


if __name__ == "__main__":
    designer(*sys.argv[1:])
