"""Writes the generated parts of docs/reference/, and the schemas of messages, from the code, or with --check says which of them are
not up to date.

A generated part stands between ``<!-- generated: KIND -->`` and ``<!-- end of KIND -->``; everything else on a page is written by
hand and left alone. Sources: `doc=` of launch arguments, the pydantic settings of nodes with the comments of config/*.yaml, the
``--help`` of commands, the message and service definitions, and the records of `schemas.py`. Needs the package's environment
(``source .ws/env.bash``).
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
import re
import runpy
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal, get_args, get_origin
from unittest import mock
from xml.etree import ElementTree

import pydantic
import schemas
import yaml

from construction_twin.core.state_table import cells
from construction_twin.link.states import BARE_TABLE

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "docs" / "reference"
_PART = re.compile(r"(<!-- generated: ([a-z ]+) -->\n).*?(<!-- end of \2 -->\n)", re.DOTALL)
#: Nodes with private parameters: module of the settings, name in config/ (empty: none).
NODES = {
    "planner": ("construction_twin.ros.nodes.planner", "planner"),
    "scene": ("construction_twin.ros.nodes.scene", ""),
    "neighbour": ("construction_twin.ros.shared.arm_listener", "neighbour"),
    "follow_joint_trajectory": ("construction_twin.ros.nodes.follow_joint_trajectory", "follow_joint_trajectory"),
    "preview": ("construction_twin.ros.nodes.preview", ""),
    "joint_velocities": ("construction_twin.ros.nodes.joint_velocities", "joint_velocities"),
    "executor": ("construction_twin.ros.nodes.executor", "executor"),
    "pca_monitor": ("construction_twin.ros.nodes.pca_monitor", "pca_monitor"),
    "virtual_robot": ("construction_twin.ros.nodes.virtual_robot", ""),
    "mqtt_bridge": ("construction_twin.ros.nodes.mqtt_bridge", "mqtt_bridge"),
    "work": ("construction_twin.ros.nodes.work", "work"),
    "mqtt_review": ("construction_twin.ros.nodes.mqtt_review", "mqtt_review"),
    "mqtt_planner": ("construction_twin.ros.nodes.mqtt_planner", "mqtt_planner"),
    "mock_rsi": ("construction_twin.mock.program", "mock_rsi"),
    "tool_marker": ("construction_twin.ros.nodes.tool_marker", "tool_marker"),
    "sync_view": ("construction_twin.ros.nodes.sync_view", ""),
    "static_frames": ("construction_twin.ros.nodes.static_frames", ""),
    "startup": ("construction_twin.ros.nodes.startup", ""),
    "separation": ("separation_node", "separation"),
    "experiment": ("construction_twin.ros.commands.experiment_settings", "experiment"),
    "scenario": ("construction_twin.ros.commands.scenario", ""),
}
# any other node whose module has a class Settings, with the file in config/ that has its name, if there is one
for _module in sorted((ROOT / "src/construction_twin/ros/nodes").glob("*.py")):
    if _module.stem not in NODES and re.search(r"^class Settings\(", _module.read_text(), re.MULTILINE):
        _file = _module.stem if (ROOT / "config" / f"{_module.stem}.yaml").is_file() else ""
        NODES[_module.stem] = f"construction_twin.ros.nodes.{_module.stem}", _file
#: What neither a configuration file nor a launch argument explains; `*` stands for every node.
_EXPLAINED = {
    ("*", "realtime_priority"): "SCHED_FIFO priority of all threads where permitted; 0: none",
    ("gazebo", "realtime"): "SCHED_FIFO priority of Gazebo's simulating thread where permitted; 0: none",
    ("gazebo", "drives"): "YAML of the arm's drives: absolute path; empty: what the URDF says",
    ("virtual_robot", "drives"): "YAML of the arm's drives: absolute path; empty: what the URDF says",
    ("*", "self_collision"): "YAML of the link pairs that are not checked: absolute path",
    ("*", "tf_prefix"): "stands before the names of the robot's frames in tf; empty: nothing",
    ("scene", "check_rate"): "how often the present pose is checked [Hz]",
    ("executor", "neighbour"): "name of the other robot whose verdicts on `conflict` are asked for; empty: none",
    ("mqtt_bridge", "protocol"): "MQTT version: 5 or 3.1.1",
    ("static_frames", "parent"): "frame in which the robot stands",
    (
        "static_frames",
        "prefixes",
    ): "tf prefixes of the robot's copies: twin, physical, preview",
    (
        "static_frames",
        "chain_only",
    ): "of them, where joint states hold the chain alone; frames of other joints come from here",
    (
        "static_frames",
        "more",
    ): "tf prefixes of further copies of the chain alone, by their names: simulated of a twin with mass, expected with servo_model",
    (
        "*",
        "private",
    ): "folder of what a console serves to whom is logged in, relative to ROS_HOME; empty: nothing is written",
    ("startup", "broker"): "address of the broker, HOST:PORT",
    ("startup", "rsi"): "address on which the gateway listens, HOST:PORT",
    ("mock_rsi", "ethernet_xml"): "text of the Ethernet XML: SENTYPE, blocks, channels, HOLDON, ONLYSEND, port",
    ("neighbour", "name"): "name and namespace of the other robot",
    ("*", "results_dir"): "folder for the results: absolute path",
    ("scenario", "name"): "of the scenario; the results go into a folder of this name",
    ("scenario", "trace"): "the gateway's trace: absolute path",
}
#: Commands with a `--help`: title, how it is started, arguments before `--help`.
COMMANDS: list[tuple[str, str, list[str]]] = [
    ("twin", "nodes/twin", []),
    *((f"twin {name}", "nodes/twin", [name]) for name in ("plan", "home", "preview", "approve", "reject")),
    *((f"twin {name}", "nodes/twin", [name]) for name in ("arm", "status", "scene", "export", "pair", "watch")),
    ("twin work", "nodes/twin", ["work"]),
    *(
        (f"twin work {name}", "nodes/twin", ["work", name])
        for name in ("next", "approve", "skip", "answer", "measured")
    ),
    ("python -m construction_twin.gateway", "construction_twin.gateway", []),
    ("export_gateway_config", "nodes/export_gateway_config", []),
    ("python -m construction_twin.mock", "construction_twin.mock", []),
    ("ik_report", "nodes/ik_report", []),
    ("rehearse", "nodes/rehearse", []),
    ("identify", "nodes/identify", []),
    ("currents", "nodes/currents", []),
    ("new_arm", "nodes/new_arm", []),
    ("self_collision", "nodes/self_collision", []),
    ("srdf", "nodes/srdf", []),
    ("moveit_config", "nodes/moveit_config", []),
    ("make_site", "nodes/make_site", []),
    ("broker", "nodes/broker", []),
    ("console", "nodes/console", []),
    ("evaluate", "nodes/evaluate", []),
    ("scenario", "nodes/scenario", []),
]


# -- launch arguments


def launch_arguments(path: Path) -> dict[str, tuple[str, str]]:
    """Return a launch file's arguments: name to default (as text for the table) and `doc`."""
    arguments = {}
    for arg in ElementTree.parse(path).getroot().findall("arg"):
        doc = re.sub(r"\{([^}]*)\}", r"\1", arg.get("doc", ""))
        arguments[arg.get("name", "")] = _default_text(arg), " ".join(doc.split())
    return arguments


