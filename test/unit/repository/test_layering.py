"""What holds for the package as a whole: layers, docstrings, launch arguments, configuration keys."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from dataclasses import fields
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from separation_node import Settings as SeparationSettings

from construction_twin.gateway.config import GatewayConfig
from construction_twin.mock.program import MockSettings
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.commands.experiment_settings import ExperimentSettings
from construction_twin.ros.nodes.console_node import Settings as ConsoleSettings
from construction_twin.ros.nodes.executor import Settings as ExecutorSettings
from construction_twin.ros.nodes.follow_joint_trajectory import Settings as FollowSettings
from construction_twin.ros.nodes.mqtt_bridge import Settings as BridgeSettings
from construction_twin.ros.nodes.pca_monitor import Settings as MonitorSettings
from construction_twin.ros.nodes.planner import Settings as PlannerSettings
from construction_twin.ros.nodes.tool_marker import Settings as MarkerSettings
from construction_twin.ros.nodes.work import Settings as WorkSettings
from construction_twin.ros.shared.arm_listener import NeighbourSettings
from construction_twin.ros.shared.gateway_config import gateway_config

ROOT = Path(__file__).parents[3]
PACKAGE = ROOT / "src" / "construction_twin"
SOURCES = sorted(PACKAGE.rglob("*.py"))
LIBRARY = [path for path in SOURCES if "ros" not in path.relative_to(PACKAGE).parts]
NODES = sorted(path for path in (ROOT / "nodes").iterdir() if path.is_file()) + [
    ROOT / "examples/separation/separation",
    ROOT / "examples/plc/plc",
]
LAUNCHES = sorted((ROOT / "launch").glob("*.launch"))
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")

#: What the library may import besides the standard library and itself. PyKDL and rospkg are ROS's, but need no ROS to run.
THIRD_PARTY = {
    "numpy", "scipy", "ompl", "toppra", "pydantic", "yaml", "xacro", "urdf_parser_py", "PyKDL", "paho", "matplotlib", "rich",
    "mpl_toolkits", "coal", "pinocchio", "eaik", "py_opw_kinematics", "manifold3d", "ifcopenshell", "isodate",
    "mujoco", "rosbags", "rospkg",
}  # fmt: skip
#: The only folder or file that may need a package that is not everywhere: `setup/setup.sh work` and `console` install it.
#: Everything else must run without.
OPTIONAL = {
    "ifcopenshell": "work/ifc",
    "isodate": "work/ifc",
    "coacd": "work",
    "shapely": "work",
    "mujoco": "physics",
    "aiohttp": "console",
}
GENERATED = {"msg", "srv", "action"}
#: Given in the launch files: deployment, not behaviour.
DEPLOYMENT = {
    "executor": {
        "arm",
        "auto_approve",
        "auto_approve_is_meant",
        "auto_approve_sources",
        "neighbour",
        "rehearsal",
        "tool",
        "realtime_priority",
    },
    "follow_joint_trajectory": {"arm"},
    "separation": set(),
    "mqtt_bridge": {
        "host",
        "port",
        "protocol",
        "prefix",
        "account",
        "realtime_priority",
        "gateway_kind",
        "arm",
        "broker_config",
        "anonymous_broker_is_meant",
    },
    "console_node": {
        "host",
        "port",
        "protocol",
        "prefix",
        "account",
        "realtime_priority",
        "self_collision",
        "private",
        "servo_model",
        "tool",
    },
    "pca_monitor": {
        "arm",
        "decimals",
        "realtime_priority",
        "servo_model",
    },
    "mock_rsi": {"gateway_host", "gateway_port", "make", "ethernet_xml", "tool", "drives", "payload"},
    "experiment": {"results_dir"},
    "gateway": {"decimals", "robot", "axes", "linear", "lower", "upper", "velocity", "acceleration", "layout", "tool"},
    "neighbour": {"name", "realtime_priority"},
    "planner": {"self_collision", "tf_prefix"},
    "rehearsal": {"mode", "drives", "tool", "self_collision", "payload"},
    "tool_marker": {"self_collision", "tf_prefix"},
    "work": {"model", "cell", "tool", "scene", "self_collision", "tf_prefix", "arm", "private"},
}


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imported(path: Path) -> set[str]:
    """Return every module that a file imports, at whatever depth of the code."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    return modules


def config(name: str) -> dict:
    return yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text())


@pytest.mark.parametrize("path", LIBRARY, ids=relative)
def test_the_library_knows_no_ros(path):
    for module in imported(path):
        top, *rest = module.split(".")
        if top == "construction_twin":
            assert rest[0] not in GENERATED | {"ros"}, module
        elif top in OPTIONAL:
            assert path.is_relative_to(PACKAGE / OPTIONAL[top]), module
        else:
            assert top in sys.stdlib_module_names | THIRD_PARTY, module


