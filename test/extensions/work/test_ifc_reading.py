"""Reading in a process of its own: what comes back, the cache, and hostile files, each of which ends in one sentence.

Most hostile files are read in a fork of this process within the same limits, which saves the start of an interpreter each.
"""

from __future__ import annotations

import base64
import json
import multiprocessing
import os
import re
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ifc_models import IfcModel, noted

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.building import BuildingError, BuildingModel
from construction_twin.extensions.work.ifc import reading
from construction_twin.extensions.work.ifc.reader import read_ifc
from construction_twin.extensions.work.ifc.reading import Bounds, read_building


def house():
    """A model with a little of everything."""
    model = IfcModel()
    assembly = model.element("IfcElementAssembly", "panel", at=(1.0, 0.0, 0.0))
    source = model.map_of(model.representation(model.extrusion(model.rectangle(0.1, 0.05), 2.0)))
    studs = [
        model.element(
            "IfcMember", f"stud {k}", model.representation(model.mapped(source), kind="MappedRepresentation"),
            at=(0.6 * k, 0.0, 0.0), within=assembly,
        )
        for k in range(3)
    ]  # fmt: skip
    model.aggregate(assembly, studs)
    wall = model.box("wall", (3.0, 0.2, 2.5), kind="IfcWall")
    model.opening(wall, (1.0, 1.0, 1.0))
    model.properties(studs[0], "CTwin_RobotTask", Grip="top", Speed=0.1)
    tasks = [model.task(stud.Name, [stud]) for stud in studs]
    model.sequence(tasks[0], tasks[1], lag="PT1H")
    return model


TEXT = house().text()


@pytest.fixture
def path(tmp_path):
    """The house as a file."""
    return house().save(tmp_path / "house.ifc")


def same(first: BuildingModel, second: BuildingModel) -> bool:
    """Whether two models say the same."""
    assert (first.digest, first.tasks, first.sequences, first.notes) == (
        second.digest, second.tasks, second.sequences, second.notes,
    )  # fmt: skip
    assert list(first.elements) == list(second.elements)
    for one, other in zip(first.elements.values(), second.elements.values(), strict=True):
        assert (one.name, one.properties, one.mass, one.assembly) == (
            other.name,
            other.properties,
            other.mass,
            other.assembly,
        )
        np.testing.assert_array_equal(one.model_T_element.rotation, other.model_T_element.rotation)
        for body, again in zip(one.bodies, other.bodies, strict=True):
            np.testing.assert_array_equal(body.vertices, again.vertices)
            np.testing.assert_array_equal(body.triangles, again.triangles)
    return True


def test_another_process_reads_the_same_and_the_cache_gives_it_again(path, tmp_path, monkeypatch):
    found = read_building(path, tmp_path / "cache")
    assert same(found, read_ifc(path, 1 << 24))
    (kept,) = (tmp_path / "cache").iterdir()
    assert found.digest in kept.name
    # the file under another name, and no process that could read it
    monkeypatch.setattr(subprocess, "Popen", None)
    renamed = path.rename(tmp_path / "again.ifc")
    again = read_building(renamed, tmp_path / "cache")
    assert again.file == "again.ifc" and same(found, again)


def test_what_is_noted_is_said_behind_the_process_and_from_the_cache(tmp_path):
    model = IfcModel()
    bow = model.element("IfcMember", "bow", model.extrusion(model.polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), 0.1))
    path = tmp_path / "model.ifc"
    path.write_text(model.text())
    for found in (read_building(path, tmp_path / "cache"), read_building(path, tmp_path / "cache")):
        assert "the reader of the file says of what it needs" in found.elements[bow.GlobalId].doubt
        assert noted(found.notes, "the arm does not place it", "the reader of the file says of what it needs")