def _default_text(arg: ElementTree.Element) -> str:
    text = arg.get("default")
    if text is None:
        return "computed" if arg.get("value") else "required"
    if text.startswith("$(eval"):
        return "depends on `track`" if "arg('track')" in text else "computed"
    text = text.replace("$(find construction_twin)/", "")
    text = re.sub(r"\$\(optenv (\w+) ([^)]+)\)", r"$\1, else \2", text)
    text = re.sub(r"\$\(arg (\w+)\)", r"<\1>", text)
    return f"`{text}`" if text else "empty"


def _launch_page() -> str:
    launch = ROOT / "launch"
    bringup = launch_arguments(launch / "bringup.launch")
    parts = [_launch_table("bringup.launch", bringup)]
    for name in ("experiment", "scenario", "two_robots", "gazebo", "view", "robot", "twin", "link"):
        own = launch_arguments(launch / f"{name}.launch")
        # the parts of bringup get their values from it: only what it does not have is told again
        part = name in ("twin", "link")
        rows = {arg: value for arg, value in own.items() if arg not in bringup or (not part and value != bringup[arg])}
        if rows:
            parts.append(_launch_table(f"{name}.launch", rows))
    for name in ("move_group", "demo"):
        parts.append(
            _launch_table(f"{name}.launch (MoveIt)", launch_arguments(ROOT / "moveit" / "launch" / f"{name}.launch"))
        )
    return "\n".join(parts)


