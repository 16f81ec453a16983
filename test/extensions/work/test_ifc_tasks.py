"""The schedule of an IFC file, as it stands there. In IFC2X3 times and lags are other entities."""

from __future__ import annotations

import pytest
from ifc_models import IfcModel, noted

from construction_twin.extensions.work.building import BuildingError, Sequence
from construction_twin.extensions.work.schedule import Schedule


def two_tasks(schema="IFC4"):
    """A model with two studs and a task for each, in one task."""
    model = IfcModel(schema)
    studs = [model.box(name, (0.1, 0.1, 1.0), at=(k, 0, 0)) for k, name in enumerate(("a", "b"))]
    schedule = model.schedule()
    top = model.task("panel", schedule=schedule)
    tasks = [model.task(f"place {stud.Name}", [stud], top) for stud in studs]
    return model, studs, top, tasks


@pytest.mark.parametrize("schema", ["IFC2X3", "IFC4", "IFC4X3"])
def test_tasks_nest_make_products_and_name_who_does_them(read, schema):
    model, studs, top, (first, second) = two_tasks(schema)
    model.resource("kr120", first)
    model.inputs(second, studs[0])
    model.sequence(first, second)
    found = read(model)
    assert list(found.tasks) == [top.GlobalId, first.GlobalId, second.GlobalId]
    one, two = found.tasks[first.GlobalId], found.tasks[second.GlobalId]
    assert (one.name, one.parent, one.products, one.robots) == (
        "place a", top.GlobalId, (studs[0].GlobalId,), ("kr120",),
    )  # fmt: skip
    assert (two.products, two.inputs, two.robots) == ((studs[1].GlobalId,), (studs[0].GlobalId,), ())
    assert found.sequences == (Sequence(first.GlobalId, second.GlobalId),)


@pytest.mark.parametrize("kind", ["FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH"])
@pytest.mark.parametrize(
    ("schema", "lag", "seconds"), [("IFC4", "P1DT2H", 93600), ("IFC4", "-PT30M", -1800), ("IFC2X3", 60.0, 60)]
)
def test_all_four_kinds_of_order_have_a_lag(read, kind, schema, lag, seconds):
    model, _, _, (first, second) = two_tasks(schema)
    model.sequence(first, second, kind, lag)
    assert read(model).sequences == (Sequence(first.GlobalId, second.GlobalId, kind, float(seconds)),)


def test_a_lag_that_is_a_ratio_is_of_the_duration_before(read):
    model, _, _, (first, second) = two_tasks()
    first.TaskTime = model.make("IfcTaskTime", ScheduleDuration="PT2H", DurationType="WORKTIME")
    model.sequence(first, second, lag=0.5)
    model.sequence(second, first, lag=0.5)
    found = read(model)
    assert [each.lag for each in found.sequences] == [3600.0, 0.0]
    assert noted(found.notes, "A lag that is a part of a duration that is not known is left out")
    assert noted(found.notes, "A lag that is a part of the duration of the task before")


@pytest.mark.parametrize("no_date", ["soon", "08:00:00", "0001-01-01T00:00:00"])
def test_times_of_ifc4(read, no_date):
    model, _, _, (first, second) = two_tasks()
    first.TaskTime = model.make(
        "IfcTaskTime",
        ScheduleStart="2027-01-04T08:00:00",
        ScheduleFinish="2027-01-04T10:00:00",
        ScheduleDuration="PT2H",
    )
    second.TaskTime = model.make("IfcTaskTime", ScheduleStart=no_date, ScheduleDuration="P1Y")
    found = read(model)
    one, two = found.tasks[first.GlobalId], found.tasks[second.GlobalId]
    assert (one.start, one.duration) == ("2027-01-04T08:00:00", 7200.0)
    assert (two.start, two.duration) == ("", None)
    assert noted(found.notes, "A time that is no date is left out")
    assert noted(found.notes, "without a length in seconds ('P1Y')")