def test_a_damaged_cache_is_made_anew(path, tmp_path):
    cache = tmp_path / "cache"
    found = read_building(path, cache)
    (kept,) = cache.iterdir()
    whole = kept.read_bytes()
    kept.write_bytes(whole[: len(whole) // 2])
    assert same(found, read_building(path, cache))
    assert kept.read_bytes() == whole


def numbers(array, *shape):
    """An array as the process writes it."""
    kind = array.dtype.kind if array.dtype.kind in "fi" else "f"
    return [kind, base64.b64encode(array.tobytes()).decode(), *(shape or array.shape)]


CORNERS = np.zeros((4, 3))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"triangles": numbers(np.array([[0, 1, 10**6]], dtype=np.int32))}, "corners that are not there"),
        ({"triangles": numbers(np.array([[0, 1, -1]], dtype=np.int32))}, "corners that are not there"),
        ({"triangles": numbers(CORNERS)}, r"float64 and shape \(4, 3\)"),
        ({"vertices": numbers(CORNERS.astype(np.int32))}, r"int32 and shape \(4, 3\)"),
        ({"vertices": numbers(CORNERS.ravel())}, r"shape \(12,\)"),
        ({"vertices": numbers(CORNERS, 5, 3)}, "cannot reshape"),
        ({"vertices": numbers(np.full((4, 3), np.nan))}, "no finite numbers"),
        ({"vertices": ["O", "", 0, 3]}, "KeyError"),
        ({"vertices": ["f", "AAAA", 0, 3]}, "ValueError"),
        ({"vertices": "corners"}, "vertices"),
        ({"position": numbers(np.zeros(4))}, r"a pose is a position of shape"),
    ],
)
def test_what_the_process_wrote_is_checked(tmp_path, path, change, said):
    model = read_ifc(path, 1 << 24)
    kept = tmp_path / "model.json"
    reading.save(model, kept)
    document = json.loads(kept.read_text())
    element = next(each for each in document["model"]["elements"].values() if each["bodies"])
    for record in (element["model_T_element"], element["bodies"][0]):
        record |= {
            name: {model.digest: value} if isinstance(value, list) else value
            for name, value in change.items()
            if name in record
        }
    kept.write_text(json.dumps(document))
    with pytest.raises(BuildingError, match=said) as caught:
        reading.load(kept, model.file, model.digest)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"), [("[]", "TypeError"), ("[" * 10**6, "RecursionError"), ("{}", "KeyError"), ("\x00", "JSONDecode")]
)
def test_what_is_no_model_at_all_is_said_in_one_sentence(tmp_path, text, said):
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(BuildingError, match=said):
        reading.load(tmp_path / "model.json", "x.ifc", "0" * 64)


NOT_WHOLE = {
    "empty": (b"", "nothing in it"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "begins with ISO-10303-21"),
    "zeros": (bytes(1000), "begins with ISO-10303-21"),
    "a zip archive": (b"PK\x03\x04" + bytes(100), "begins with ISO-10303-21"),
    "xml": (b"\xef\xbb\xbf<?xml version='1.0'?><ifcXML/>", "begins with ISO-10303-21"),
    "utf-16": ("ISO-10303-21;\nEND-ISO-10303-21;".encode("utf-16"), "begins with ISO-10303-21"),
}


@pytest.mark.parametrize(("contents", "said"), NOT_WHOLE.values(), ids=NOT_WHOLE)
def test_what_is_no_ifc_file_needs_no_process(tmp_path, monkeypatch, contents, said):
    monkeypatch.setattr(subprocess, "Popen", None)
    (tmp_path / "x.ifc").write_bytes(contents)
    with pytest.raises(BuildingError, match=f"x.ifc: the file: .*{said}"):
        read_building(tmp_path / "x.ifc")


@given(st.integers(0, len(TEXT.rstrip()) - 2))
def test_a_file_that_was_cut_anywhere_is_not_whole(tmp_path_factory, length):
    path = tmp_path_factory.getbasetemp() / "cut.ifc"
    path.write_text(TEXT[:length])
    with pytest.raises(BuildingError, match="not whole|begins with"):
        read_building(path)


def test_a_folder_a_pipe_a_large_and_a_missing_file_are_refused(tmp_path, path):
    os.mkfifo(tmp_path / "pipe.ifc")
    for name in ("", "pipe.ifc", "missing.ifc"):
        with pytest.raises(BuildingError, match="the file"):
            read_building(tmp_path / name)
    with pytest.raises(BuildingError, match="larger than"):
        read_building(path, bounds=Bounds(file_bytes=1000))


