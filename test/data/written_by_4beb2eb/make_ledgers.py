"""Writes the ledgers of this folder anew, and what each of their lines leaves, by the programs of version 0.1.0.

cd CHECKOUT of commit 4beb2eb; PYTHONPATH=src python .../test/data/written_by_4beb2eb/make_ledgers.py FOLDER
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from itertools import count
from pathlib import Path

from construction_twin.work.following import Followed, Grip, Report, Verdict, after_restart, follow
from construction_twin.work.ledger import Book, Entry, Ledger, read_entries

NOW = 1_790_000_000_000_000_000
HELD = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)
STANDS = (1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0)
MEASURED = (1.01, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0)
AFTER = {"plate": (), "stud": ("plate",), "board": ("plate", "stud")}
ELEMENTS = {"plate": "E1", "stud": "E2", "board": "E3"}
OPEN, CLOSED, UNKNOWN = Grip(True, False), Grip(True, True), Grip(False, False)


class Node:
    """The work node's part: it writes what follows from the executor's reports."""

    def __init__(self, path: Path, model: str = "a" * 64, after=None):
        numbers = count(NOW + 1_000_000_000 * (path.read_bytes().count(b"\n") if path.exists() else 0), 1_000_000)
        self.ledger = Ledger(path, after or AFTER, model, lambda: next(numbers), "/cell.yaml", ELEMENTS)

    def say(self, event: str, task: str, **said) -> None:
        self.ledger.add(Entry(event, task, ELEMENTS[task], **said))

    def run(self, task: str, reports: int = 10, end: str = "finished", grip: Grip | None = None) -> None:
        """Offer a plan of five segments, and follow so many reports of it; the end is the last."""
        plan = Followed(f"p {task}", task, f"work, offer o {task}", 1, 3)
        self.say("offered", task, offer=f"o {task}", grip="top", pose=HELD)
        self.say("planned", task, offer=f"o {task}", plan=plan.id)
        heard = [(0, "", OPEN), (1, "", OPEN), (1, "b", CLOSED), (1, "w", CLOSED), (2, "", CLOSED)]
        heard += [(3, "", CLOSED), (3, "b", OPEN), (3, "w", OPEN), (4, "", OPEN)]
        for segment, at, tool in heard[:reports]:
            self.hear(task, plan, Report(plan.id, True, "", segment, at != "", at == "w"), tool)
        if end:
            segment, _, tool = heard[min(reports, len(heard)) - 1]
            self.hear(task, plan, Report(plan.id, False, end, segment, reason="why"), grip or tool)

    def hear(self, task: str, plan: Followed, report: Report, tool: Grip) -> None:
        for entry in follow(self.ledger.book.tasks[task], ELEMENTS[task], plan, report, tool, STANDS, "measured"):
            self.ledger.add(entry)

    def lost(self, task: str, verdict: Verdict, tool: Grip) -> None:
        for entry in after_restart(self.ledger.book.tasks[task], ELEMENTS[task], verdict, tool):
            self.ledger.add(entry)


def full(path: Path) -> None:
    node = Node(path)
    node.ledger.add(Entry("accept_schedule", schedule="5c" * 32, person="eva"))
    for task in ELEMENTS:
        node.run(task)
    node.ledger.close()


def interrupted(path: Path) -> None:
    node = Node(path)
    node.run("plate", 1, "stopped")
    node.run("plate", 3, "stopped", OPEN)
    node.run("plate", 5, "")
    node.ledger.close()
    node = Node(path)
    node.lost("plate", Verdict("p plate", False, True), CLOSED)
    node.say("answered", "plate", answer="in_grip", person="eva")
    node.say("offered", "plate", offer="o again")
    node.say("dropped", "plate", reason="ben: too fast")
    node.say("unknown", "plate", reason="the tool says that it holds nothing")
    node.say("answered", "plate", answer="in_stock", person="eva")
    node.run("plate")
    node.run("stud", 2, "")
    node.ledger.close()
    whole = path.read_bytes()
    node = Node(path)
    node.say("gripping", "stud", plan="p stud")
    node.ledger.close()
    # the power failed while that line was written
    path.write_bytes(path.read_bytes()[: len(whole) + 40])


def people(path: Path) -> None:
    node = Node(path)
    node.run("plate")
    node.say("measured", "plate", pose=MEASURED, person="eva", reason="laser tracker")
    node.say("skipped", "stud", person="ben", reason="it stands")
    node.say("measured", "stud", pose=MEASURED, person="ben")
    node.say("redone", "stud", person="ben", reason="it fell")
    node.run("stud", 7, "held")
    node.say("answered", "stud", answer="gone", person="eva")
    node.say("skipped", "stud", person="eva")
    node.run("board", 9, "stopped")
    node.ledger.close()
    node = Node(path, "b" * 64)
    node.say("answered", "plate", answer="placed", person="eva")
    node.ledger.close()
    # a schedule without the board, and in another order
    Node(path, "b" * 64, {"stud": (), "plate": ("stud",)}).ledger.close()


def states(path: Path, after: dict) -> list[dict]:
    """Return what is known of every task after each line."""
    book, found = Book(after), []
    for entry in read_entries(path):
        book.take(entry)
        tasks = {**book.tasks, **{f"former {task}": memory for task, memory in book.former.items()}}
        known = {task: {**asdict(m), "state": m.state.value, "before": m.before.value} for task, m in tasks.items()}
        found.append({"accepted": book.accepted, "model": book.model, "cell": book.cell, "tasks": known})
    return found


def main() -> None:
    """Write everything into the folder that is named."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for write in (full, interrupted, people):
        path = folder / f"{write.__name__}.jsonl"
        path.unlink(missing_ok=True)
        write(path)
        whole = path.read_bytes()
        path.write_bytes(whole[: whole.rfind(b"\n") + 1])
        found = [{"after": after, "lines": states(path, after)} for after in (AFTER, {"stud": (), "plate": ("stud",)})]
        path.write_bytes(whole)
        (folder / f"{write.__name__}_states.json").write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
