"""The documents say what the code does.

Every name a user can reach is written down, every link, file, command and quoted message exists, and what is written from the code
is up to date.
"""

from __future__ import annotations

import ast
import configparser
import dataclasses
import importlib
import json
import math
import re
import subprocess
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import make_reference
import pydantic
import pytest
import yaml
from evaluation_samples import run
from gateway_cell import following

from construction_twin.broker.access import PLC, PROGRAMS, RIGHTS, ROLES, Grant, Person, Site, access_rules
from construction_twin.core.state_table import cells
from construction_twin.evaluation.summary import evaluate, summarise
from construction_twin.execution.states import TABLE, ExecutorEvent, ExecutorState
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.states import Mode, State
from construction_twin.link import remote_trajectory
from construction_twin.link.bare_supervisor import NOT_CHECKED
from construction_twin.link.remote_review import ClearanceView, PlanView, SegmentView, SwitchView, UseView
from construction_twin.link.states import LinkState
from construction_twin.link.status_values import status_values
from construction_twin.monitor.comparison import ComparisonSettings, undetected
from construction_twin.monitor.states import SyncEvent, SyncState
from construction_twin.mqtt.account import Account
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import REVIEW, TRAJECTORY
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.shared import stop_memory
from construction_twin.ros.shared.ports import Interface

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "src/construction_twin"
SENTENCES = PACKAGE / "core/sentences.json"
NODE_MODULES = PACKAGE / "ros/nodes"
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "krl/README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
GUIDES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs/tutorials").glob("*.md")),
    *sorted((ROOT / "docs/de").rglob("*.md")),
]
PAGES = {page.stem: page.read_text() for page in sorted((ROOT / "docs/reference").glob("*.md"))}
REFERENCE = "\n".join(PAGES.values())
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text()
README = (ROOT / "README.md").read_text()
BROKER = (ROOT / "docs/broker.md").read_text()
TROUBLESHOOTING = (ROOT / "docs/troubleshooting.md").read_text()


def relative(file: Path) -> str:
    return str(file.relative_to(ROOT))


def code_words(text: str) -> set[str]:
    """Return the names in code spans, also where several stand in one."""
    return {word for span in re.findall(r"`([^`\n]+)`", text) for word in re.split(r"[\s,:\[\]]+", span)}


CODE_WORDS = code_words(REFERENCE)
NODES = [
    *sorted(p for p in NODE_MODULES.glob("*.py") if p.stem != "__init__"),
    ROOT / "examples/separation/separation_node.py",
]


def node_module(file: Path) -> ModuleType:
    return importlib.import_module(
        file.stem if file.parent.name == "separation" else f"construction_twin.ros.nodes.{file.stem}"
    )


def declared(file: Path) -> tuple[set[str], set[str], set[str]]:
    """Return what a node reads, gives and serves, private names with the node's name in front."""
    interface = getattr(node_module(file), "INTERFACE", Interface())
    reads = {each.topic for each in (*interface.reads, *interface.hears)} | set(interface.listeners)
    gives, serves = {each.topic for each in interface.publishes}, {each.name for each in interface.serves}
    node = file.stem.removesuffix("_node")
    reads, gives, serves = ({name.replace("~", f"{node}/") for name in names} for names in (reads, gives, serves))
    return reads, gives, serves


def ros_names(file: Path) -> set[str]:
    """Return the topics and services of a node, private ones with the node's name in front."""
    return set().union(
        *declared(file), re.findall(r"(?:ServiceProxy|PersistentService)\(\s*\"([^\"]+)\"", file.read_text())
    )


