"""`preflight`: whether a start can work, before anything starts: one sentence, or nothing.

Called by bringup.launch, while roslaunch reads it, as ``preflight --for-roslaunch name:=value ...``, and by view.launch for the
names of the arguments alone; by hand without the option. It looks at the arguments, at what is in the files they name, at the nodes
that run on the master, and at the ports. It changes nothing.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import socket
import sys
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

import rosgraph
import rospkg

from construction_twin.broker.start import DEFAULT_PORT, listener_ports, trial
from construction_twin.console.given_files import broker_tls, check_rights, own_tls
from construction_twin.controller.makes import DEFAULT, MODULES, make_of
from construction_twin.controller.port import Make
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.extras import check_extras
from construction_twin.core.files import check_writable
from construction_twin.core.network import port_is_free, reaches_itself
from construction_twin.core.sentences import Sentence
from construction_twin.gateway.trace import room as trace_room
from construction_twin.mqtt.account import load_account
from construction_twin.physics.drive import read_drives
from construction_twin.physics.gazebo_world import check_serial
from construction_twin.physics.mass import payload_of
from construction_twin.robot.description import ESTIMATES, RobotModel, load_robot
from construction_twin.robot.tool import read_tool
from construction_twin.robot.urdf import expand_xacro, xacro_arguments
from construction_twin.ros.commands.experiment_settings import ExperimentSettings, check_goals
from construction_twin.ros.commands.node_files import ROBOT_NODES, node_files_problem
from construction_twin.ros.messages.joint_goals import control_messages
from construction_twin.ros.nodes.gazebo import find_gzserver
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.ros.shared.launch_arguments import (
    controller_settings,
    payload_of_launch,
    read_mapping,
    tool_settings,
)
from construction_twin.ros.shared.loaded_process import leave_behind
from construction_twin.ros.shared.master import expect_wall_clock, running
from construction_twin.ros.shared.params import ros_home, settings_of
from construction_twin.ros.shared.roslaunch_parent import command_lines, print_after, roslaunch_parent
from construction_twin.scenario.definition import read_scenario
from construction_twin.scene.cell import load_cell
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.servo.file import read_servos
from construction_twin.views.preflight import NONE, has_gateway_here, is_bare, is_true, notes, problem
from construction_twin.views.roslaunch_call import RoslaunchCall, argument_problem, known_arguments, roslaunch_call
from construction_twin.work.site import read_site

#: What parses launch files without the master that ROS_MASTER_URI names.
_WITHOUT_MASTER = ("rostest", "roslaunch-check")

#: How long a connection of this machine to itself may take [s].
ADDRESS_TIME = 2.0

Given = Mapping[str, str]


# -- what is in the files


def _read_robot(given: Given) -> RobotModel:
    """Return the robot as launch/robot.launch and launch/bringup.launch describe it."""
    description = read_mapping(given["robot_config"], "the robot's keys")
    urdf = expand_xacro(given["robot_xacro"], xacro_arguments(given.get("robot_xacro_args", "")))
    return load_robot(urdf, description | {"name": given["robot"]})


def _check_estimates(given: Given, robot: RobotModel) -> None:
    """Refuse to move a real arm by values that nobody has looked up."""
    if given.get("arm") == "real" and robot.estimates:
        keys = " and ".join(ESTIMATES[word] for word in robot.estimates)
        raise ConfigurationError(
            "estimates",
            list(robot.estimates),
            Sentence("expected.no_estimates", keys=keys),
        )


def _check_self_collision(given: Given, robot: RobotModel) -> None:
    read_self_collision(given["self_collision"], robot)


def _make(given: Given) -> Make:
    return make_of(given.get("controller_make", DEFAULT))


def _check_controller_file(given: Given, robot: RobotModel) -> None:
    """Check it as gateway and bridge do: axes, channels, and a format that can carry the robot's ranges."""
    if given.get("arm") == "none" or is_bare(given):
        return
    path, form = given["ethernet_xml"], _make(given).file
    if path != NONE:
        _make(given).form_of(path).load(path)
    elif form is not None:
        raise ConfigurationError("path", path, Sentence("expected.form", file=form.name))
    settings = read_mapping(str(_package() / "config" / "gateway.yaml"), "link settings")
    given_here = {"decimals": int(given.get("decimals", "3"))} | controller_settings(given)
    gateway_config(robot, settings | given_here | tool_settings(given))