def test_without_ifcopenshell_the_sentence_says_what_to_run(path, monkeypatch):
    monkeypatch.setattr(reading.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"run setup/setup\.sh work"):
        read_building(path)


def child(monkeypatch, program):
    """Let this program be the process that reads."""
    start = subprocess.Popen

    def other(arguments, **options):
        return start([sys.executable, "-c", program, *arguments[3:]], **options)

    monkeypatch.setattr(subprocess, "Popen", other)


SAY = "import os, sys, signal; said = open(sys.argv[3] + '.error', 'w'); "
ENDS = {
    "killed": (SAY + "os.kill(os.getpid(), 9)", r"signal 9 \(SIGKILL\)"),
    "silent": (SAY, "code 0 and no result"),
    "nonsense": (SAY + "said.write('hello')", "no result"),
    "endless": (SAY + "said.write('x' * 10**6)", "no result"),
    "error without its parts": (SAY + "said.write('[1]')", "no result"),
    "liar": (SAY + "open(sys.argv[3], 'wb').write(b'PK')", "what the reading process wrote: found JSONDecodeError"),
    "raised": ("raise RuntimeError", "code 1 and no result"),
}


@pytest.mark.parametrize(("program", "said"), ENDS.values(), ids=ENDS)
def test_however_the_process_ends_it_is_one_sentence(path, monkeypatch, program, said):
    child(monkeypatch, program)
    with pytest.raises(BuildingError, match=said) as caught:
        read_building(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_written_meanwhile_is_not_read(path, monkeypatch):
    read_file = reading.read_file
    monkeypatch.setattr(reading, "read_file", lambda *asked: read_file(*asked) + b"\n")
    said = "the file: found other contents when it was read again, expected a file that nobody writes"
    with pytest.raises(BuildingError, match=said):
        read_building(path)


def test_what_the_reading_process_refuses_is_said_by_the_error(path):
    text = path.read_text()
    number = re.search(r"#(\d+)=IFCWALL\(", text)[1]
    path.write_text(re.sub(rf"#{number}=IFCWALL\([^;]*;\n", "", text))
    with pytest.raises(BuildingError, match=f"refers to #{number}, which is not there"):
        read_building(path)


def test_a_process_that_takes_too_long_is_ended(path, monkeypatch):
    child(monkeypatch, "import signal; signal.pause()")
    with pytest.raises(BuildingError, match="more than 0.2 s"):
        read_building(path, bounds=Bounds(wall=0.2))


def test_a_process_that_computes_too_long_or_needs_too_much_is_ended(path):
    with pytest.raises(BuildingError, match="processor time|MiB of memory|code 1"):
        read_building(path, bounds=Bounds(memory_bytes=400 << 20))
    with pytest.raises(BuildingError, match="0 s of processor time"):
        # its imports alone take longer
        read_building(path, bounds=Bounds(cpu=0))


# hostile contents, in forks


def _read_in_fork(path, pipe):
    # beside what the tests before this one have mapped
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + (2 << 30), mapped + (2 << 30)))
    resource.setrlimit(resource.RLIMIT_CPU, (20, 25))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        model = read_ifc(path, 1 << 26)
        pipe.send(("read", (len(model.elements), model.notes)))
    except BuildingError as error:
        pipe.send(("refused", str(error)))
    except MemoryError:
        pipe.send(("refused", "memory"))


def in_fork(path):
    """Read a file in a fork of this process; return how it ended and what it said."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_read_in_fork, args=(path, theirs))
    process.start()
    theirs.close()
    try:
        result = ours.recv()
    except EOFError:
        result = None
    process.join()
    if result is None:
        # an end by a signal is one sentence of `read_building`; an exception that is not ours is none
        assert process.exitcode < 0, f"exit code {process.exitcode}"
        return "ended", signal.Signals(-process.exitcode).name
    return result


def hostile(change):
    """The house's text after a change of its model."""
    model = house()
    change(model)
    return model.text()


def loop_of_placements(model):
    model.site.ObjectPlacement.PlacementRelTo = model.storey.ObjectPlacement


def loop_of_assemblies(model):
    (assembly,) = model.file.by_type("IfcElementAssembly")
    model.aggregate(model.file.by_type("IfcMember")[0], [assembly])