def table_of_nodes() -> dict[str, tuple[set[str], set[str], set[str]]]:
    """Return what the table says that a node reads, gives and serves: names before the first semicolon, without what it calls."""
    section = PAGES["topics"].split("\n## Nodes\n")[1].split("\n### ")[0]
    found = {}
    for row in re.findall(r"^\| (`.*)\|$", section, re.MULTILINE):
        nodes, *cells = row.split("|")
        names = [set(re.findall(r"`([^`]+)`", re.split("; |calls ", cell)[0])) for cell in cells]
        for node in re.findall(r"`([^`]+)`", nodes):
            found[node] = tuple({name.replace("~", f"{node}/") for name in cell} for cell in names)
    return found


def undocumented(names) -> list[str]:
    return sorted(set(names) - CODE_WORDS)


# -- what is written from the code


def test_scan_of_the_code_finds_what_is_there():
    found = set().union(*map(ros_names, NODES))
    assert {"plan", "command/joint_states", "mock_rsi/status", "review_plan", "mqtt_bridge/arm"} <= found


@pytest.mark.parametrize("file", NODES, ids=lambda file: file.stem)
def test_topics_and_services_are_documented(file):
    assert undocumented(ros_names(file)) == []


@pytest.mark.parametrize("file", sorted((ROOT / "config").glob("*.yaml")), ids=lambda file: file.stem)
def test_configuration_keys_are_documented(file):
    assert undocumented(yaml.safe_load(file.read_text())) == []


@pytest.mark.parametrize("file", NODES, ids=lambda file: file.stem)
def test_the_table_of_nodes_is_what_they_declare(file):
    module = node_module(file)
    if hasattr(module, "NODE"):
        assert table_of_nodes()[module.NODE.name] == declared(file)


@pytest.mark.parametrize("file", NODES, ids=lambda file: file.stem)
def test_parameters_are_documented(file):
    module = node_module(file)
    models = [
        value for value in vars(module).values() if isinstance(value, type) and issubclass(value, pydantic.BaseModel)
    ]
    assert undocumented(name for model in models for name in model.model_fields) == []


@pytest.mark.parametrize("file", sorted((ROOT / "launch").glob("*.launch")), ids=lambda file: file.stem)
def test_launch_arguments_are_documented(file):
    assert undocumented(arg.get("name") for arg in ElementTree.parse(file).getroot().findall("arg")) == []


@pytest.mark.parametrize("file", sorted((ROOT / "nodes").iterdir()), ids=lambda file: file.name)
def test_executables_have_a_heading(file):
    assert re.search(rf"^##+ .*\b{file.name}\b|`{file.name}[ `]", REFERENCE, re.MULTILINE)


def test_gateway_interface_is_documented():
    topics = [value for value in vars(Topics).values() if isinstance(value, property)]
    assert undocumented(topic.fget(Topics("twin", "kr120")) for topic in topics) == []
    assert undocumented(field.name for field in dataclasses.fields(GatewayConfig)) == []
    assert undocumented(state.value for state in State) == []


def test_gateway_status_is_documented():
    status = following().gateway.status()
    assert undocumented(status) == []
    assert undocumented([*status["playout"], *status["intruder"]]) == []
    assert undocumented(status_values(status)) == []
    assert undocumented(mode.value for mode in Mode) == []


def test_gateway_counters_are_documented():
    code = "".join(file.read_text() for file in sorted((PACKAGE / "gateway").glob("*.py")))
    # a refusal is documented by its reason
    counters = re.findall(r"counters\[\"(\w+)\"", code)
    refused = r"(?:PayloadError|MotionRefused|refusals\.\w+|_refuse)\(\s*\"(\w+)\""
    reasons = re.findall(refused, code)
    assert {"settling", "cycles_without_command"} <= set(counters)
    assert {"duplicate", "lead", "repeated", "verb", "source", "retained"} <= set(reasons)
    assert undocumented([*counters, *reasons, "arm", "stop", "reset", "end"]) == []


def test_keys_of_plan_review_and_account_files_are_documented():
    records = (PlanView, ClearanceView, UseView, SegmentView, SwitchView)
    keys = {*REVIEW.answer, *(field.name for record in records for field in dataclasses.fields(record))}
    keys |= {field.name for field in dataclasses.fields(Account)} - {"name"}
    assert sorted(keys - code_words(BROKER)) == []