def test_times_of_ifc2x3_are_a_control_of_its_own(read):
    model, _, _, (first, _) = two_tasks("IFC2X3")
    date = model.make("IfcCalendarDate", 4, 1, 2027)
    start = model.make("IfcDateAndTime", date, model.make("IfcLocalTime", 8, 30))
    control = model.root("IfcScheduleTimeControl", ScheduleStart=start, ScheduleDuration=5400.0)
    schedule = model.file.by_type("IfcWorkSchedule")[0]
    model.root("IfcRelAssignsTasks", RelatedObjects=[first], RelatingControl=schedule, TimeForTask=control)
    task = read(model).tasks[first.GlobalId]
    assert (task.start, task.duration) == ("2027-01-04T08:30:00", 5400.0)


def test_workpieces_that_are_inputs_only_are_what_the_task_makes(read):
    model = IfcModel()
    stud, door = model.box("stud", (0.1, 0.1, 1.0)), model.box("door", (0.1, 0.1, 1.0), kind="IfcDoor")
    task, wreck = model.task("place"), model.task("take down", PredefinedType="DEMOLITION")
    model.inputs(task, stud, door)
    model.inputs(wreck, stud)
    found = read(model)
    assert (found.tasks[task.GlobalId].products, found.tasks[task.GlobalId].inputs) == (
        (stud.GlobalId,),
        (door.GlobalId,),
    )
    assert (found.tasks[wreck.GlobalId].products, found.tasks[wreck.GlobalId].inputs) == ((), (stud.GlobalId,))
    assert noted(found.notes, "are inputs only", "place")


def test_a_baseline_beside_the_plan_is_left_out(read):
    model = IfcModel()
    stud = model.box("stud", (0.1, 0.1, 1.0))
    planned = model.task("place", [stud], schedule=model.schedule("Plan", PredefinedType="PLANNED"))
    before = model.task("place then", [stud], schedule=model.schedule("Old", PredefinedType="BASELINE"))
    model.sequence(before, planned)
    found = read(model)
    assert list(found.tasks) == [planned.GlobalId]
    assert found.sequences == ()
    assert noted(found.notes, "left out with their tasks", "Old", "BASELINE")


def test_an_order_without_a_kind_is_finish_to_start(read):
    model, _, _, (first, second) = two_tasks()
    model.sequence(first, second, None)
    found = read(model)
    assert found.sequences[0].kind == "FINISH_START"
    assert noted(found.notes, "Orders without one of the four kinds")


def test_a_task_that_its_schedule_aggregates_is_of_the_task_that_nests_it(read):
    model, _, top, (first, _) = two_tasks()
    model.root("IfcRelAggregates", RelatingObject=model.root("IfcWorkPlan", Name="plan"), RelatedObjects=[first])
    tasks = read(model).tasks
    assert tasks[first.GlobalId].parent == top.GlobalId


def test_a_task_that_is_part_of_itself_is_refused_with_its_number(read):
    model, _, top, (first, _) = two_tasks()
    model.root("IfcRelNests", RelatingObject=first, RelatedObjects=[top])
    with pytest.raises(BuildingError, match=rf"#({top.id()}|{first.id()})=IFCTASK: found part of itself"):
        read(model)


