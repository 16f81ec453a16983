"""A schedule written into a copy of an IFC file, as a planner's program would read it."""

import datetime
import re

import ifcopenshell
import ifcopenshell.guid
import ifcopenshell.util.sequence
import make_models
import pytest

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import Sequence, Task
from construction_twin.work.global_ids import global_id
from construction_twin.work.ifc.schedule_writer import write_schedule

CREATED = datetime.datetime(2026, 3, 1, 8, 0, 0)
WALL = {part.name: global_id("brick_wall", "element", part.name) for part in make_models.brick_wall().parts}
ROOT, FIRST, SECOND = (global_id("test", word) for word in ("root", "first", "second"))
TASKS = (
    Task(ROOT, "Wall"),
    Task(FIRST, "First", "of two", ROOT, (WALL["Brick 1.1"],), (WALL["Brick 1.3"],), ("left", "kr120"), duration=90.0),
    Task(SECOND, "Second", "", ROOT, (WALL["Brick 1.2"],), milestone=False, start="2026-03-02T08:00:00"),
)
SEQUENCES = (Sequence(FIRST, SECOND, "START_START", 30.0),)


@pytest.fixture(params=make_models.SCHEMAS)
def source(request, tmp_path):
    path = tmp_path / "model.ifc"
    make_models.build("brick_wall", request.param).write(str(path))
    return path


def test_a_copy_has_the_tasks_their_nesting_products_and_robots(source, tmp_path):
    original = source.read_bytes()
    write_schedule(source, tmp_path / "copy.ifc", "Proposal", TASKS, SEQUENCES, CREATED, "from geometry")
    assert source.read_bytes() == original
    file = ifcopenshell.open(str(tmp_path / "copy.ifc"))
    first, second = file.by_guid(FIRST), file.by_guid(SECOND)
    assert first.Name == "First" and first.Description == "of two"
    (nests,) = [relation for relation in file.by_type("IfcRelNests") if relation.RelatingObject == file.by_guid(ROOT)]
    assert list(nests.RelatedObjects) == [first, second]
    made = [r.RelatingProduct for r in file.by_type("IfcRelAssignsToProduct") if first in r.RelatedObjects]
    assert [one.GlobalId for one in made] == [WALL["Brick 1.1"]]
    given = [
        one for r in file.by_type("IfcRelAssignsToProcess") if r.RelatingProcess == first for one in r.RelatedObjects
    ]
    assert {one.Name for one in given} == {"Brick 1.3", "left", "kr120"}
    assert sorted(one.Name for one in file.by_type("IfcConstructionEquipmentResource")) == ["kr120", "left"]
    schedule = next(one for one in file.by_type("IfcWorkSchedule") if one.Name == "Proposal")
    assert schedule.Description == "from geometry"


def test_order_lag_and_times_are_written_as_the_schema_has_them(source, tmp_path):
    write_schedule(source, tmp_path / "copy.ifc", "Proposal", TASKS, SEQUENCES, CREATED)
    file = ifcopenshell.open(str(tmp_path / "copy.ifc"))
    first, second = file.by_guid(FIRST), file.by_guid(SECOND)
    (sequence,) = [one for one in file.by_type("IfcRelSequence") if one.RelatedProcess == second]
    assert sequence.RelatingProcess == first and sequence.SequenceType == "START_START"
    if file.schema == "IFC2X3":
        assert sequence.TimeLag == 30.0
        times = {one: r.TimeForTask for r in file.by_type("IfcRelAssignsTasks") for one in r.RelatedObjects}
        assert times[first].ScheduleDuration == 90.0
        assert times[second].ScheduleStart.DateComponent.DayComponent == 2
    else:
        assert sequence.TimeLag.LagValue.wrappedValue == "PT30S"
        assert first.TaskTime.ScheduleDuration == "PT90S" and second.TaskTime.ScheduleStart == "2026-03-02T08:00:00"


def test_the_same_schedule_gives_the_same_file(source, tmp_path):
    for name in ("a.ifc", "b.ifc"):
        write_schedule(source, tmp_path / name, "Proposal", TASKS, SEQUENCES, CREATED)
    assert (tmp_path / "a.ifc").read_bytes() == (tmp_path / "b.ifc").read_bytes()


def test_nothing_is_written_over(source, tmp_path):
    for target in (source, tmp_path / "there.ifc"):
        target.touch()
        before = target.read_bytes()
        with pytest.raises(ConfigurationError, match="nothing is written over"):
            write_schedule(source, target, "Proposal", TASKS, SEQUENCES, CREATED)
        assert target.read_bytes() == before


def test_what_the_file_has_already_or_lacks_is_refused_by_its_id(source, tmp_path):
    copy, second = tmp_path / "copy.ifc", tmp_path / "second.ifc"
    write_schedule(source, copy, "Proposal", TASKS, SEQUENCES, CREATED)
    with pytest.raises(BuildingError, match="schedule 'Proposal'"):
        write_schedule(copy, second, "Proposal", TASKS, SEQUENCES, CREATED)
    with pytest.raises(BuildingError, match=re.escape(f"task {ROOT!r}")):
        write_schedule(copy, second, "Another", TASKS, SEQUENCES, CREATED)
    with pytest.raises(BuildingError, match="no product 'nothing'"):
        write_schedule(source, second, "Proposal", (Task(ROOT, "", products=("nothing",)),), (), CREATED)
    with pytest.raises(BuildingError, match="no parent"):
        write_schedule(source, second, "Proposal", (Task(ROOT, "", parent=FIRST),), (), CREATED)
    assert not second.exists()


@pytest.mark.parametrize("content", [None, "", "ISO-10303-21;\nHEADER;"])
def test_a_file_that_cannot_be_read_is_one_sentence(content, tmp_path):
    if content is not None:
        (tmp_path / "bad.ifc").write_text(content)
    with pytest.raises(BuildingError, match="bad.ifc: the file"):
        write_schedule(tmp_path / "bad.ifc", tmp_path / "copy.ifc", "Proposal", TASKS, SEQUENCES, CREATED)


def test_ids_are_those_of_ifc():
    assert ifcopenshell.guid.compress(ifcopenshell.guid.expand(FIRST)) == FIRST
    assert FIRST != SECOND and FIRST == global_id("test", "first")