def test_keys_of_a_remote_trajectory_its_answer_and_the_view_are_documented():
    words, schema = (
        code_words((ROOT / "docs/reference/mqtt.md").read_text()),
        json.loads((ROOT / "docs/reference/view.schema.json").read_text()),
    )
    keys = {
        *TRAJECTORY.answer,
        *schema["properties"],
        *schema["properties"]["twin"]["properties"],
    }
    for part in ("sync", "link", "execution"):
        keys |= set(schema["properties"][part]["properties"])
    keys |= set(remote_trajectory.KEYS)
    assert sorted(keys - words) == []


def test_what_is_not_checked_with_a_bare_plc_is_documented_word_for_word():
    table = BROKER.split("| not checked | so |")[1].split("\n\n")[0]
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", table, re.MULTILINE)
    assert tuple(sentence for sentence, _ in rows) == NOT_CHECKED and all(so.strip() for _, so in rows)


def topics_of(rules: str) -> set[str]:
    """Return the topics of the access rules from one template, as documents write them."""
    people = {f"{role}s": ("ada",) for role in ROLES}
    # all rights, also those that no role has
    ada = Person("ada", (Grant(RIGHTS),))
    site = Site(hosts=("b",), robots=("r",), folder="/f", plc=True, persons=(ada,), **people)
    template = (ROOT / f"config/mosquitto/{rules}.acl").read_text()
    text = access_rules(site, lambda name: template if name == f"{rules}.acl" else "")
    topics = re.findall(r"^topic \w+ twin/r/(\S+)$", text, re.MULTILINE)
    return {re.sub(r"\b(r-\w+-)?ada(-device)?$", "<account>", topic) for topic in topics} - {"#"}


def documented_requests() -> dict[str, set[str]]:
    """Return the topics that each right writes, by the table of topics."""
    rows = re.findall(r"^\| ([^|]+) \| [^|]*right `(\w+)` \|", PAGES["mqtt"], re.MULTILINE)
    found: dict[str, set[str]] = {right: set() for right in RIGHTS}
    for topics, right in rows:
        found[right] |= {topic.removeprefix("twin/kr120/") for topic in code_words(topics)}
    return found