#: The functions that may catch every exception, one handler each.
#: - The gateway's: after it the last resort answers RSI, and no command is taken any more. Without it an error in a status message
#:   would end the answers, and the controller would stop the arm dead from full speed.
#: - The subscriber's: rospy would log what a callback did not foresee and go on with the next message, in a node whose state nobody
#:   knows. The handler hands every exception to `threading.excepthook`, which ends the process; it swallows nothing.
#: - SideEffects': what reports, records or predicts a stop, a pause, a halt or a rejection must not be able to fail it, and a node
#:   that ends while the arm brakes along its path would fail it. It counts, keeps the exception until it is in the log, and shows
#:   it on `/diagnostics`; it runs no act.
#: - The film's: what draws without a screen fails in ways of each driver's own. What was said is part of the refusal.
BROAD = {
    "src/construction_twin/core/side_effects.py": "run",
    "src/construction_twin/gateway/service.py": "guarded",
    "src/construction_twin/physics/film.py": "open_context",
    "src/construction_twin/ros/transport/subscriber.py": "_receive",
}


def broad_handlers(node: ast.AST) -> list[int]:
    """Return the lines of the handlers that catch every exception."""
    handlers = [each for each in ast.walk(node) if isinstance(each, ast.ExceptHandler)]
    assert all(handler.type is not None for handler in handlers)
    return [each.lineno for each in handlers if getattr(each.type, "id", "") in ("Exception", "BaseException")]


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_nothing_is_swallowed_and_nothing_imported_by_star(path):
    tree = ast.parse(path.read_text())
    exempt: list[int] = []
    if relative(path) in BROAD:
        name = BROAD[relative(path)]
        (function,) = (each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef) and each.name == name)
        exempt = broad_handlers(function)
        assert len(exempt) == 1
    assert broad_handlers(tree) == exempt
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.names[0].name != "*"


#: Where a node may use rospy's own `Subscriber` or `Service`, and how often.
#: - RobotListener hears `/diagnostics`, which has many publishers, and counts messages of any kind, whose content it does not read.
#: - ScenarioDriver hears the true pose of the mock arm, which may be any node's.
#: - `Service` of ros/shared/node.py is rospy's, with an end of the process after a handler that raised.
BARE = {
    "src/construction_twin/ros/shared/robot_listener.py": {"Subscriber": 2},
    "src/construction_twin/ros/shared/node.py": {"Service": 1},
    "src/construction_twin/ros/commands/scenario.py": {"Subscriber": 1},
}
GUARDED = [
    path
    for folder in (
        "src/construction_twin/ros/nodes",
        "src/construction_twin/ros/shared",
        "src/construction_twin/ros/commands",
        "examples",
    )
    for path in sorted((ROOT / folder).rglob("*.py"))
]


def bare_uses(source: str) -> dict[str, int]:
    """Count calls of, and classes from, rospy's own subscriber and service, and imports of them by name."""
    uses: Counter[str] = Counter()
    for node in ast.walk(ast.parse(source)):
        made = [node.func] if isinstance(node, ast.Call) else node.bases if isinstance(node, ast.ClassDef) else []
        uses.update(
            each.attr for each in made if isinstance(each, ast.Attribute) and ast.unparse(each.value) == "rospy"
        )
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "rospy":
            uses.update(alias.name for alias in node.names)
    return {name: count for name, count in uses.items() if name in ("Subscriber", "Service")}


@pytest.mark.parametrize("path", GUARDED, ids=relative)
def test_nodes_hear_one_publisher_and_end_on_what_nobody_foresaw(path):
    """A bare `rospy.Subscriber` hears everybody, and of both rospy lives on after an exception."""
    assert bare_uses(path.read_text()) == BARE.get(relative(path), {})


@pytest.mark.parametrize("path", NODES, ids=relative)
def test_nodes_only_import_main_and_call_it(path):
    text = path.read_text()
    assert len(text.splitlines()) <= 15 and text.startswith("#!/usr/bin/env python3\n")
    imported = [
        alias.name
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("construction_twin")
        for alias in node.names
    ]
    assert imported in ([], ["main"], ["main", "run_program"], ["become_alone"])


@pytest.mark.parametrize("path", LAUNCHES, ids=relative)
def test_every_configuration_file_that_a_launch_file_loads_exists(path):
    prefix = "$(find construction_twin)/"
    for element in ElementTree.parse(path).getroot().iter():
        name = element.get("file", "")
        if name.startswith(prefix):
            assert (ROOT / name.removeprefix(prefix)).is_file(), name


@pytest.mark.parametrize("path", LAUNCHES, ids=relative)
def test_every_node_that_a_launch_file_starts_exists(path):
    for node in ElementTree.parse(path).getroot().iter("node"):
        if node.get("pkg") == "construction_twin":
            assert node.get("type") in {path.name for path in NODES}
            assert node.get("name") == node.get("type")