def _check_tool(given: Given, _robot: RobotModel) -> None:
    """Check the tool file; whether the controller's file fits it is asked with that."""
    if given["tool"]:
        read_tool(given["tool"])


def _check_twin(given: Given, robot: RobotModel) -> None:
    """Check that a twin with mass can be simulated."""
    if given["twin"] == "mujoco":
        check_extras("physics")
    elif given["twin"] == "gazebo":
        if given.get("payload"):
            raise ConfigurationError("payload", given["payload"], Sentence("expected.gazebo_payload"))
        check_serial(RobotBodies(robot))
        find_gzserver(given.get("gzserver", ""))


def _check_servo(given: Given, _robot: RobotModel) -> None:
    """Check that a mock arm with mass can be simulated."""
    if given["servo"] == "physics":
        check_extras("physics")


def _check_payload(given: Given, _robot: RobotModel) -> None:
    payload_of(payload_of_launch(given["payload"]), "payload")


def _check_work(given: Given, robot: RobotModel) -> None:
    """Check that a building model can be worked on: packages, cell file, and that the robot's tool and scene are the cell's."""
    if not given["work_model"]:
        return
    check_extras("work")
    if not readable(given["work_model"]):
        raise ConfigurationError("its path", given["work_model"], Sentence("preflight.expected.file"))
    cell = given.get("work_cell", "")
    if not readable(cell):
        raise ConfigurationError("work_cell", cell, Sentence("expected.cell_path"))
    site = read_site(cell)
    for name, named in (("tool", site.file.tool), ("scene", site.file.scene)):
        wanted = (Path(cell).resolve().parent / named).resolve()
        given_path = given.get(name, "")
        if not given_path.startswith("/") or Path(given_path).resolve() != wanted:
            raise ConfigurationError(
                name,
                given_path,
                Sentence("expected.as_cell", wanted=str(wanted), cell=cell, name=name, path=str(wanted)),
            )


def _check_rehearsal(given: Given, robot: RobotModel) -> None:
    """Find MuJoCo where a rehearsal is asked for, and check the drives' file."""
    if given["rehearsal"] in ("advise", "require"):
        check_extras("physics")


def _check_drives(given: Given, robot: RobotModel) -> None:
    if given["drives"]:
        read_drives(given["drives"], robot)


def _check_servos(given: Given, robot: RobotModel) -> None:
    """Refuse the servos of another arm, and those of another cycle, by which the arm would never be judged."""
    if not given["servo_model"]:
        return
    known = read_servos(given["servo_model"], robot.joint_names).cycle_ns // 1_000_000
    cycle = controller_settings(given)["cycle"]
    if known != cycle:
        raise ConfigurationError("cycle_ms", known, Sentence("expected.servo_cycle", cycle=cycle))


def _check_scene(given: Given, robot: RobotModel) -> None:
    """Place the objects as the nodes do: by names of links and objects that exist, with meshes that can be used."""
    scene = read_scene(given["scene"])
    RobotBodies(robot).place_all(scene)


def _check_cell(given: Given, robot: RobotModel) -> None:
    if given["cell"]:
        cell = load_cell(read_mapping(given["cell"], "the places of robots"))
        for name in filter(None, (robot.name, given.get("neighbour"))):
            cell.world_T_root(name)


def _check_account(name: str) -> Callable[[Given, RobotModel], None]:
    def check(given: Given, _robot: RobotModel) -> None:
        if not given[name] or given.get("arm") == "none":
            return
        account = load_account(given[name])
        if account.password_file:
            account.password()
        if account.ca_file:
            account.context()

    return check


def _check_task(given: Given, robot: RobotModel) -> None:
    """Check the task of experiment.launch as its node does: what it leaves out is config/experiment.yaml's."""
    shipped = read_mapping(str(_package() / "config" / "experiment.yaml"), "a task")
    task = shipped | read_mapping(given["task"], "a task") | {"results_dir": "/"}
    check_goals(settings_of(ExperimentSettings, task, given["task"]), robot)


def _check_scenario(given: Given, _robot: RobotModel) -> None:
    read_scenario(Path(given["scenario"]))


def _check_results(given: Given, _robot: RobotModel) -> None:
    check_writable(Path(given["results_dir"]).expanduser())