def test_rights_and_their_topics_are_documented():
    table = BROKER.split("| right | what for |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == set(RIGHTS)
    assert documented_requests() == {right: topics_of(f"right_{right}") for right in RIGHTS}


def test_roles_and_their_rights_are_documented():
    table = BROKER.split("| role | rights |")[1].split("\n\n")[0]
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", table, re.MULTILINE))
    assert {role: code_words(row) for role, row in rows.items()} == {
        role: set(rights) for role, rights in ROLES.items()
    }


def test_programs_and_their_topics_are_documented():
    table = BROKER.split("| program | account |")[1].split("\n\n")[0]
    rows = dict(re.findall(r"^\| (\w+)(?: \(`--plc`\))? \| `kr120-\w+` \| (.*) \|$", table, re.MULTILINE))
    written = {program: code_words(row) for program, row in rows.items()}
    assert "the answers to every request" in rows["bridge"] and "every request of an account" in rows["bridge"]
    answers = set(re.findall(r"`twin/kr120/(\S+/ack(?:/<account>)?)` \| [^|]*\bmqtt_", PAGES["mqtt"]))
    requests = set().union(*documented_requests().values(), answers)
    written["bridge"] |= {topic.replace("<account>", "+") for topic in requests}
    assert written == {program: topics_of(program) for program in (*PROGRAMS, PLC)}


@pytest.mark.parametrize(
    "file",
    [
        "gateway/command_line",
        "mock/program",
        "ros/commands/evaluate",
        "ros/commands/export_gateway_config",
        "broker/start",
        "broker/make_site",
        "console/command_line",
        "ros/commands/new_arm",
        "ros/commands/scenario",
        "views/ik_report",
        "scene/self_collision_command",
        "views/arguments",
    ],
)
def test_command_line_options_are_documented(file):
    text = (PACKAGE / f"{file}.py").read_text()
    options = re.findall(r"(?:add_argument|option|add)\(\s*\"(--[a-z-]+)\"", text)
    assert options
    printed = "\n".join(re.findall(r"^```text\n(.*?)^```", PAGES["command_line"], re.MULTILINE | re.DOTALL))
    assert [option for option in options if not re.search(rf"{option}(?![a-z-])", printed)] == []


def test_keys_of_the_summary_are_documented():
    assert undocumented(summarise(evaluate(run()))) == []


def test_reference_is_what_the_code_says():
    stale = [page.name for page, text in make_reference.pages() if page.read_text() != text]
    assert stale == [], "run python scripts/make_reference.py"


@pytest.mark.parametrize("node", make_reference.NODES)
def test_every_node_with_parameters_has_its_table(node):
    assert re.search(rf"^### {node}$", PAGES["parameters"], re.MULTILINE)


def test_every_class_of_parameters_is_in_the_reference():
    modules = {module.rsplit(".", 1)[-1] for module, _ in make_reference.NODES.values()}
    for file in NODES:
        has_settings = re.search(r"^class Settings\(", file.read_text(), re.MULTILINE)
        assert not has_settings or file.stem in modules, f"add {file.stem} to make_reference.NODES"


def test_parameters_of_the_namespace_are_in_its_table():
    table = PAGES["parameters"].split("## Parameters of the namespace")[1].split("| key of `robot`")[0]
    rows = set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE))
    code = "".join(file.read_text() for file in sorted((PACKAGE / "ros").rglob("*.py")))
    # without a slash or ~: relative to the robot's namespace; `publishers` stands behind any namespace
    read = set(re.findall(r"get_param\(f?\"(?:\{\w+\})?(\w+)\"", code))
    interfaces = (getattr(node_module(file), "INTERFACE", Interface()) for file in NODES)
    declared_ones = {each.name for interface in interfaces for each in interface.parameters}
    assert "publishers" in read and {mqtt_bridge.WAITS, stop_memory.PARAMETER} <= declared_ones
    assert sorted((read | declared_ones) - rows) == ["/run_id"]


# -- states


@pytest.mark.parametrize("states", [SyncState, ExecutorState, LinkState], ids=lambda states: states.__name__)
def test_states_are_explained(states):
    words = set(re.findall(r"[A-Z_]{4,}", PAGES["states"]))
    assert {state.name for state in states} <= words


def test_gateway_states_and_events_are_explained():
    """Explained by hand, in the first column of a table; the generated tables hold every word anyway."""
    explained = code_words("\n".join(re.findall(r"^\| (`[^|]*`) \|[^|]*\|$", PAGES["states"], re.MULTILINE)))
    events = {event.value for kind in (SyncEvent, ExecutorEvent) for event in kind}
    assert {state.value for state in State} | events <= explained


def test_rows_that_states_share_keep_the_order_in_which_guards_are_asked():
    shared = make_reference.state_rows("construction_twin.execution.states")
    asked = [(state, row[1], row[2:]) for row in shared for state in row[0].split(", ")]
    rows = cells(TABLE)
    for state, event in {(row[0], row[1]) for row in rows}:
        expected = [tuple(row[2:]) for row in rows if (row[0], row[1]) == (state, event)]
        assert [rest for of, on, rest in asked if (of, on) == (state, event)] == expected