SETTINGS = {
    "experiment": set(ExperimentSettings.model_fields),
    "gateway": {field.name for field in fields(GatewayConfig)},
    "mock_rsi": set(MockSettings.model_fields),
    "executor": set(ExecutorSettings.model_fields),
    "follow_joint_trajectory": set(FollowSettings.model_fields),
    "mqtt_bridge": set(BridgeSettings.model_fields),
    "console_node": set(ConsoleSettings.model_fields),
    "neighbour": set(NeighbourSettings.model_fields),
    "pca_monitor": set(MonitorSettings.model_fields),
    "planner": set(PlannerSettings.model_fields),
    "tool_marker": set(MarkerSettings.model_fields),
    "separation": set(SeparationSettings.model_fields),
    "work": set(WorkSettings.model_fields),
}


@pytest.mark.parametrize("node", sorted(SETTINGS))
def test_configuration_and_settings_have_the_same_keys(node):
    assert set(config(node)) == SETTINGS[node] - DEPLOYMENT[node]


@pytest.mark.parametrize(
    "model, name, deployment",
    [
        (ExperimentSettings, "experiment", {"results_dir": "/tmp"}),
        (MockSettings, "mock_rsi", {"gateway_host": "127.0.0.1", "gateway_port": 49152}),
        (BridgeSettings, "mqtt_bridge", {"host": "127.0.0.1", "port": 1883, "arm": "mock"}),
        (ConsoleSettings, "console_node", {"host": "127.0.0.1", "port": 1883}),
        (
            MonitorSettings,
            "pca_monitor",
            {
                "arm": "mock",
                "decimals": 3,
                "servo_model": "",
            },
        ),
        (ExecutorSettings, "executor", {"arm": "mock"}),
        (FollowSettings, "follow_joint_trajectory", {"arm": "mock"}),
        (SeparationSettings, "separation", {}),
        (NeighbourSettings, "neighbour", {"name": "b"}),
        (MarkerSettings, "tool_marker", {"self_collision": "/tmp/pairs.yaml", "tf_prefix": ""}),
        (PlannerSettings, "planner", {"self_collision": "/tmp/pairs.yaml", "tf_prefix": ""}),
    ],
)
def test_the_shipped_configuration_is_accepted(model, name, deployment):
    settings = model(**config(name), **deployment)
    for key, value in config(name).items():
        assert getattr(settings, key) == value


def test_the_shipped_gateway_settings_make_a_configuration():
    shipped = gateway_config(ROBOT, config("gateway") | {"decimals": 3})
    assert shipped == gateway_config(ROBOT, {})
    assert shipped.axes == ("A1", "A2", "A3", "A4", "A5", "A6")


#: What tells or passes time.
CLOCK = {"time", "monotonic", "perf_counter", "process_time", "clock_gettime", "sleep", "now", "utcnow", "today"}
#: Modules of the library whose job a clock is, beside those of programs that serve a socket: why.
CLOCKS = {
    "core/clock.py": "what searches and plans are measured with where the caller gives no clock",
    "work/worker_functions.py": "a budget for the search",
}
#: What talks to a network.
NETWORK = {"socket", "select", "selectors", "asyncio"}
#: Modules of the library that talk to a network, or name its addresses and errors.
SOCKETS = (
    "broker/start.py console/pipe.py console/program.py "
    "console/server.py core/network.py gateway/service.py mock/network.py mqtt/client.py "
    "mqtt/failures.py mqtt/fast_client.py mqtt/polled_client.py core/udp.py ros/nodes/view.py"
).split()


@pytest.mark.parametrize("path", LIBRARY, ids=relative)
def test_the_library_has_a_clock_or_a_socket_only_where_that_is_its_job(path):
    """Law 6: time is an argument, so that the whole chain also runs on a simulated clock."""
    clocks, sockets = set(), set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute) and node.attr.removesuffix("_ns") in CLOCK:
            clocks |= {node.attr} if ast.unparse(node.value).split(".")[-1] in ("time", "datetime", "date") else set()
        if isinstance(node, ast.ImportFrom):
            clocks |= {name.name for name in node.names if node.module == "time"}
            sockets |= {node.module} & NETWORK
        if isinstance(node, ast.Import):
            # under another name nothing of it would be seen here
            clocks |= {name.name for name in node.names if name.asname}
            sockets |= {name.name for name in node.names} & NETWORK
    name = str(path.relative_to(PACKAGE))
    assert bool(sockets) is (name in SOCKETS)
    clocks = {clock for clock in clocks if clock.removesuffix("_ns") in CLOCK}
    assert not clocks or name in {*CLOCKS, *SOCKETS}, clocks
