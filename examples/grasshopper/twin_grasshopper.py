"""What the Grasshopper components of this folder share: the connection, trajectories, answers, views, units.

For Rhino 8's Python 3 (3.9 and newer) with compas_eve and compas_fab; runs without Rhino too, and without construction_twin.
A JointTrajectory and a Configuration are in rad and m, always: that is COMPAS's definition. Frames are in the unit of the Rhino
document, which every function that takes or gives one must be told: "mm" or "m".

Nothing here moves the arm: a trajectory becomes a plan that a person at the arm must approve.
"""

from __future__ import annotations

import json
import math
import threading
import time
import uuid
from pathlib import Path

import numpy as np
from compas.geometry import Frame
from compas_eve import Message, Publisher, Subscriber, Topic
from compas_eve.mqtt import MqttTransport
from compas_fab.robots import JointTrajectory, JointTrajectoryPoint
from compas_robots import Configuration

#: The version of `view` that is read here; a later one says in `compatible` whether its readers can read it too.
VIEW_VERSION = 8
#: A view that is older is not shown as the present [s].
FRESH = 1.0
#: An answer comes in a few seconds, or not at all [s].
PATIENCE = 10.0
#: Metres in a unit of the document.
UNITS = {"mm": 0.001, "m": 1.0}
_TYPES = {"revolute": 0, "prismatic": 2}
#: Connections by their arguments: Grasshopper runs a component again with every change on the canvas.
_CONNECTIONS: dict[tuple, Connection] = {}


class TwinProblem(Exception):
    """One sentence for the designer."""


# -- connection


class AccountTransport(MqttTransport):
    """As compas_eve's transport, with a user name and a password, which compas_eve 2.4 does not know."""

    def __init__(self, host: str, port: int, user: str, password: str, **options):
        self._login = user, password
        super().__init__(host, port, **options)

    @property
    def client(self):
        """The paho client; it is told the password when the transport makes it, which is before it connects."""
        return self._paho

    @client.setter
    def client(self, client):
        client.username_pw_set(*self._login)
        self._paho = client


def make_transport(host: str, port: int, account: str = "") -> MqttTransport:
    """Connect to the broker.

    Args:
        host, port: Of the broker.
        account: `account.json` of a folder that make_site made; empty: a broker without accounts, on one machine.
    """
    try:
        if not account:
            return MqttTransport(host, port)
        path = Path(account)
        content = json.loads(path.read_text(encoding="utf-8"))
        file = {key: str(path.parent / value) for key, value in content.items() if key.endswith("_file")}
        tls = {"ca_certs": file["ca_file"]}
        password = Path(file["password_file"]).read_text(encoding="utf-8").splitlines()[0]
        return AccountTransport(host, port, content["user"], password, tls_options=tls)
    except (OSError, ValueError, KeyError) as error:
        raise TwinProblem(
            f"no connection to {host}:{port} with {account or 'no account'}: {error!r}; is the broker there, the file whole?"
        ) from error