def test_largest_undetected_difference_is_that_of_the_shipped_settings():
    robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    shipped = yaml.safe_load((ROOT / "config/pca_monitor.yaml").read_text())
    assert shipped["lag_margin"] <= 0.02
    settings = ComparisonSettings(
        threshold=(shipped["threshold"],) * len(robot.velocity),
        lag_allowance=shipped["lag_allowance"],
        lag_margin=shipped["lag_margin"],
    )
    in_motion, at_first = undetected(settings, robot.velocity), undetected(settings, robot.velocity, known=False)
    rows = [
        f"| A{number} | {math.degrees(speed):.0f} | {math.degrees(later):.2f} | {math.degrees(first):.2f} |"
        for number, speed, later, first in zip(range(1, 7), robot.velocity, in_motion, at_first)
    ]
    assert [row for row in rows if row not in PAGES["states"]] == []


# -- the folders


def folder_table() -> dict[str, set[str]]:
    """Return the folders of docs/architecture.md in its order, with what each may import."""
    rows = re.findall(r"^\| `(\w+)`(?: \*)? \|.*\| ([^|]*) \|$", ARCHITECTURE, re.MULTILINE)
    return {folder: set(re.findall(r"`(\w+)`", imports)) for folder, imports in rows}


def imported_folders(folder: str) -> set[str]:
    """Return the folders of the package that a folder's modules import, anywhere in their code."""
    found = set()
    for file in (PACKAGE / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found |= {name.split(".")[1] for name in names if name.startswith("construction_twin.")}
    return found - {folder, "msg", "srv"}


def test_folders_of_the_architecture_are_those_of_the_contract_and_of_the_disk():
    contract = configparser.ConfigParser()
    contract.read(ROOT / ".importlinter")
    order = contract["importlinter:contract:order"]["layers"].split()
    assert list(folder_table()) == order[::-1]
    inside = contract["importlinter:contract:ros"]["layers"].split()
    assert f"order is {', '.join(f'`{folder}`' for folder in inside[::-1])}," in " ".join(ARCHITECTURE.split())
    for parent, folders in ((PACKAGE, order), (PACKAGE / "ros", inside)):
        real = {file.parent.name for file in parent.glob("*/__init__.py")}
        assert real == set(folders)
    drawn = ARCHITECTURE[ARCHITECTURE.index("```") : ARCHITECTURE.index("The table goes")]
    assert set(order) <= set(re.findall(r"\w+", drawn))


@pytest.mark.parametrize("folder", [folder for folder in folder_table() if folder != "ros"])
def test_a_folder_imports_what_the_architecture_says(folder):
    assert imported_folders(folder) <= folder_table()[folder]


@pytest.mark.parametrize("folder", [folder for folder in folder_table() if folder not in ("core", "ros")])
def test_a_folder_says_itself_what_it_may_import(folder):
    paragraph = " ".join((ast.get_docstring(ast.parse((PACKAGE / folder / "__init__.py").read_text())) or "").split())
    said = set(re.findall(r"``(\w+)``", paragraph[paragraph.index("May import") :]))
    assert said == folder_table()[folder]


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("__init__.py")), ids=relative)
def test_a_folder_s_init_holds_its_paragraph_and_its_exports_and_nothing_else(file):
    code = ast.parse(file.read_text())
    paragraph = " ".join((ast.get_docstring(code) or "").split())
    assert file.parent == PACKAGE or all(word in paragraph for word in ("In:", "Out:", "ay import"))
    if len(code.body) == 1:
        return
    folder = ".".join(("construction_twin", *file.parent.relative_to(PACKAGE).parts))
    *imports, names = code.body[1:]
    assert [ast.unparse(line) for line in imports] == [
        "from typing import TYPE_CHECKING",
        "from construction_twin.core.exports import lazy_exports",
    ]
    assert isinstance(names, ast.If) and ast.unparse(names.test) == "TYPE_CHECKING"
    assert list(map(ast.unparse, names.orelse)) == ["__getattr__, __dir__, __all__ = lazy_exports(__name__)"]
    for line in names.body:
        # from the folder's own modules, each under its own name
        assert isinstance(line, ast.ImportFrom) and (line.module or "").rpartition(".")[0] == folder
        assert all(alias.asname == alias.name for alias in line.names)


