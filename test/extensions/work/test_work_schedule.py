"""`work schedule`: plans of Primavera P6 and Microsoft Project become the order of a model's jobs, and what is refused."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import ifcopenshell
import ifcopenshell.api.sequence
import pytest

from construction_twin.extensions.work.commands.work_schedule import main
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.schedule import Schedule

ROOT = Path(__file__).resolve().parents[3]
#: Code and name of each activity, one after the other, 8 hours each; a lag of 4 hours before the last.
ACTIVITIES = (
    ("A10", "Mobilise"),
    ("A20", "Place bottom plate, top plate"),
    ("A30", "Place stud 1"),
    ("A40", "Place stud 2"),
)
BEGIN = datetime(2026, 12, 7, 8)


def dates(number: int) -> tuple[datetime, datetime]:
    return BEGIN + timedelta(days=number), BEGIN + timedelta(days=number, hours=9)


def xer(activities) -> str:
    calendar = "(0||CalendarData()(  (0||DaysOfWeek()(    (0||1()())    (0||2()(      (0||0(s|08:00|f|17:00)())))))))"
    form = "%Y-%m-%d %H:%M"
    tables = {
        "PROJECT": [{"proj_id": 1, "proj_short_name": "PANEL", "clndr_id": 5}],
        "CALENDAR": [
            {"clndr_id": 5, "default_flag": "Y", "clndr_name": "Week", "proj_id": "", "base_clndr_id": "",
             "last_chng_date": "", "clndr_type": "CA_Base", "day_hr_cnt": 8, "week_hr_cnt": 40, "month_hr_cnt": 172,
             "year_hr_cnt": 2000, "clndr_data": calendar}
        ],
        "PROJWBS": [
            {"wbs_id": 7, "proj_id": 1, "obs_id": "", "seq_num": 1, "est_wt": 1, "proj_node_flag": "Y",
             "sum_data_flag": "N", "status_code": "WS_Open", "wbs_short_name": "P", "wbs_name": "Panel", "phase_id": "",
             "parent_wbs_id": "", "ev_user_pct": "", "ev_etc_user_value": "", "orig_cost": "",
             "indep_remain_total_cost": "", "ann_dscnt_rate_pct": "", "dscnt_period_type": "",
             "indep_remain_work_qty": "", "anticip_start_date": "", "anticip_end_date": "", "ev_compute_type": "",
             "ev_etc_compute_type": "", "guid": "", "tmpl_guid": "", "plan_open_state": ""}
        ],
        "TASK": [
            {"task_id": 100 + number, "proj_id": 1, "wbs_id": 7, "clndr_id": 5, "task_type": "TT_Task",
             "status_code": "TK_NotStart", "task_code": code, "task_name": name, "target_drtn_hr_cnt": 8,
             "early_start_date": dates(number)[0].strftime(form), "early_end_date": dates(number)[1].strftime(form),
             "target_start_date": dates(number)[0].strftime(form), "target_end_date": dates(number)[1].strftime(form)}
            for number, (code, name) in enumerate(activities)
        ],
        "TASKPRED": [
            {"task_pred_id": 200 + number, "task_id": 101 + number, "pred_task_id": 100 + number, "proj_id": 1,
             "pred_proj_id": 1, "pred_type": "PR_FS", "lag_hr_cnt": 4 * (number == len(activities) - 2)}
            for number in range(len(activities) - 1)
        ],
    }  # fmt: skip
    lines = ["ERMHDR\t20.12\t2026-12-01\tProject\tADMIN\tme\tdb\tProject Management\tEUR"]
    for table, rows in tables.items():
        lines += [f"%T\t{table}", "\t".join(["%F", *rows[0]])]
        lines += ["\t".join(map(str, ["%R", *row.values()])) for row in rows]
    return "\r\n".join([*lines, "%E"]) + "\r\n"


def xml(tag: str, *children: str, **texts: object) -> str:
    return f"<{tag}>" + "".join((*(f"<{key}>{value}</{key}>" for key, value in texts.items()), *children)) + f"</{tag}>"


def p6_xml(activities) -> str:
    project = "".join(
        xml(
            "Activity",
            xml("UDF", TypeObjectId=9, TextValue=code),
            ObjectId=100 + number, Id=code, Name=name, Type="Task Dependent", WBSObjectId=7, CalendarObjectId=5,
            StartDate=dates(number)[0].isoformat(), FinishDate=dates(number)[1].isoformat(), PlannedDuration=8,
            Status="Not Started",
        )
        for number, (code, name) in enumerate(activities)
    )  # fmt: skip
    project += "".join(
        xml(
            "Relationship", ObjectId=200 + number, PredecessorActivityObjectId=100 + number,
            SuccessorActivityObjectId=101 + number, Type="Finish to Start", Lag=4 * (number == len(activities) - 2),
        )
        for number in range(len(activities) - 1)
    )  # fmt: skip
    hours = xml("StandardWorkHours", xml("WorkTime", Start="08:00:00", Finish="17:00:00"), DayOfWeek="Monday")
    calendar = xml("Calendar", xml("StandardWorkWeek", hours), ObjectId=5, Name="Week", Type="Global", HoursPerDay=8)
    udf = xml("UDFType", ObjectId=9, SubjectArea="Activity", DataType="Text", Title="Zone")
    wbs = xml("WBS", ObjectId=7, Name="Panel", Code="P", ParentObjectId="", SequenceNumber=1)
    space = "http://xmlns.oracle.com/Primavera/P6/V19.12/API/BusinessObjects"
    return f'<?xml version="1.0"?><APIBusinessObjects xmlns="{space}">{calendar}{udf}' + (
        xml("Project", wbs, project, Name="Panel", ActivityDefaultCalendarObjectId=5) + "</APIBusinessObjects>"
    )


def mspdi(activities) -> str:
    tasks = xml("Task", UID=0, ID=0, Name="Panel", OutlineLevel=0, OutlineNumber="0")
    for number, (code, name) in enumerate(activities, 1):
        link = xml(
            "PredecessorLink",
            PredecessorUID=number - 1,
            Type=1,
            LinkLag=2400 * (number == len(activities)),
            LagFormat=7,
        )
        tasks += xml(
            "Task", link if number > 1 else "", xml("ExtendedAttribute", FieldID=188743731, Value=code),
            UID=number, ID=number, Name=name, OutlineLevel=1, OutlineNumber=f"1.{number}",
            Start=dates(number - 1)[0].isoformat(), Finish=dates(number - 1)[1].isoformat(), Duration="PT8H0M0S",
        )  # fmt: skip
    field = xml("ExtendedAttributes", xml("ExtendedAttribute", FieldID=188743731, FieldName="Text1", Alias="Zone"))
    calendar = xml("Calendars", xml("Calendar", UID=1, Name="Standard", IsBaseCalendar=1))
    project = xml("Project", field, calendar, xml("Tasks", tasks), Title="Panel", CalendarUID=1, MinutesPerDay=480)
    return '<?xml version="1.0"?>' + project.replace(
        "<Project>", '<Project xmlns="http://schemas.microsoft.com/project">', 1
    )


FORMS = {"xer": xer, "p6.xml": p6_xml, "mspdi.xml": mspdi}


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """Return the timber panel without its tasks."""
    file = ifcopenshell.open(str(ROOT / "models" / "timber_panel.ifc"))
    while tasks := file.by_type("IfcTask"):
        ifcopenshell.api.sequence.remove_task(file, task=tasks[0])
    path = tmp_path_factory.mktemp("model") / "panel.ifc"
    file.write(str(path))
    return path


def written(folder: Path, form: str, activities=ACTIVITIES) -> Path:
    plan = folder / f"plan.{form}"
    plan.write_bytes(FORMS[form](activities).encode("cp1252"))
    return plan


@pytest.mark.parametrize("form", FORMS)
def test_a_plan_becomes_the_jobs_of_the_elements_that_its_activities_name_in_its_order_with_its_lag(
    model, tmp_path, capsys, form
):
    output = tmp_path / "out.ifc"
    assert main([str(model), str(written(tmp_path, form)), "--output", str(output), "--pattern", "Place {}"]) == 0
    printed = capsys.readouterr().out
    assert "3 of 4 activities make 4 elements" in printed and "'Mobilise'" in printed
    building = read_building(output)
    schedule = Schedule.of(building)
    names = [building.elements[job.element].name for job in schedule.jobs]
    assert names == ["Bottom plate", "Top plate", "Stud 1", "Stud 2"]
    last = schedule.jobs[-1]
    assert [wait.lag for wait in last.after] == [12 * 3600.0], "4 of the 8 hours of a day, counted around the clock"
    assert not [note for note in building.notes if "MAY HAVE BEGUN" in note]


@pytest.mark.parametrize("form", FORMS)
def test_activities_name_elements_by_code_and_by_wildcards(model, tmp_path, form):
    field = {"xer": "Identification", "p6.xml": "Zone", "mspdi.xml": "Zone"}[form]
    output = tmp_path / "out.ifc"
    plan = written(tmp_path, form, (("bottom plate", "one"), ("stud ?", "two")))
    assert main([str(model), str(plan), "--output", str(output), "--activity", field]) == 0
    building = read_building(output)
    names = {building.elements[job.element].name for job in Schedule.of(building).jobs}
    assert {"Bottom plate", "Stud 1", "Stud 2"} <= names and "Top plate" not in names


def test_an_activity_of_a_storey_becomes_jobs_of_what_it_holds(model, tmp_path):
    storey = ifcopenshell.open(str(model)).by_type("IfcBuildingStorey")[0].Name
    output = tmp_path / "out.ifc"
    assert main([str(model), str(written(tmp_path, "mspdi.xml", (("1", storey),))), "--output", str(output)]) == 0
    assert len(Schedule.of(read_building(output)).jobs) > 5


def test_what_cannot_be_converted_is_refused_in_one_sentence_and_nothing_is_written(model, tmp_path, capsys):
    other = tmp_path / "notes.xml"
    other.write_text("<notes/>")
    cut = written(tmp_path, "xer")
    cut.write_bytes(cut.read_bytes().replace(b"\ttmpl_guid", b"").replace(b"tk_", b""))
    output = tmp_path / "out.ifc"
    for arguments, problem in (
        ([model, other], "neither an XER or XML file of Primavera P6"),
        ([model, cut], "cannot be read as P6 XER"),
        ([model, tmp_path / "absent.xer"], "is not there"),
        ([other, written(tmp_path, "p6.xml")], "no IFC file that can be read"),
        ([ROOT / "models" / "timber_panel.ifc", written(tmp_path, "p6.xml")], "tasks of its own"),
        (
            [model, written(tmp_path, "p6.xml"), "--pattern", "Set {}"],
            "no activity names an element: activities have as Name 'Mobilise'",
        ),
        ([model, written(tmp_path, "p6.xml"), "--pattern", "Place"], "expected one {}"),
    ):
        assert main([*map(str, arguments), "--output", str(output)]) == 2
        assert problem in capsys.readouterr().err
    assert not output.exists()