def _check_trace(given: Given, robot: RobotModel) -> None:
    """Check that the gateway can make the file: it makes no folders, and does not start without room for all of it."""
    if not given["gateway_trace"] or given.get("arm") == "none" or not has_gateway_here(given):
        return
    path = ros_home() / given["gateway_trace"]
    if path.is_dir():
        raise ConfigurationError(str(path), "a folder", Sentence("expected.path_in"))
    if not os.path.lexists(path.parent):
        raise ConfigurationError(str(path.parent), "no such folder", Sentence("expected.folder_there"))
    check_writable(path.parent)
    path = path.resolve()
    there = path.stat().st_blocks * 512 if path.is_file() else 0
    needed, free = trace_room(len(robot.joint_names)), shutil.disk_usage(path.parent).free + there
    if free < needed:
        found, expected = f"{free / 1e6:.1f} MB of room", Sentence("expected.room", room=needed / 1e6)
        raise ConfigurationError(str(path.parent), found, expected)


def _check_console(given: Given, _robot: RobotModel) -> None:
    """Find what the console needs before it is started again and again without it."""
    if not is_true(given, "console"):
        return
    if importlib.util.find_spec("aiohttp") is None:
        raise ConfigurationError(
            "the Python package aiohttp", "missing", Sentence("expected.installed", command="setup/setup.sh console")
        )
    page = given.get("console_page", "none")
    if page != "none" and not (page.startswith("/") and Path(page, "index.html").is_file()):
        expected = Sentence("expected.page")
        raise ConfigurationError("console_page", page, expected)
    if site := given.get("console_site"):
        if not site.startswith("/"):
            raise ConfigurationError("console_site", site, Sentence("expected.console_site"))
        own_tls(Path(site, "console.crt"), Path(site, "console.key"))
        broker_tls(Path(site, "ca.crt"))
        check_rights(Path(site, "rights.json"))
    if is_true(given, "console_files"):
        check_writable(ros_home() / "construction_twin" / "console")


def _check_action(given: Given, _robot: RobotModel) -> None:
    """Find the messages of the action before a node is started again and again without them."""
    if is_true(given, "follow_joint_trajectory"):
        control_messages()


#: What is checked of a file's contents, by the argument that names it, in this order; each raises a ConstructionTwinError.
CONTENTS: tuple[tuple[str, Callable[[Given, RobotModel], None]], ...] = (
    ("robot_config", _check_estimates),
    ("self_collision", _check_self_collision),
    ("tool", _check_tool),
    ("twin", _check_twin),
    ("servo", _check_servo),
    ("payload", _check_payload),
    ("ethernet_xml", _check_controller_file),
    ("work_model", _check_work),
    ("rehearsal", _check_rehearsal),
    ("drives", _check_drives),
    ("servo_model", _check_servos),
    ("scene", _check_scene),
    ("cell", _check_cell),
    ("bridge_account", _check_account("bridge_account")),
    ("gateway_account", _check_account("gateway_account")),
    ("task", _check_task),
    ("scenario", _check_scenario),
    ("results_dir", _check_results),
    ("gateway_trace", _check_trace),
    ("follow_joint_trajectory", _check_action),
    ("console", _check_console),
)


def make_problem(given: Given) -> str:
    """Return a sentence about a make of controller that is not known, or a cycle that it has not; empty when there is none."""
    name, cycle = given.get("controller_make", DEFAULT), given.get("rsi_cycle")
    if name not in MODULES:
        return Sentence("preflight.wrong", name="controller_make", value=name, expected=" or ".join(MODULES))
    cycles = [str(known) for known in _make(given).cycles]
    if cycle is not None and cycle not in cycles:
        return Sentence("preflight.wrong", name="rsi_cycle", value=cycle, expected=" or ".join(cycles))
    return ""


def contents_problem(given: Given) -> str:
    """Return a sentence about the first file whose contents do not fit, the nodes' own included; empty when there is none.

    Args:
        given: Launch arguments. Without the robot's files nothing is checked, and a file that is not named is not either.
    """
    if not {"robot", "robot_xacro", "robot_config"} <= set(given):
        return ""
    try:
        robot = _read_robot(given)
    except ConstructionTwinError as error:
        files = {"config": given["robot_config"], "xacro": given["robot_xacro"]}
        return Sentence("preflight.robot", problem=error.sentence, **files)
    for name, check_content in CONTENTS:
        if name not in given:
            continue
        try:
            check_content(given, robot)
        except ConstructionTwinError as error:
            path = given[name]
            # most of these sentences begin with the file
            return f"{name}:={path}: {str(error).removeprefix(path).lstrip(':/ ')}"
    return node_files_problem(given, robot, _package() / "config")