@pytest.mark.parametrize("folder", [folder for folder in folder_table()])
def test_inside_the_package_names_come_from_their_modules(folder):
    """An import from a folder's `__init__` would hide which module needs which, and load it late."""
    folders = {
        ".".join(("construction_twin", *f.parent.relative_to(PACKAGE).parts)) for f in PACKAGE.rglob("__init__.py")
    }
    for file in sorted((PACKAGE / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module in folders:
                modules = {path.stem for path in (PACKAGE.parent / node.module.replace(".", "/")).iterdir()}
                assert {alias.name for alias in node.names} <= modules | {"msg", "srv"}, (
                    f"{relative(file)}: {node.module}"
                )


# -- what documents name


@pytest.mark.parametrize("file", DOCUMENTS, ids=relative)
def test_relative_links_lead_somewhere(file):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)", file.read_text()):
        path = (file.parent / target).resolve() if target else file
        assert path.exists(), f"{file.name} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}
            slugs |= set(re.findall(r"^<a id=\"([^\"]+)\"></a>", path.read_text(), re.MULTILINE))
            assert anchor in slugs, f"{file.name} links to {target}#{anchor}"


@pytest.mark.parametrize("file", [file for file in DOCUMENTS if file.name != "rsi.md"], ids=relative)
def test_source_files_in_documents_exist(file):
    named = {name for name in re.findall(r"`((?:[\w.]+/)+[\w]+\.(?:py|yaml|xml|launch))`", file.read_text())}
    assert (
        sorted(name for name in named if not any((base / name).exists() for base in (ROOT, PACKAGE, ROOT / "krl")))
        == []
    )


def test_every_document_is_reached_from_the_readme():
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached or page.suffix != ".md":
            continue
        reached.add(page)
        links = re.findall(r"\]\((?!https?:)([^)#\s]+)", page.read_text())
        waiting += [(page.parent / link).resolve() for link in links]
    assert sorted(map(relative, set(DOCUMENTS) - reached)) == []


def test_nothing_cites_a_document_that_a_reader_cannot_open():
    elsewhere = "|".join(
        (
            "design" + r"\.md",
            "paper" + r"\.txt",
            "shared" + "/",
            "house" + r"\.md",
            r"(?<!docs/)(?<!/)\brsi" + r"\.md",
            r"\bdesign, " + "(?:law|section)",
        )
    )
    said = []
    for folder in (
        "src",
        "nodes",
        "launch",
        "config",
        "urdf",
        "krl",
        "docs",
        "scripts",
        "setup",
        "tools",
        "examples",
        "benchmarks",
        "test",
    ):
        for file in sorted((ROOT / folder).rglob("*")):
            if file.suffix in (".py", ".md", ".yaml", ".launch", ".xacro", ".sh", ".src", ".xml") and file != Path(
                __file__
            ):
                # pages beside each other link without the folder
                text = re.sub(r"\]\([^)]*\)", "", file.read_text().replace("[rsi.md]", "]"))
                text = text.replace("ros/shared/", "")
                said += [f"{relative(file)}: {found}" for found in re.findall(elsewhere, text)]
    assert said == []


def test_documents_named_outside_of_the_documents_exist():
    folders = "src test scripts benchmarks tools examples config launch urdf krl msg srv nodes setup".split()
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--", *folders], cwd=ROOT, capture_output=True, check=True, text=True
    )
    named = 0
    missing = []
    for name in filter(None, listed.stdout.split("\0")):
        try:
            text = (ROOT / name).read_text()
        except (UnicodeDecodeError, FileNotFoundError):
            continue  # a picture or mesh; a file that was just removed
        cited = re.findall(r"\bdocs/[\w/.-]*?\.md\b", text)
        named += len(cited)
        missing += [f"{name}: {document}" for document in cited if not (ROOT / document).is_file()]
    assert named > 50
    assert missing == []


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {name for file in DOCUMENTS for name in re.findall(r"(?:`|^)make ([a-z]+)", file.read_text(), re.MULTILINE)}
    assert {"demo", "test"} <= named <= targets
    assert targets - named - {"help"} == set()


