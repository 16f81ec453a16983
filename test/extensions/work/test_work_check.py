"""The command `work check`: exit codes, one sentence for what cannot be checked, the files that it leaves."""

import subprocess
import sys
from pathlib import Path

import ifcopenshell
import pytest
import yaml

from construction_twin.extensions.work.commands.work_check import NOT_CHECKED, SOME, main

ROOT = Path(__file__).resolve().parents[3]
CELL = ROOT / "config/work/timber_panel.yaml"


@pytest.fixture
def small(tmp_path):
    """A model of one brick without a schedule, and a folder for the cell."""
    file = ifcopenshell.open(ROOT / "models/brick_wall.ifc")
    for kind in ("IfcWorkSchedule", "IfcTask", "IfcRelSequence", "IfcRelNests", "IfcRelAssigns"):
        for entity in file.by_type(kind):
            file.remove(entity)
    for brick in file.by_type("IfcBuildingElementPart")[1:]:
        file.remove(brick)
    path = tmp_path / "one.ifc"
    file.write(str(path))
    return path


def cell(tmp_path, **changes):
    """The brick wall's cell with changed keys."""
    folder = ROOT / "config/work"
    content = yaml.safe_load((folder / "brick_wall.yaml").read_text())
    for key in ("tool", "recipes", "scene"):
        content[key] = str((folder / content[key]).resolve())
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(content | changes))
    return path


def test_a_task_that_is_not_possible_ends_with_another_code_and_its_reason(small, tmp_path, capsys):
    # the base so low that the wall's place is above the reach, but not so far that it must be a wrong placement
    low = cell(tmp_path, model_T_base={"xyz": [1.245, -1.5, -3.6]})
    status = main(
        [
            str(small),
            "--cell",
            str(low),
            "--track",
            "--processes",
            "1",
            "--output",
            str(tmp_path / "o"),
        ]
    )
    printed = capsys.readouterr().out
    assert status == SOME and "0 of 1 tasks are possible" in printed and "reach: " in printed


@pytest.mark.parametrize(
    ("model", "changes", "message"),
    [
        ("missing.ifc", {}, "missing.ifc"),
        ("one.ifc", {"model_T_base": {"xyz": [1245.0, -1500.0, -400.0]}}, "out of the robot's reach"),
        (
            "one.ifc",
            {
                "racks": {
                    "none": {
                        "kind": "stack",
                        "at": {"xyz": [0, -1.5, 0.6]},
                        "levels": 1,
                        "step": 0.1,
                        "holds": {"ifc_class": ["IfcBeam"]},
                    }
                }
            },
            "racks",
        ),
        ("one.ifc", {"unknown": 1}, "unknown"),
    ],
)
def test_what_cannot_be_checked_is_one_sentence_and_code_2(small, tmp_path, model, changes, message, capsys):
    arguments = [
        str(tmp_path / model),
        "--cell",
        str(cell(tmp_path, **changes)),
        "--track",
        "--output",
        str(tmp_path / "o"),
    ]
    assert main(arguments) == NOT_CHECKED
    error = capsys.readouterr().err
    assert error.startswith("work check: ") and message in error and error.count("\n") == 1
    assert "Traceback" not in error


def test_the_installed_program_takes_check_as_its_first_word_without_a_master(tmp_path):
    program = [sys.executable, str(ROOT / "nodes/work"), "check", str(tmp_path / "missing.ifc"), "--cell", str(CELL)]
    ended = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == NOT_CHECKED
    assert ended.stderr.startswith("work check: ") and "missing.ifc" in ended.stderr


def test_a_word_that_is_no_command_does_not_start_the_node():
    ended = subprocess.run(
        [sys.executable, str(ROOT / "nodes/work"), "chek"], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == "work: found 'chek', expected check, register, schedule, or nothing: the node\n"