def _package() -> Path:
    return Path(rospkg.RosPack().get_path("construction_twin"))


# -- what runs already


def running_problem(given: Given, uri: str) -> str:
    """Return a sentence when this robot, or the window on it, runs already on a master; empty when it does not.

    Args:
        given: Launch arguments.
        uri: Of the master.
    """
    robot = given.get("robot", "")
    nodes = running([f"/{robot}/{name}" for name in ROBOT_NODES], uri) if robot else []
    if nodes:
        first, more = nodes[0], len(nodes) - 1
        names = Sentence("preflight.nodes", node=str(first), count=more) if more else str(first)
        return Sentence("preflight.running", robot=robot, uri=uri, nodes=names)
    consoles = running(["/console"], uri) if is_true(given, "console") else []
    if consoles:
        return Sentence("preflight.console_runs", uri=uri)
    windows = running(["/view"], uri) if is_true(given, "gui") else []
    if windows:
        return Sentence("preflight.rviz_runs", uri=uri, window=str(windows[0]))
    return ""


def address_problem(environ: Mapping[str, str]) -> str:
    """Return a sentence when nodes of this machine would not reach each other, or the master; empty when they do.

    Each node tells the master an address of its own: `ROS_HOSTNAME`, else `ROS_IP`, else the machine's name. With one that leads
    nowhere every node starts, and none hears another.
    """
    if environ.get("ROS_IPV6") == "on":
        return ""
    variable = next((name for name in ("ROS_HOSTNAME", "ROS_IP") if name in environ), "")
    if variable and not environ[variable]:
        return Sentence("preflight.variable_empty", variable=variable)
    own = environ[variable] if variable else rosgraph.network.get_host_name()
    why = reaches_itself(own, ADDRESS_TIME)
    if why and variable:
        return Sentence("preflight.variable", variable=variable, own=own, why=why)
    if why:
        return Sentence("preflight.machine", own=repr(own), why=why)
    master = urllib.parse.urlsplit(rosgraph.get_master_uri()).hostname or ""
    why = reaches_itself(master, ADDRESS_TIME) if master == "localhost" else ""
    return Sentence("preflight.localhost", why=why) if why else ""


def clock_problem(uri: str) -> str:
    """Return a sentence when a master gives simulated time; empty when it does not."""
    try:
        expect_wall_clock(uri)
    except ConfigurationError as error:
        return error.sentence
    return ""


def port_problem(given: Given) -> str:
    """Return a sentence about the first port on this machine that another program holds, or about a broker that cannot start on
    its own; empty when all are free, and it can.
    """
    port, listeners = given.get("broker_port", ""), []
    if is_true(given, "broker"):
        listeners = _listeners(given.get("broker_config", ""))
    for number in listeners:
        if not port_is_free(socket.SOCK_STREAM, number):
            return Sentence("preflight.port.listener", path=given["broker_config"], port=number)
    page_port, page_host = given.get("console_port", ""), given.get("console_listen", "127.0.0.1")
    if is_true(given, "console") and page_port and not port_is_free(socket.SOCK_STREAM, int(page_port), page_host):
        return Sentence("preflight.port.console", port=page_port, host=page_host, other=int(page_port) + 10)
    listens = is_true(given, "broker") and not listeners
    if listens and port and not port_is_free(socket.SOCK_STREAM, int(port)):
        return Sentence("preflight.port.broker", port=port, other=int(port) + 10)
    # once it has started, roslaunch starts it again whenever it ends: what can never work is refused here
    if is_true(given, "broker") and given.get("broker_config"):
        cause = trial(given["broker_config"], int(port or DEFAULT_PORT))
        if cause:
            return f"broker_config:={given['broker_config']}: {cause}"
    if given.get("arm") == "none" or not has_gateway_here(given) or "ethernet_xml" not in given:
        return ""
    port = given.get("rsi_port", "0")
    number = int(port) or _port_of_controller(given)
    host = given.get("rsi_listen", "127.0.0.1")
    if not port_is_free(socket.SOCK_DGRAM, number, host):
        return Sentence("preflight.port.rsi", port=port, number=number, host=host, other=number + 10)
    return ""


def _port_of_controller(given: Given) -> int:
    make, path = _make(given), given["ethernet_xml"]
    # whatever its axes are, they have one port
    return (make.plain(()) if path == NONE else make.form_of(path).load(path).layout).port