def _launch_table(title: str, arguments: dict[str, tuple[str, str]]) -> str:
    rows = [f"| `{name}` | {default} | {_cell(doc)} |" for name, (default, doc) in arguments.items()]
    return "\n".join([f"## {title}\n", "| argument | default | meaning |", "|---|---|---|", *rows, ""])


def _cell(text: str) -> str:
    return text.replace("|", r"\|")


# -- parameters


def yaml_comments(path: Path) -> dict[str, str]:
    """Return each top-level key of a configuration file with the comment above it; keys in a row share one."""
    comments: dict[str, str] = {}
    block: list[str] = []
    fresh = True
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            block = [*([] if fresh else block), line[1:].strip()]
            fresh = False
        elif not line.strip():
            block, fresh = [], True
        elif key := re.match(r"(\w+):", line):
            comments[key[1]] = " ".join(block)
            fresh = True
    return comments


def settings_of(module: str) -> type[pydantic.BaseModel]:
    """Return the class of a node's private parameters: the one whose name ends in Settings and that the module defines."""
    for path in (ROOT / "examples" / "separation", ROOT / "src"):
        if str(path) not in sys.path:
            sys.path.append(str(path))
    found = [
        value
        for value in vars(importlib.import_module(module)).values()
        if isinstance(value, type) and issubclass(value, pydantic.BaseModel) and value.__module__ == module
    ]
    named = [model for model in found if model.__name__.endswith("Settings")]
    return max(named or found, key=lambda model: len(model.model_fields))


def launch_values(node: str) -> dict[str, str]:
    """Return the private parameters that the launch files give a node: name to the argument, or to "" where it is no argument's."""
    values: dict[str, str] = {}
    for path in sorted((ROOT / "launch").glob("*.launch")):
        for element in ElementTree.parse(path).getroot().iter():
            is_node = element.get("name") == node and element.get("pkg") == "construction_twin"
            # of a node that another process may take the place of
            is_group = element.tag == "group" and element.get("ns") == node
            if not is_node and not is_group:
                continue
            for param in element.findall("param"):
                text = param.get("value") or param.get("textfile") or ""
                arg = re.fullmatch(r"\$\(arg (\w+)\)", text)
                values[param.get("name", "")] = arg[1] if arg else ""
    return values


def range_text(field: pydantic.fields.FieldInfo) -> str:
    """Return what a field accepts, in a few words."""
    bounds = {}
    for constraint in field.metadata:
        for name in ("ge", "gt", "le", "lt"):
            if getattr(constraint, name, None) is not None:
                bounds[name] = _number(getattr(constraint, name))
    options = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    if options:
        return ", ".join(f"`{option}`" for option in options)
    if field.annotation is bool:
        return "`true`, `false`"
    low = f"[{bounds['ge']}" if "ge" in bounds else f"({bounds['gt']}" if "gt" in bounds else ""
    high = f"{bounds['le']}]" if "le" in bounds else f"{bounds['lt']})" if "lt" in bounds else ""
    if low and high:
        return f"{low}, {high}"
    if low:
        return ("≥ " if "ge" in bounds else "> ") + low[1:]
    return ("≤ " if "le" in bounds else "< ") + high[:-1] if high else ""


