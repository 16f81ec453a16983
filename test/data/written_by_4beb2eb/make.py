"""Writes the files of this folder anew, by the programs of version 0.1.0: run in a built checkout of commit 4beb2eb.

cd CHECKOUT; source .ws/env.bash; python .../test/data/written_by_4beb2eb/make.py FOLDER
"""

from __future__ import annotations

import json
import shutil
import sys
from itertools import count
from pathlib import Path

import genpy
import rosbag
import yaml

CHECKOUT = Path.cwd()
sys.path.insert(0, str(CHECKOUT / "test/support"))

from construction_twin.msg import Link, Sync, WorkTask, WorkTasks  # noqa: E402
from executor_bench import make_work_plan  # noqa: E402
from gateway_cell import Cell, slow  # noqa: E402

from construction_twin.broker.make_site import main as make_site  # noqa: E402
from construction_twin.execution.engagement import engagement_of, to_text  # noqa: E402
from construction_twin.gateway.trace import TraceWriter  # noqa: E402
from construction_twin.mqtt.messages import Control, arm_value  # noqa: E402
from construction_twin.review.plan_under_review import APPROVED, REJECTED, Ending, Verdict  # noqa: E402
from construction_twin.review.record import ReviewLog  # noqa: E402
from construction_twin.robot.description import read_robot_files  # noqa: E402
from construction_twin.ros.shared.gateway_config import gateway_config  # noqa: E402
from construction_twin.work.ledger import Entry, Ledger  # noqa: E402

STANDS = (1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0)
HELD = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)
NOW = 1_790_000_000_000_000_000


def main() -> None:
    """Write everything into the folder that is named."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    make_site([str(folder / "site"), "--host", "127.0.0.1", "--robot", "kr120", "--reviewer", "ada", "--days", "3650"])
    robot = read_robot_files(CHECKOUT / "urdf/kr120r2500.urdf.xacro", CHECKOUT / "config/kr120.yaml")
    settings = yaml.safe_load((CHECKOUT / "config/gateway.yaml").read_text())
    config = gateway_config(robot, settings | {"decimals": 3, "properties": True})
    (folder / "gateway.json").write_text(config.to_json())
    plan = make_work_plan()
    _reviews(folder / "kr120_reviews.jsonl", plan)
    (folder / "kr120_engagement.json").write_text(to_text(engagement_of(plan, 1)))
    _ledger(folder / "kr120_panel.jsonl")
    _gateway(folder)
    _bag(folder / "kr120.bag")
    for name in ("kr120.yaml", "kr120_self_collision.yaml", "scene.yaml", "gateway.yaml"):
        shutil.copy(CHECKOUT / "config" / name, folder / f"config_{name}")
    shutil.copytree(CHECKOUT / "config/work", folder / "config/work", dirs_exist_ok=True)
    shutil.copytree(CHECKOUT / "config/tools", folder / "config/tools", dirs_exist_ok=True)


def _reviews(path: Path, plan) -> None:
    log = ReviewLog(path, lambda: NOW)
    log.append(Verdict(APPROVED, plan.id, plan.hash, "Ada", "looks good", plan))
    log.append(Ending(plan, "finished", "as Ada said"))
    log.append(Verdict(REJECTED, "p2", plan.hash, "Ben", "too fast", plan))
    log.close()


def _ledger(path: Path) -> None:
    numbers = count(NOW, 1_000_000)
    ledger = Ledger(
        path, {"plate": (), "stud": ("plate",)}, "a" * 64, lambda: next(numbers), "/cell.yaml", {"plate": "E1"}
    )
    for entry in (
        Entry("accept_schedule", schedule="5c" * 32, person="eva"),
        Entry("offered", "plate", "E1", offer="o1", grip="top", pose=HELD),
        Entry("planned", "plate", "E1", offer="o1", plan="p1"),
        Entry("begun", "plate", "E1", plan="p1"),
        Entry("gripping", "plate", "E1", plan="p1"),
        Entry("gripped", "plate", "E1", plan="p1"),
        Entry("releasing", "plate", "E1", plan="p1"),
        Entry("released", "plate", "E1", plan="p1", pose=STANDS),
        Entry("finished", "plate", "E1", plan="p1"),
    ):
        ledger.add(entry)
    ledger.close()


def _gateway(folder: Path) -> None:
    cell = Cell()
    writer = TraceWriter(str(folder / "gateway.trace"), 2, 200)
    cell.gateway.trace = writer.record
    cell.cycle()
    arm = Control("1", "s1", "arm", arm_value(cell.config.hash, cell.gateway.run))
    said = [{"topic": "status", "payload": cell.gateway.status()}]
    cell.arm()
    for cycle in range(100):
        cell.send(slow(cycle))
        cell.cycle()
    said.append({"topic": "status", "payload": cell.gateway.status()})
    said.append({"topic": "control", "payload": json.loads(arm.to_json())})
    said.append({"topic": "control", "payload": json.loads(Control("2", "s1", "reset").to_json())})
    said.append({"topic": "control", "payload": json.loads(Control("3", "any", "stop").to_json())})
    writer.close()
    (folder / "messages.json").write_text(json.dumps(said, indent=1) + "\n")


def _bag(path: Path) -> None:
    with rosbag.Bag(str(path), "w") as bag:
        for number in range(5):
            time = genpy.Time(1_790_000_000 + number)
            link, sync = Link(state=5, text="ARMED", reason="armed"), Sync(name=["joint_a1"], error=[0.001])
            link.header.stamp = sync.header.stamp = time
            bag.write("/kr120/link", link, time)
            bag.write("/kr120/sync", sync, time)
            bag.write("/kr120/work_tasks", WorkTasks(schedule="model", tasks=[WorkTask(id="plate")]), time)


if __name__ == "__main__":
    main()