def commands(file: Path) -> str:
    """Return a document with the lines of its commands joined."""
    return file.read_text().replace("\\\n", " ")


@pytest.mark.parametrize("file", GUIDES, ids=relative)
def test_services_called_in_documents_exist(file):
    known = set().union(*map(ros_names, NODES))
    called = re.findall(r"rosservice call /(?:kr120|ur_like)/(\S+?)[\s`]", file.read_text() + "\n")
    assert set(called) <= known


def launch_file(name: str) -> Path:
    """Return where roslaunch finds a launch file of this package."""
    own, moveit = ROOT / f"launch/{name}.launch", ROOT / f"moveit/launch/{name}.launch"
    return moveit if moveit.exists() and not own.exists() else own


@pytest.mark.parametrize("file", GUIDES, ids=relative)
def test_programs_and_launch_arguments_in_documents_exist(file):
    programs = re.findall(r"rosrun construction_twin ([a-z_]+)", commands(file))
    assert set(programs) <= {path.name for path in (ROOT / "nodes").iterdir()}
    for name, rest in re.findall(r"roslaunch construction_twin (\w+)\.launch([^\n`#]*)", commands(file)):
        known = make_reference.launch_arguments(launch_file(name))
        if name in ("experiment", "scenario", "two_robots"):
            known = known | make_reference.launch_arguments(ROOT / "launch/bringup.launch")
        assert set(re.findall(r"(\w+):=", rest)) <= set(known)


def test_readme_calls_what_a_newcomer_needs():
    words = (
        "bringup.launch",
        "twin plan",
        "twin approve",
        "twin watch",
        "make demo",
        "make test",
        "source .ws/env.bash",
    )
    assert [word for word in words if word not in README] == []


def test_messages_in_the_troubleshooting_are_the_programs_own():
    """Own sentences only: what ROS or Python says cannot be looked up here."""
    foreign = ("No module named", "rospy", "is neither a launch file", "Couldn't find executable", "media_export")
    files = [*(ROOT / "src").rglob("*.py"), SENTENCES, *(ROOT / "setup").glob("*.sh"), *(ROOT / "scripts").glob("*")]
    code = "".join(file.read_text() for file in files if file.is_file())
    code = re.sub(r"\"\s*f?\"", "", code)  # a sentence may be written in several pieces
    code = re.sub(r"\{[^{}\n]*\}", "*", code)
    quotes = re.findall(r"`([^`]+)`", "\n".join(re.findall(r"^## (.*)$", TROUBLESHOOTING, re.MULTILINE)))
    assert len(quotes) > 20
    for quote in quotes:
        if not any(part in quote for part in foreign):
            # numbers and names in the document stand where the code has a placeholder
            assert quote in code or re.search(as_template(quote), code), quote


def as_template(quote: str) -> str:
    """Return a pattern for a message whose numbers may be placeholders in the code."""
    return re.sub(r"TCP|18830|MQTT\\ broker", lambda found: rf"(?:\*|{found.group()})", re.escape(quote))


def test_every_package_earns_its_place():
    text = (ROOT / "docs/dependencies.md").read_text()
    for name in ("requirements.txt", "requirements-no-deps.txt", "debian-packages.txt", "debian-test-packages.txt"):
        lines = (ROOT / "setup" / name).read_text().splitlines()
        packages = [line.split("==")[0].strip() for line in lines if line.strip() and not line.startswith("#")]
        assert [package for package in packages if f"`{package}`" not in text] == []


def test_readme_stays_short():
    assert len(README.splitlines()) <= 120
    assert [line for line in README.splitlines() if len(line) > 100] == []
