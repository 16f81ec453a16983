"""What version 0.1.0 has written is read with the same meaning, or refused in one sentence; its messages are told apart."""

from __future__ import annotations

import json
import math
import re
import shutil
from itertools import count
from pathlib import Path

import pytest
import yaml
from construction_twin.msg import Link, Sync, WorkTasks
from gateway_cell import Cell
from supervisor_bench import HASH, bench  # noqa: F401 (a fixture)

from construction_twin.broker.make_site import main as make_site
from construction_twin.core.errors import ConstructionTwinError
from construction_twin.execution.engagement import from_text
from construction_twin.gateway.config import parse_config
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import read_trace
from construction_twin.link.states import LinkState
from construction_twin.mqtt.account import load_account
from construction_twin.mqtt.messages import PROTOCOL, parse_control, parse_status, protocol_of
from construction_twin.review.chained_file import verify
from construction_twin.review.record import ReviewLog, read_fate
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.tool import read_tool
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.ros.shared.known_bag import open_bag
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.events import Entry
from construction_twin.work.ledger import Ledger
from construction_twin.work.recipes import read_recipes
from construction_twin.work.site import CellFile
from construction_twin.work.task_states import TaskState

ROOT = Path(__file__).parents[3]
OLD = ROOT / "test/data/written_by_4beb2eb"
URDF = ROOT / "urdf/kr120r2500.urdf.xacro"
#: Hashes that version 0.1.0 computes of its scenes: plans and engagements name them.
SCENES = {
    "config_scene.yaml": "057e9d71ff56a79a88e2e7b0117e1428a66bbc171653cc2192c11f432aaa0ba3",
    "brick_wall": "4de50e9af3eb3a91a1dd1db1aecdc0125f6ff0fd34d344688ef3c5c450e93099",
    "timber_panel": "285dd41b8e09b1422f766788f1f93bae2e63ca1aa546fc10604e212494195ba1",
}
SAID = json.loads((OLD / "messages.json").read_text())


@pytest.fixture
def folder(tmp_path) -> Path:
    """A copy, as private as its writer had made it."""
    shutil.copytree(OLD, tmp_path / "old")
    for path in (tmp_path / "old/site").rglob("*"):
        path.chmod(0o700 if path.is_dir() else 0o600)
    return tmp_path / "old"


def robot():
    return read_robot_files(URDF, OLD / "config_kr120.yaml")