def no_units(model):
    model.project.UnitsInContext = None


def no_project(model):
    model.file.remove(model.project)


def no_length_unit(model):
    (units,) = model.file.by_type("IfcUnitAssignment")
    units.Units = [unit for unit in units.Units if unit.UnitType != "LENGTHUNIT"]


def parallel_axes(model):
    model.box("stud", (0.1, 0.1, 1.0), placement=model.placement(z=(0, 0, 1), x=(0, 0, 1)))


def far_away(model):
    model.box("stud", (0.1, 0.1, 1.0), at=(1e297, 0.0, 0.0))


REFUSED = {
    "placements in a loop": (loop_of_placements, "IFCLOCALPLACEMENT: found placed relative to itself"),
    "assemblies in a loop": (loop_of_assemblies, "part of itself"),
    "no units": (no_units, "no length unit"),
    "no length unit": (no_length_unit, "no length unit"),
    "no project": (no_project, "IFCPROJECT: found none"),
    "parallel axes": (parallel_axes, "no placement"),
    "far away": (far_away, "from the origin|no placement"),
}


@pytest.mark.parametrize(("change", "said"), REFUSED.values(), ids=REFUSED)
def test_a_model_that_makes_no_sense_is_refused_with_its_place(tmp_path, change, said):
    path = tmp_path / "hostile.ifc"
    path.write_text(hostile(change))
    how, found = in_fork(path)
    assert how == "refused"
    assert found.startswith("hostile.ifc: ") and "\n" not in found
    assert re.search(said, found), found


#: What a text of the file becomes, and how that may end.
TEXTS = {
    "a reference to nothing": ("IFCEXTRUDEDAREASOLID(#", "IFCEXTRUDEDAREASOLID(#99999999999,#", None),
    "a number beyond all": ("IFCEXTRUDEDAREASOLID(#", "IFCEXTRUDEDAREASOLID(#4294967297,#", None),
    "not a number": ("2500.", "NaN", None),
    "infinity": ("2500.", "1.E400", None),
    "huge": ("2500.", "1.E300", None),
    "zero depth": ("2500.", "0.", None),
    "a text for a number": ("2500.", "'high'", None),
    "a list for a number": ("2500.", "(" + "(1.)," * 10 + "1.)", None),
    "no scale": (
        "IFCCARTESIANTRANSFORMATIONOPERATOR3D($,$,",
        "IFCCARTESIANTRANSFORMATIONOPERATOR3D($,$,#1,0.,$);/*",
        None,
    ),
    "another schema": ("'IFC4'", "'IFC5X9'", "refused"),
    "an endless text": ("'Ground floor'", "'" + "x" * (1 << 22) + "'", "read"),
    "no utf-8": ("'Ground floor'", "'\xe9t\xe9 \x80\xff'", "read"),
    "a broken escape": ("'Ground floor'", r"'\X2\00', 'x'", None),
    "deep brackets": ("'Ground floor'", "(" * 100_000, None),
    "an entity of no schema": ("IFCMEMBER(", "IFCROBOT(", None),
}


@pytest.mark.parametrize(("old", "new", "end"), TEXTS.values(), ids=TEXTS)
def test_a_text_with_anything_in_it_is_read_or_refused(tmp_path, old, new, end):
    assert old in TEXT
    path = tmp_path / "hostile.ifc"
    path.write_bytes(TEXT.replace(old, new).encode("latin-1"))
    how, found = in_fork(path)
    assert how in ([end] if end else ["read", "refused", "ended"]), found
    if how == "refused":
        assert found == "memory" or found.startswith("hostile.ifc: ") and "\n" not in found


@settings(max_examples=25)
@given(st.lists(st.tuples(st.integers(0, len(TEXT) - 1), st.integers(0, 255)), min_size=1, max_size=4))
def test_bytes_that_flipped_are_read_or_refused(tmp_path_factory, flips):
    contents = bytearray(TEXT.encode("latin-1"))
    for place, value in flips:
        contents[place] = value
    path = tmp_path_factory.getbasetemp() / "flipped.ifc"
    path.write_bytes(contents)
    in_fork(path)