def _number(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e6 else str(int(value))


def _parameter_table(node: str) -> str:
    module, config = NODES[node]
    model = settings_of(module)
    path = ROOT / "config" / f"{config}.yaml"
    given = yaml.safe_load(path.read_text()) if config else {}
    comments = yaml_comments(path) if config else {}
    launched = launch_values(node)
    docs = launch_arguments(ROOT / "launch" / "link.launch") | launch_arguments(ROOT / "launch" / "bringup.launch")
    rows = []
    for name, field in model.model_fields.items():
        arg = launched.get(name)
        if arg:
            default = f"launch: `{arg}`"
        elif name in launched and name not in given:
            default = "launch"
        elif name in launched:
            default = f"`{_yaml_text(given[name])}`; the launch file sets another for the mock"
        elif name in given:
            default = f"`{_yaml_text(given[name])}`"
        else:
            default = "launch" if field.is_required() else f"`{_yaml_text(field.default)}`"
        meaning = comments.get(name) or _EXPLAINED.get((node, name)) or _EXPLAINED.get(("*", name))
        meaning = meaning or docs.get(arg or name, ("", ""))[1]
        if not meaning:
            raise SystemExit(f"{node}/{name} is explained nowhere: give config/{config or node}.yaml a comment")
        rows.append(f"| `{name}` | {default} | {range_text(field)} | {_cell(meaning)} |")
    return "\n".join([f"### {node}\n", "| parameter | default | range | meaning |", "|---|---|---|---|", *rows, ""])


def _yaml_text(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, list) and len(value) > 4:
        return "..."
    return str(value)


def _gateway_table() -> str:
    path = ROOT / "config" / "gateway.yaml"
    comments = yaml_comments(path)
    rows = [
        f"| `{name}` | `{_yaml_text(value)}` | {_cell(comments[name])} |"
        for name, value in yaml.safe_load(path.read_text()).items()
    ]
    return "\n".join(["| key | default | meaning |", "|---|---|---|", *rows, ""])


def _parameter_page() -> str:
    return "\n".join(_parameter_table(node) for node in NODES)


# -- commands


def help_text(start: str, arguments: list[str]) -> str:
    """Return what a command prints on ``--help``; `start` is a file of the repository or a module."""
    printed = io.StringIO()
    environment = {"COLUMNS": "110", "ROS_NAMESPACE": "", "LANG": "C.UTF-8"}
    name = "rsi_gateway" if start.endswith("gateway") else start.rsplit("/", 1)[-1]
    with (
        mock.patch.object(sys, "argv", [name, *arguments, "--help"]),
        mock.patch.dict(os.environ, environment),
        mock.patch.object(sys, "setswitchinterval"),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        if "/" in start:
            runpy.run_path(str(ROOT / start), run_name="__main__")
        else:
            runpy.run_module(start, run_name="__main__", alter_sys=False)
    # defaults are absolute paths: the page must not depend on where the package lies, nor on the lines broken by their length
    return printed.getvalue().strip().replace(f"{ROOT}/", "")


def _command_page() -> str:
    parts = []
    for title, start, arguments in COMMANDS:
        parts.append(f"### {title}\n\n```text\n{help_text(start, arguments)}\n```\n")
    return "\n".join(parts)


# -- messages


def _message_page() -> str:
    parts = []
    for folder, suffix in (("msg", "msg"), ("srv", "srv")):
        for path in sorted((ROOT / folder).glob(f"*.{suffix}")):
            parts.append(f"## {path.name}\n\n```text\n{path.read_text().strip()}\n```\n")
    return "\n".join(parts)


# -- exit codes of `twin`


def _exit_codes() -> str:
    """Return a table of the class `Exit`, whose comments explain each code."""
    lines = (ROOT / "src/construction_twin/views/arguments.py").read_text().splitlines()
    rows, comment = [], ""
    for line in lines[lines.index("class Exit(enum.IntEnum):") :]:
        if line.strip().startswith("#:"):
            comment = line.strip()[2:].strip()
        elif found := re.fullmatch(r"    ([A-Z_]+) = (\d+)", line):
            meaning = comment or found[1].lower().replace("_", " ")
            rows.append(f"| {found[2]} | {_cell(meaning)} |")
            comment = ""
    return "\n".join(["| exit code | meaning |", "|---|---|", *rows, ""])


# -- state machines


def state_rows(module: str) -> list[tuple[str, ...]]:
    """Return a state machine's table in words, as its module has it: state, event, guard, action, next state.

    States with the same row share one; "any" stands for all of them.
    """
    return _shared_rows(cells(importlib.import_module(module).TABLE))


def _shared_rows(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    states = list(dict.fromkeys(row[0] for row in rows))
    shared: dict[tuple[str, ...], list[str]] = {}
    for state, *rest in rows:
        shared.setdefault(tuple(rest), []).append(state)
    return [("any" if len(of) == len(states) else ", ".join(of), *rest) for rest, of in shared.items()]


def _state_table(module: str) -> str:
    return _rows_table(state_rows(module))


def _rows_table(rows: Sequence[tuple[str, ...]]) -> str:
    columns = ["state", "event", "guard", "action", "next state"]
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    return "\n".join([*lines, *(f"| {' | '.join(map(_cell, row))} |".replace("|  |", "| |") for row in rows), ""])


PARTS: dict[str, Callable[[], str]] = {
    "launch arguments": _launch_page,
    "parameters": _parameter_page,
    "gateway settings": _gateway_table,
    "commands": _command_page,
    "exit codes": _exit_codes,
    "messages": _message_page,
    "gateway states": lambda: _state_table("construction_twin.gateway.states"),
    "link states": lambda: _state_table("construction_twin.link.states"),
    "bare link states": lambda: _rows_table(_shared_rows(cells(BARE_TABLE))),
    "executor states": lambda: _state_table("construction_twin.execution.states"),
    "goal states": lambda: _state_table("construction_twin.execution.goal_states"),
    "monitor states": lambda: _state_table("construction_twin.monitor.states"),
    "work states": lambda: _state_table("construction_twin.work.task_states"),
}


def pages() -> Iterator[tuple[Path, str]]:
    """Yield each page of docs/reference that has a generated part, and the schemas, with the text that they ought to have."""
    written = set()
    for path in sorted(REFERENCE.glob("*.md")):
        text = path.read_text()
        kinds = [kind for _, kind, _ in _PART.findall(text)]
        if kinds:
            written.update(kinds)
            yield path, _PART.sub(lambda part: f"{part[1]}\n{PARTS[part[2]]()}\n{part[3]}", text)
    if written != set(PARTS):
        raise SystemExit(f"no page has the part {', '.join(sorted(set(PARTS) - written))}")
    yield REFERENCE / "view.schema.json", schemas.view_schema()
    yield ROOT / "web/src/schemas.js", schemas.page_schemas()


def main(arguments: list[str]) -> int:
    """Write or check the pages; return the exit code: 1 when a check finds a difference."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 when a page is out of date")
    options = parser.parse_args(arguments)
    changed = []
    for path, text in pages():
        if not path.exists() or path.read_text() != text:
            changed.append(path.name)
            if not options.check:
                path.write_text(text)
    print(f"changed: {', '.join(changed) or 'none'}")
    return 1 if options.check and changed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