class TestFiles:
    def test_a_site_made_again_keeps_passwords_keys_and_ca(self, folder, capsys):
        site = folder / "site"
        kept = [
            p
            for p in site.rglob("*")
            if p.name in ("password", "passwords", "ca.key", "ca.crt", "server.key", "server.crt")
        ]
        before = {path: path.read_bytes() for path in kept}
        rules = (site / "broker/access.acl").read_text()
        make_site([str(site), "--broker-folder", str(site / "broker")])
        assert len(before) >= 10 and {path: path.read_bytes() for path in kept} == before
        # torques, currents, the path of what is played, messages and cameras, and what people may be given the right to, are new
        made = (site / "broker/access.acl").read_text().splitlines()
        given = ("reset", "arm", "answer", "acknowledge", "speed", "override_rehearsal")
        asked = [f"topic read twin/kr120/{verb}/+" for verb in given]
        answered = [f"topic write twin/kr120/{verb}/ack" for verb in given]
        kept_ones = [f"topic readwrite twin/kr120/{topic}" for topic in ("rehearsal", "path", "messages", "camera/+")]
        told = [f"topic {right} twin/kr120/{name}" for right in ("write", "read") for name in ("torque", "current")]
        new = [*kept_ones, *told, *asked, *answered]
        kept = [line for line in made if line not in new and not line.startswith("#")]
        assert kept == [line for line in rules.splitlines() if not line.startswith("#")] and set(new) <= set(made)
        assert "connection_messages false" in (site / "broker/mosquitto.conf").read_text()

    def test_accounts_are_read(self, folder):
        account = load_account(folder / "site/accounts/kr120-bridge/account.json")
        assert account.user == "kr120-bridge" and Path(account.password_file).is_file()

    def test_the_exported_configuration_is_read_and_is_the_one_that_is_exported_now(self):
        read = parse_config((OLD / "gateway.json").read_text(), "gateway.json")
        settings = yaml.safe_load((OLD / "config_gateway.yaml").read_text())
        now = gateway_config(robot(), settings | {"decimals": 3, "properties": True})
        assert read == now and read.hash == now.hash

    def test_the_record_of_verdicts_is_whole_and_goes_on(self, folder):
        path = folder / "kr120_reviews.jsonl"
        old = verify(path)
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        approved = next(line for line in lines if line.get("verdict") == "approved")
        assert approved["reviewer"] == "Ada" and read_fate(path, approved["plan"]).outcome == "finished"
        log = ReviewLog(path, lambda: 1_790_000_001_000_000_000)
        log.close()
        assert verify(path).lines >= old.lines >= 3

    def test_the_engagement_is_read(self):
        engagement = from_text("file", (OLD / "kr120_engagement.json").read_text(), robot().joint_names)
        written = json.loads((OLD / "kr120_engagement.json").read_text())
        assert (engagement.plan_id, engagement.segment) == (written["plan"], written["segment"])
        assert engagement.path.trajectory.duration == written["waypoints"][-1][0] and engagement.holding

    def test_the_ledger_keeps_what_stands_and_who_accepted(self, folder):
        times = count(1_790_000_001_000_000_000)
        after = {"plate": (), "stud": ("plate",)}
        path = folder / "kr120_panel.jsonl"
        ledger = Ledger(path, after, "a" * 64, lambda: next(times), "/cell.yaml", {"E1": "plate"})
        plate = ledger.book.tasks["plate"]
        assert (plate.state, plate.placed, plate.base_T_element[:3]) == (TaskState.DONE, True, (1.0, 2.0, 0.5))
        assert ledger.book.accepted == "5c" * 32 and ledger.book.in_state(TaskState.READY) == ("stud",)
        ledger.add(Entry("offered", "stud", "E2", offer="o2"))
        ledger.close()
        assert verify(path).lines == 11

    def test_a_trace_is_read_without_lost_replies(self):
        entries = read_trace(str(OLD / "gateway.trace"))
        assert len(entries) > 90 and not any(entry.lost for entry in entries)
        assert {later.time_since(earlier) for earlier, later in zip(entries, entries[1:])} == {4}
        assert entries[-1].state is State.FOLLOWING and entries[-1].position != entries[0].position

    def test_a_bag_s_streams_are_read_and_what_has_another_form_is_refused_in_a_sentence(self):
        with open_bag(OLD / "kr120.bag", (Link, Sync)) as bag:
            said = [message for _, message, _ in bag.read_messages(topics=["/kr120/link", "/kr120/sync"])]
        assert [m.text for m in said if isinstance(m, Link)] == ["ARMED"] * 5
        assert [m.error for m in said if isinstance(m, Sync)] == [(0.001,)] * 5
        with (
            pytest.raises(ConstructionTwinError, match="WorkTasks") as caught,
            open_bag(OLD / "kr120.bag", (WorkTasks,)) as bag,
        ):
            list(bag.read_messages(topics=["/kr120/work_tasks"]))
        assert "\n" not in str(caught.value)

    def test_robot_scene_and_work_files_are_read(self):
        written = yaml.safe_load((OLD / "config_kr120.yaml").read_text())["joints"]
        degrees = [joint["acceleration_deg_s2"] for joint in written.values()]
        assert robot().acceleration == pytest.approx([math.radians(value) for value in degrees])
        assert read_self_collision(OLD / "config_kr120_self_collision.yaml", robot())
        assert read_scene(OLD / "config_scene.yaml").hash == SCENES["config_scene.yaml"]
        assert read_tool(OLD / "config/tools/vacuum_frame.yaml").tool.name
        recipes = read_recipes(OLD / "config/work/recipes.yaml")
        assert list(recipes.recipes) == list(yaml.safe_load((OLD / "config/work/recipes.yaml").read_text())["recipes"])
        for name in ("brick_wall", "timber_panel"):
            document = yaml.safe_load((OLD / f"config/work/{name}.yaml").read_text())
            assert CellFile.model_validate(document)
            assert read_scene(OLD / f"config/work/{name}_scene.yaml").hash == SCENES[name]


class TestMessages:
    def test_what_the_old_gateway_says_is_of_protocol_1_and_never_armed(self, bench):  # noqa: F811
        for said in (message["payload"] for message in SAID if message["topic"] == "status"):
            status = parse_status(json.dumps(said).encode())
            assert protocol_of(status) == 1
            bench.gateway = status | {"hash": HASH, "decimals": 3}
            bench.run(1.0)
            assert bench.state is LinkState.MISMATCH and bench.sent == []
            assert re.search(
                r"gateway speaks protocol 1, the bridge 2: the gateway is older: install .* on the cell PC",
                bench.supervisor.reason,
            )

    @pytest.mark.parametrize("verb", ["arm", "reset"])
    def test_what_the_old_bridge_sends_is_refused_and_says_where_to_install(self, verb):
        cell = Cell()
        cell.cycle()
        old = next(m["payload"] for m in SAID if m["topic"] == "control" and m["payload"]["verb"] == verb)
        control = parse_control(json.dumps(old).encode())
        answer = cell.gateway.on_control(control, cell.now)
        assert not answer.ok and "bridge is older: install the other's version on the ROS PC" in answer.reason
        assert cell.state is State.READY and cell.gateway.status()["protocol"] == PROTOCOL

    def test_a_stop_of_any_version_is_carried_out(self):
        cell = Cell()
        cell.cycle()
        cell.arm()
        old = next(m["payload"] for m in SAID if m["topic"] == "control" and m["payload"]["verb"] == "stop")
        assert cell.gateway.on_control(parse_control(json.dumps(old).encode()), cell.now).ok
        assert cell.gateway.fault