class Connection:
    """One robot at one broker: sends trajectories, keeps the answers and the newest view.

    Args:
        transport: See `make_transport`.
        robot, prefix: The first two levels of the topics are ``<prefix>/<robot>``.
        account: Name of the account, as the broker knows it; empty: none.
        clock: Returns seconds that only rise.
    """

    def __init__(
        self, transport: MqttTransport, robot: str, prefix: str = "twin", account: str = "", clock=time.monotonic
    ):
        self._transport, self._clock = transport, clock
        base = f"{prefix}/{robot}"
        self._publisher = Publisher(
            Topic(f"{base}/trajectory/from/{account}" if account else f"{base}/trajectory"), transport
        )
        self._lock = threading.Lock()
        self._sent: dict[str, float] = {}
        self._answers: dict[str, dict] = {}
        self._view: tuple[dict, float] | None = None
        #: Id of what was sent last; empty: nothing yet.
        self.last_sent = ""
        self._names = [f"{base}/trajectory/ack", f"{base}/view"]
        for name, take in zip(self._names, (self._on_answer, self._on_view)):
            Subscriber(Topic(name), take, transport).subscribe()
        # compas_eve subscribes once; a broker that was started again has forgotten it
        transport.on("ready", self._subscribe_again)

    def _subscribe_again(self) -> None:
        for name in self._names:
            self._transport.client.subscribe(name)

    def close(self) -> None:
        """Hang up."""
        self._transport.client.disconnect()
        self._transport.close()

    @property
    def is_connected(self) -> bool:
        """Whether the broker has let us in."""
        return self._transport.client.is_connected()

    def _on_answer(self, message: Message) -> None:
        with self._lock:
            self._answers[message["id"]] = dict(message.data)

    def _on_view(self, message: Message) -> None:
        with self._lock:
            self._view = dict(message.data), self._clock()

    def send(self, trajectory: JointTrajectory, source: str = "") -> str:
        """Send a trajectory for review; return the id with which to ask for its answer.

        It goes with QoS 0, as all that compas_eve publishes: only the answer proves that it arrived.
        """
        document = trajectory_document(trajectory)
        if not self.is_connected:
            raise TwinProblem("not connected: the broker is not there, or does not know this account")
        name = uuid.uuid4().hex
        with self._lock:
            self._sent[name] = self._clock()
        self._publisher.publish(Message(id=name, source=source[:64], **document))
        self.last_sent = name
        return name

    def answer(self, name: str) -> dict | None:
        """Return the answer to what was sent: ``ok``, ``reason``, ``plan_id`` and more; None while there is none."""
        with self._lock:
            return self._answers.get(name)

    def answer_text(self, name: str) -> str:
        """Return in one sentence what became of what was sent."""
        answer = self.answer(name)
        if answer is not None:
            notes = "".join(f"; {note}" for note in answer["notes"])
            return f"{'under review' if answer['ok'] else 'refused'}: {answer['reason']}{notes}"
        with self._lock:
            sent = self._sent.get(name)
        if sent is None:
            return "nothing was sent with this id"
        waited = self._clock() - sent
        if waited < PATIENCE:
            return f"sent {waited:.0f} s ago, no answer yet"
        return (
            f"no answer for {waited:.0f} s: it did not arrive, because this account may not send it, it is too long for the "
            "broker, or console_node does not run; send it again"
        )

    def view(self) -> View:
        """Return the newest view; TwinProblem where there is none that can be shown as the present."""
        with self._lock:
            view = self._view
        if view is None:
            raise TwinProblem("no view yet: is the robot's name right, and does its bringup run?")
        document, received = view
        version = document.get("version", 0)
        if not document.get("compatible", version) <= VIEW_VERSION <= version:
            raise TwinProblem(f"view has version {document.get('version')!r}; this file reads {VIEW_VERSION}")
        if not document["online"]:
            raise TwinProblem(
                "console_node has ended, or lost its connection to the broker: nothing is known of the robot"
            )
        age = self._clock() - received
        if age > FRESH:
            raise TwinProblem(
                f"the last view came {age:.1f} s ago: the connection is lost, or console_node does not run"
            )
        return View(document)


def connection(host: str, port: int, robot: str, prefix: str = "twin", account: str = "") -> Connection:
    """Return the connection with these arguments, made at the first call."""
    key = host, port, robot, prefix, account
    found = _CONNECTIONS.get(key)
    if found is None:
        # make_site names a folder after its account
        name = Path(account).resolve().parent.name if account else ""
        found = _CONNECTIONS[key] = Connection(make_transport(host, port, account), robot, prefix, name)
    return found


def disconnect(host: str, port: int, robot: str, prefix: str = "twin", account: str = "") -> None:
    """Hang up, so that the next `connection` makes a new one."""
    found = _CONNECTIONS.pop((host, port, robot, prefix, account), None)
    if found is not None:
        found.close()


# -- view


class View:
    """A message on `view`; its schema is what scripts/schemas.py prints."""

    def __init__(self, document: dict):
        self.document = document

    def configuration(self, part: str) -> Configuration:
        """Return the pose of the ``twin`` or the ``arm`` [rad], [m]; TwinProblem when it is not known."""
        pose = self.document[part]
        if pose is None:
            raise TwinProblem(f"the pose of the {part} is not known")
        joints = self.document["joints"]
        return Configuration(pose["positions"], [_TYPES[kind] for kind in joints["types"]], joints["names"])

    @property
    def text(self) -> str:
        """What a person wants to know, one line for each of link, gate and execution."""
        lines = []
        for part in ("link", "sync", "execution"):
            said = self.document[part]
            lines.append(f"{part}: not known" if said is None else f"{part}: {said['state']}, {said['reason']}")
        execution = self.document["execution"]
        if execution is not None and execution["plan_id"]:
            lines.append(f"plan {execution['plan_id']}: {execution['progress']:.0%}")
        return "\n".join(lines)


# -- frames and units


def factor(unit: str) -> float:
    """Return metres per unit of the document; TwinProblem unless it is said."""
    if unit not in UNITS:
        raise TwinProblem(f"the unit is {unit!r}; say that of the Rhino document, mm or m: it is never guessed")
    return UNITS[unit]


def as_frame(plane) -> Frame:
    """Return a Rhino plane, or a COMPAS frame, as a COMPAS frame, in the same unit."""
    if isinstance(plane, Frame):
        return plane
    vectors = [[vector.X, vector.Y, vector.Z] for vector in (plane.Origin, plane.XAxis, plane.YAxis)]
    return Frame(*vectors)


def scaled(frame: Frame, scale: float) -> Frame:
    """Return a frame with its point in another unit."""
    return Frame([value * scale for value in frame.point], frame.xaxis, frame.yaxis)


def tool_frame(model, configuration: Configuration, unit: str, tool: str = "tool0") -> Frame:
    """Return where a configuration has the tool, in the robot's base and in the document's unit.

    Args:
        model: A compas_robots.RobotModel of the robot's URDF.
        configuration: With the names of its joints.
        unit: "mm" or "m".
        tool: A link of the model.
    """
    return scaled(model.forward_kinematics(configuration, tool), 1.0 / factor(unit))


