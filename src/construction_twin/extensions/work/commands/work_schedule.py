"""work schedule: a plan of Primavera P6 (XER, XML) or Microsoft Project (XML) becomes the schedule of a building model.

ifc4d writes the plan's activities, order, lags and calendars into a copy of the IFC file; here each activity is assigned to the
elements, groups or storeys that it names. Runs without a ROS master. Exit code 0: written; 2: refused, after one sentence on
standard error.
"""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import io
import re
import sys
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from construction_twin.core.errors import ConstructionTwinError, command_message
from construction_twin.core.extensions import check_extras
from construction_twin.core.files import check_writable
from construction_twin.extensions.work.building import ScheduleError, first_few

if TYPE_CHECKING:
    import ifcopenshell

#: What a plan's kind loses on the way, beside what the building model's reader says of its result.
LOSSES = {
    "P6 XER": "left out: level-of-effort activities, actual dates, parts that are done; holidays are those of all calendars",
    "P6 XML": "left out: user-defined fields of the WBS",
    "MSPDI": "left out: lags in percent, recurring exceptions of calendars",
}
#: Words of a status that the reader knows, in place of ifc4d's own for XER.
_XER_STATUS = {"TK_NotStart": "NOTSTARTED", "TK_Complete": "COMPLETED", "TK_Active": "STARTED"}
#: Where a list of elements in one text is cut.
_SEPARATOR = re.compile(r"\s*[;,]\s*")
_NAMED = ("IfcElement", "IfcGroup", "IfcSpatialElement")


def main(arguments: list[str]) -> int:
    """Convert the plan named on the command line; return the exit code."""
    options = _parser().parse_args(arguments)
    output = options.output or options.model.with_name(f"{options.model.stem}_{options.plan.stem}.ifc")
    try:
        check_extras("work")
        check_writable(output.parent)
        for line in convert(options.model, options.plan, output, options.activity, options.element, options.pattern):
            print(line)
    except (ConstructionTwinError, OSError) as error:
        print(f"work schedule: {command_message(error)}", file=sys.stderr)
        return 2
    print(output)
    return 0


def convert(model: Path, plan: Path, output: Path, activity: str, element: str, pattern: str) -> list[str]:
    """Write a model with a plan's tasks as its schedule; return what was done, in sentences. Arguments as the options."""
    import ifcopenshell

    if pattern.count("{}") != 1:
        raise ScheduleError(f"pattern {pattern!r}: expected one {{}} where the elements' names are, as in 'Place {{}}'")
    try:
        file = ifcopenshell.open(str(model))
    except (OSError, RuntimeError) as error:
        raise ScheduleError(f"{model}: no IFC file that can be read: {error}") from error
    if file.schema == "IFC2X3":
        raise ScheduleError(f"{model}: IFC2X3 has no times of tasks; export the model as IFC4")
    if tasks := file.by_type("IfcTask"):
        raise ScheduleError(f"{model}: it has {len(tasks)} tasks of its own; export it without them")
    kind = _add_tasks(file, plan)
    named = _named(file, element)
    leaves = [task for task in file.by_type("IfcTask") if task.TaskTime is not None]
    found = re.compile(re.escape(pattern).replace(r"\{\}", "(.+)"), re.IGNORECASE).fullmatch
    products: dict[int, list[Any]] = {}
    others: list[str] = []
    for task in leaves:
        matched = found(_text(task, activity))
        parts = _SEPARATOR.split(matched[1].strip()) if matched else []
        keys = [
            key
            for part in map(str.casefold, parts)
            for key in ([part] if part in named else fnmatch.filter(named, part))
        ]
        products[task.id()] = [each for key in dict.fromkeys(keys) for each in named[key]]
        if not products[task.id()]:
            others.append(f"{task.Identification} {task.Name!r}")
        for product in products[task.id()]:
            _assign(file, task, product)
    made = {each.id() for some in products.values() for each in some}
    if not made:
        raise ScheduleError(
            f"no activity names an element: activities have as {activity} {_examples(_text(task, activity) for task in leaves)}, "
            f"elements as {element} {_examples(named)}; look at --activity, --element and --pattern"
        )
    file.write(str(output))
    lines = [
        f"{len(leaves) - len(others)} of {len(leaves)} activities make {len(made)} elements; {kind}: {LOSSES[kind]}"
    ]
    if others:
        lines.append(f"{len(others)} make none, and stay for the order alone: {first_few(others)}")
    return lines