def _listeners(path: str) -> list[int]:
    """Return the ports of a mosquitto configuration's own listeners."""
    try:
        return listener_ports(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []


# -- the whole


def call_problem(call: RoslaunchCall) -> str:
    """Return a sentence about an argument on roslaunch's command line that no launch file reads; empty when there is none."""
    files = [name for name in call.files if name.endswith((".launch", ".xml")) or "/" in name]
    if len(files) != 1:
        return ""
    path = Path(files[0])
    if len(call.files) == 2:
        package = _find_package(call.files[0])
        if package is None:
            return ""
        path = next((found for found in (Path(package, "launch", path), Path(package, path)) if found.is_file()), path)
    known = known_arguments(path, _find_package)
    return "" if known is None else argument_problem(call.given, known, path.name)


def _find_package(name: str) -> str | None:
    try:
        return rospkg.RosPack().get_path(name)
    except rospkg.ResourceNotFound:
        return None


def refusal(given: Given, call: RoslaunchCall | None, uri: str) -> str:
    """Return why a start would not work; empty when nothing is known against it.

    Args:
        given: Launch arguments, with defaults.
        call: How roslaunch was called, when it was.
        uri: Of the master; empty: it is not known, and nothing that runs is looked at.
    """
    sentence = call_problem(call) if call is not None else ""
    sentence = sentence or problem(given, readable, lets_in_everybody) or make_problem(given) or contents_problem(given)
    if sentence or not uri:
        return sentence
    sentence = address_problem(os.environ) or clock_problem(uri)
    return sentence or running_problem(given, uri) or (port_problem(given) if call is not None else "")


def main() -> NoReturn:
    """Check what this program was called with; for a roslaunch that starts a robot, leave its loaded process behind."""
    words = sys.argv[1:]
    pid, above = next(iter(command_lines()), (0, []))
    call = roslaunch_call(above)
    starts = call.starts if call is not None else any(Path(word).name == "rostest" for word in above[:2])
    if starts and "--for-roslaunch" in words and any(word.startswith("robot:=") for word in words):
        leave_behind(pid)
    code = check(words)
    sys.stdout.flush()
    # roslaunch waits: nothing of what was loaded has to be taken apart
    os._exit(code)


def check(words: Sequence[str]) -> int:
    """Check ``name:=value`` arguments; print "ok", or a sentence on standard error and return 1.

    With ``--for-roslaunch`` the result is what standard output says, ``true`` or ``refused``, and the exit code is 0: roslaunch
    would print the whole command again. The sentence then stands below roslaunch's last line, too.
    """
    for_roslaunch = "--for-roslaunch" in words
    above = roslaunch_parent() if for_roslaunch else None
    pid, call = above if above is not None else (None, None)
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    uri = _master(call)
    sentence = refusal(given, call, uri)
    if sentence:
        print(f"preflight: {sentence}", file=sys.stderr, flush=True)
        print_after(f"preflight: {sentence}", pid)
        if for_roslaunch:
            print("refused")
        return 0 if for_roslaunch else 1
    for note in notes(given):
        print(f"preflight: {note}", file=sys.stderr, flush=True)
    print("true" if for_roslaunch else "ok")
    return 0


def _master(call: RoslaunchCall | None) -> str:
    """Return the URI of the master that the nodes will use; empty when none will start, or it cannot be told."""
    if call is None:
        programs = {Path(word).name for _, words in command_lines() for word in words[:2]}
        return "" if programs & set(_WITHOUT_MASTER) else rosgraph.get_master_uri()
    if not call.starts:
        return ""
    if call.port.isdecimal():
        return rosgraph.network.create_local_xmlrpc_uri(int(call.port))
    return rosgraph.get_master_uri()


def readable(path: str) -> bool:
    """Return whether a path is absolute, and that of a file that can be read."""
    if not path.startswith("/"):
        return False
    try:
        with Path(path).open("rb"):
            return True
    except OSError:
        return False


def lets_in_everybody(path: str) -> bool:
    """Return whether a mosquitto configuration permits clients without an account; one that cannot be read is taken to."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return True
    # of several lines the last one counts; without one mosquitto 2 refuses clients without an account
    permitted = [line.split()[1:] for line in lines if line.split()[:1] == ["allow_anonymous"]]
    return bool(permitted) and permitted[-1] == ["true"]