# -- trajectories


def trajectory_through(configurations: list[Configuration]) -> JointTrajectory:
    """Return a trajectory through configurations, without times: it is timed on the robot's side, inside its limits."""
    if len(configurations) < 2:
        raise TwinProblem(f"{len(configurations)} configurations; a motion needs two, the first where the twin is")
    points = [
        JointTrajectoryPoint(list(each.joint_values), list(each.joint_types), joint_names=list(each.joint_names))
        for each in configurations
    ]
    return JointTrajectory(points, list(configurations[0].joint_names), fraction=1.0)


def trajectory_document(trajectory: JointTrajectory) -> dict:
    """Return a trajectory as `trajectory` has it on MQTT; compas_fab writes zeros for velocities that are not given."""
    if not isinstance(trajectory, JointTrajectory):
        raise TwinProblem(f"a {type(trajectory).__name__} is no JointTrajectory of compas_fab")
    if trajectory.fraction not in (None, 1.0):
        raise TwinProblem(f"fraction is {trajectory.fraction:g}: only a part of the path was planned; plan it again")
    points = []
    for point in trajectory.points:
        time_from_start = point.time_from_start.secs + point.time_from_start.nsecs * 1e-9
        points.append({"positions": list(point.joint_values), "time_from_start": time_from_start})
    for key in ("velocities", "accelerations"):
        rows = [list(getattr(point, key)) for point in trajectory.points]
        if any(map(any, rows)):
            for point, row in zip(points, rows):
                point[key] = row
    names = trajectory.joint_names or (trajectory.points[0].joint_names if trajectory.points else [])
    return {"units": {"angle": "rad", "length": "m", "time": "s"}, "joint_names": list(names), "points": points}


def trajectory_to_frames(
    model, start: Configuration, frames: list[Frame], unit: str, tool: str = "tool0"
) -> JointTrajectory:
    """Return a trajectory on which the tool passes frames: each is reached from the one before by the nearest configuration.

    Between two frames every joint goes its shortest way, so the tool's path is no line: give more frames where that matters. There
    is no collision check here; the robot's side has one. A compas_fab planner with a backend does better.

    Args:
        model, tool: As for `tool_frame`.
        start: Where the twin is now: `View.configuration("twin")`.
        frames: In the robot's base, in the document's unit.
        unit: "mm" or "m".
    """
    scale = factor(unit)
    configurations = [start]
    for index, frame in enumerate(frames):
        found = _solve(model, configurations[-1], scaled(frame, scale), tool)
        if found is None:
            raise TwinProblem(
                f"frame {index} cannot be reached from the one before; is it in {unit}, and in the robot's base?"
            )
        configurations.append(found)
    return trajectory_through(configurations)


def _solve(model, start: Configuration, target: Frame, tool: str) -> Configuration | None:
    """Return the configuration at a frame [m] that damped least squares lead to from `start`; None if they lead nowhere."""
    found = start.copy()
    for _ in range(100):
        error = _difference(model, found, target, tool)
        if np.linalg.norm(error[:3]) < 1e-7 and np.linalg.norm(error[3:]) < 1e-7:
            return found
        jacobian = _jacobian(model, found, tool)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), error)
        # no more than 0.2 rad or m at once, so that it stays near
        step *= min(1.0, 0.2 / max(1e-12, float(np.abs(step).max())))
        found.joint_values = [value + float(change) for value, change in zip(found.joint_values, step)]
    return None


def _jacobian(model, configuration: Configuration, tool: str) -> np.ndarray:
    """Return how the tool's frame changes with each joint, by small steps."""
    here, columns = model.forward_kinematics(configuration, tool), []
    for index in range(len(configuration.joint_values)):
        moved = configuration.copy()
        moved.joint_values[index] += 1e-6
        columns.append(_between(here, model.forward_kinematics(moved, tool)) / 1e-6)
    return np.array(columns).T


def _difference(model, configuration: Configuration, target: Frame, tool: str) -> np.ndarray:
    return _between(model.forward_kinematics(configuration, tool), target)


def _between(here: Frame, there: Frame) -> np.ndarray:
    """Return what leads from one frame to another: a vector [m] and a rotation vector [rad]."""
    turned = _axes(there) @ _axes(here).T
    sine = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2.0
    length, cosine = float(np.linalg.norm(sine)), (np.trace(turned) - 1.0) / 2.0
    # near half a turn the axis is not told by this; the steps lead away from there
    rotation = sine * (math.atan2(length, cosine) / length if length > 1e-12 else 1.0)
    return np.concatenate((np.array(list(there.point)) - np.array(list(here.point)), rotation))


def _axes(frame: Frame) -> np.ndarray:
    return np.array([list(frame.xaxis), list(frame.yaxis), list(frame.zaxis)]).T