def _add_tasks(file: ifcopenshell.file, plan: Path) -> str:
    """Add a plan's tasks to a file by ifc4d; return the kind of the plan, see `LOSSES`."""
    start = plan.read_bytes()[:4096]
    with contextlib.redirect_stdout(io.StringIO()):  # it prints what it does
        from ifc4d.msp2ifc import MSP2Ifc
        from ifc4d.p6xer2ifc import P6XER2Ifc
        from ifc4d.p62ifc import P62Ifc

        converter: Any
        if start.startswith(b"ERMHDR"):
            kind, converter = "P6 XER", P6XER2Ifc()
            converter.xer, converter.status_map = str(plan), _XER_STATUS
        elif b"schemas.microsoft.com/project" in start:
            kind, converter = "MSPDI", MSP2Ifc()
        elif b"<APIBusinessObjects" in start:
            kind, converter = "P6 XML", P62Ifc()
        else:
            raise ScheduleError(
                f"{plan}: neither an XER or XML file of Primavera P6 nor an XML file of Microsoft Project"
            )
        converter.xml, converter.file = str(plan), file
        try:
            converter.execute()
        except Exception as error:  # noqa: BLE001 it raises whatever a file makes it stumble over
            raise ScheduleError(
                f"{plan}: cannot be read as {kind}: {type(error).__name__}: {error}; export it anew, from P6 as XML"
            ) from error
    return kind


def _named(file: ifcopenshell.file, field: str) -> dict[str, list[Any]]:
    named = defaultdict(list)
    for entity in (each for kind in _NAMED for each in file.by_type(kind)):
        if text := _text(entity, field):
            named[text.casefold()].append(entity)
    return named


def _text(entity: Any, field: str) -> str:
    """Return an attribute or a property (``Pset.Property``, or of any set) as a text, empty without one."""
    import ifcopenshell.util.element

    value = getattr(entity, field, None)
    if value is None:
        within, _, name = field.rpartition(".")
        sets = ifcopenshell.util.element.get_psets(entity)
        value = next((each[name] for key, each in sets.items() if within in ("", key) and name in each), None)
    return "" if value is None else str(value).strip()


def _assign(file: ifcopenshell.file, task: Any, product: Any) -> None:
    import ifcopenshell.guid

    file.create_entity(
        "IfcRelAssignsToProduct", GlobalId=ifcopenshell.guid.new(), RelatedObjects=[task], RelatingProduct=product
    )


def _examples(texts: Any) -> str:
    return ", ".join(repr(text) for text in list(dict.fromkeys(filter(None, texts)))[:3]) or "nothing"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="work schedule",
        description="A plan of Primavera P6 (XER, XML) or Microsoft Project (XML) becomes the schedule of a building model.",
    )
    parser.add_argument("model", type=Path, help="an IFC file without tasks")
    parser.add_argument("plan", type=Path, help="XER or XML of Primavera P6, XML of Microsoft Project")
    parser.add_argument("--output", type=Path, metavar="FILE", help="the model with the schedule [MODEL_PLAN.ifc]")
    parser.add_argument(
        "--activity", default="Name", metavar="FIELD",
        help="what of an activity names elements: Name, Identification (its code), or a user-defined field or code [Name]",
    )  # fmt: skip
    parser.add_argument(
        "--element", default="Name", metavar="FIELD",
        help="what of an element, group or storey is named: Name, Tag, GlobalId, or Pset.Property [Name]",
    )  # fmt: skip
    parser.add_argument(
        "--pattern", default="{}", metavar="TEXT",
        help="the activity's text, {} for the elements, as 'Place {}'; several with commas between them, * and ? for any [{}]",
    )  # fmt: skip
    return parser