def test_without_a_scheduled_start_the_early_one_is_taken_and_else_the_late_one(read):
    model, _, _, (first, second) = two_tasks()
    first.TaskTime = model.make("IfcTaskTime", EarlyStart="2027-01-05T08:00:00", LateStart="2027-01-07T08:00:00")
    second.TaskTime = model.make("IfcTaskTime", LateStart="2027-01-04T08:00:00", LateFinish="2027-01-04T09:00:00")
    found = read(model)
    one, two = found.tasks[first.GlobalId], found.tasks[second.GlobalId]
    assert (one.start, two.start) == ("2027-01-05T08:00:00", "2027-01-04T08:00:00")
    assert [job.task for job in Schedule.of(found).jobs] == [second.GlobalId, first.GlobalId]


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize(
    ("schema", "kind"), [("IFC4", "IfcEvent"), ("IFC4X3", "IfcProcedure"), ("IFC2X3", "IfcProcedure")]
)
def test_an_event_between_two_tasks_keeps_their_order_and_lags(read, nested, schema, kind):
    model, _, top, (first, second) = two_tasks(schema)
    event = model.root(kind, Name="inspected")
    if nested:
        model.root("IfcRelNests", RelatingObject=top, RelatedObjects=[event])
    # the second first
    lag = 60.0 if schema == "IFC2X3" else "PT1M"
    model.sequence(second, event, lag=lag)
    model.sequence(event, first, lag=lag)
    found = read(model)
    schedule = Schedule.of(found)
    assert [job.task for job in schedule.jobs] == [second.GlobalId, first.GlobalId]
    assert [(wait.job, wait.lag) for wait in schedule.job(first.GlobalId).after] == [(second.GlobalId, 120.0)]
    assert noted(found.notes, "Comes after what the arm does not see", kind)


def held(model, kind, *elements):
    """A group of elements, or a part of the site that holds them."""
    if kind == "IfcGroup":
        group = model.root(kind, Name="Takt 1")
        model.root("IfcRelAssignsToGroup", RelatingGroup=group, RelatedObjects=list(elements))
        return group
    model.aggregate(model.building, [floor := model.root(kind, Name="Upper floor")])
    model.root("IfcRelContainedInSpatialStructure", RelatingStructure=floor, RelatedElements=list(elements))
    return floor


@pytest.mark.parametrize(
    ("kind", "inputs"), [("IfcGroup", True), ("IfcBuildingStorey", True), ("IfcBuildingStorey", False)]
)
def test_a_task_of_a_group_or_a_storey_makes_what_is_in_it(read, kind, inputs):
    model = IfcModel()
    upper = model.box("upper", (1.0, 0.1, 0.1), at=(0.0, 0.0, 0.1))
    lower = model.box("lower", (1.0, 0.1, 0.1))
    group = held(model, kind, upper, lower)
    task = model.task("takt", [] if inputs else [group])
    if inputs:
        model.inputs(task, group)
    schedule = Schedule.of(read(model))
    assert [(job.task, job.element) for job in schedule.jobs] == [
        (task.GlobalId, lower.GlobalId), (task.GlobalId, upper.GlobalId),
    ]  # fmt: skip
    assert schedule.proposed and not noted(schedule.notes, "No task makes")
    assert noted(schedule.notes, "which has no body of its own: what is in it", task.GlobalId)


def test_of_groups_that_share_elements_the_smaller_one_has_them_or_else_the_first(read):
    model = IfcModel()
    a, b, c = (model.box(name, (0.1, 0.1, 1.0), at=(k, 0, 0)) for k, name in enumerate("abc"))
    groups = [held(model, "IfcGroup", *members) for members in ((a, b, c), (a, b), (b, a))]
    whole, small, same = (model.task(f"t{k}", [group]) for k, group in enumerate(groups))
    schedule = Schedule.of(read(model))
    assert {job.element: job.task for job in schedule.jobs} == {
        a.GlobalId: small.GlobalId, b.GlobalId: small.GlobalId, c.GlobalId: whole.GlobalId,
    }  # fmt: skip
    assert noted(schedule.notes, "which has no body of its own: nothing that is in it", same.GlobalId)


def test_a_task_that_takes_down_a_storey_takes_down_what_is_in_it(read):
    model = IfcModel()
    old = model.box("old", (0.1, 0.1, 1.0), kind="IfcDoor")
    model.task("clear", [held(model, "IfcBuildingStorey", old)], PredefinedType="DEMOLITION")
    assert [job.element for job in Schedule.of(read(model)).removals] == [old.GlobalId]
