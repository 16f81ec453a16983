"""krl/: what the RSI contexts of a tool do with its outputs, evaluated object by object, and that the mock does the same."""

from __future__ import annotations

from xml.etree import ElementTree

import make_krl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import ROOT
from tool_cell import GRIPPER, LAYOUT

from construction_twin.mock.gripper import SimulatedTool
from construction_twin.rsi.ethernet_xml import load_ethernet_xml

FOLDER = ROOT / "krl"
NAMES = ("ctwin_tool", "ctwin_e1_tool")


class Graph:
    """A context as the controller evaluates it: the published meaning of AND, NOT, SETDIGOUT, RESETDIGOUT, DIGOUT and DIGIN."""

    def __init__(self, path):
        root = ElementTree.parse(path).getroot()
        self.objects = {}
        for item in root.iter():
            name = item.get("ObjID") or item.get("ObjId")
            if name is None:
                continue
            links = {
                int(i.get("InIdx")): (i.get("OutObjID") or i.get("OutObjId"), int(i.get("OutIdx")))
                for i in item.iter()
                if i.tag.endswith("Input")
            }
            parameters = {p.get("Name"): p.get("ParamValue") for p in item.iter() if p.tag.endswith("Parameter")}
            self.objects[name] = (item.get("ObjType").upper(), links, parameters)
        #: Where outputs of an object begin to count.
        self.first = 1 if path.suffix == ".xml" else 0
        self.out = {}
        self.levels = {}
        self.channels = {}

    def value(self, source, index):
        kind, links, parameters = self.objects[source]
        if kind == "ETHERNET":
            return self.channels.get(index - self.first + 1, False)
        read = [self.value(*links[own]) for own in sorted(links)]
        if kind in ("DIGOUT", "DIGIN"):
            return self.out.get(int(parameters["Index"]), False)
        return {"AND": all, "NOT": lambda values: not values[0]}[kind](read)

    def step(self):
        edges = []
        for name, (kind, links, parameters) in self.objects.items():
            if kind in ("SETDIGOUT", "RESETDIGOUT"):
                level = self.value(*links[self.first])
                if level and not self.levels.get(name, False):
                    edges.append((int(parameters["Index"]), kind == "SETDIGOUT"))
                self.levels[name] = level
        for number, value in edges:
            self.out[number] = value


def contexts(name):
    return (
        FOLDER / "rsi3" / "SensorInterface" / f"{name}.rsi.xml",
        FOLDER / "rsi41" / "SensorInterface" / f"{name}.rsix",
    )


def indices(name, section):
    root = ElementTree.parse(FOLDER / "ethernet" / f"{name}_ethernet.xml").getroot()
    found = {e.get("TAG"): e.get("INDX") for e in root.find(f"{section}/ELEMENTS")}
    return {tag: int(index) for tag, index in found.items() if index != "INTERNAL"}


@pytest.mark.parametrize("path", [path for name in NAMES for path in contexts(name)], ids=lambda path: path.name)
def test_without_a_reply_no_output_changes_and_with_one_only_as_enabled(path):
    name = path.name.split(".")[0]
    channel = indices(name, "RECEIVE")
    for before in (False, True):
        graph = Graph(path)
        graph.out[1] = before
        for _ in range(3):
            # RSI_ON: every channel of ETHERNET is 0 until the first reply
            graph.step()
            assert graph.out[1] is before
        graph.channels = {channel["Set.vacuum"]: True}
        graph.step()
        assert graph.out[1] is before
        for value in (before, not before, before):
            graph.channels = {channel["Set.Enable"]: True, channel["Set.vacuum"]: value}
            graph.step()
            assert graph.out[1] is value


@given(
    st.booleans(),
    st.lists(st.one_of(st.none(), st.tuples(st.booleans(), st.booleans())), max_size=30),
    st.booleans(),
)
def test_the_mock_does_what_the_context_does(before, replies, held):
    """None is a missed reply: HOLDON decides."""
    layout = LAYOUT if held else type(LAYOUT)(**vars(LAYOUT) | {"switched_holdon": (True, False)})
    mock = SimulatedTool(layout, GRIPPER, 0.004)
    mock.outputs["vacuum"] = before
    graph = Graph(contexts("ctwin_tool")[0])
    graph.out[1] = before
    channel = indices("ctwin_tool", "RECEIVE")
    enable, vacuum = channel["Set.Enable"], channel["Set.vacuum"]
    graph.step()
    for reply in replies:
        if reply is None:
            mock.on_missed_reply()
            graph.channels[vacuum] = graph.channels.get(vacuum, False) and held
        else:
            mock.on_reply(reply)
            graph.channels = {enable: reply[0], vacuum: reply[1]}
        graph.step()
        assert mock.outputs["vacuum"] is graph.out[1]


@pytest.mark.parametrize("name", NAMES)
def test_outputs_and_inputs_are_read_back_on_the_channels_that_are_declared(name):
    sent = indices(name, "SEND")
    assert sent == {"Out.vacuum": 1, "In.vacuum_reached": 2}
    for path, first in zip(contexts(name), (1, 0)):
        graph = Graph(path)
        ethernet = next(links for kind, links, _ in graph.objects.values() if kind == "ETHERNET")
        assert [graph.objects[ethernet[k + first][0]][0] for k in range(2)] == ["DIGOUT", "DIGIN"]
        for kind, _, parameters in graph.objects.values():
            if kind in ("DIGOUT", "DIGIN"):
                # bit: then Index is the number of $OUT or $IN itself
                assert {"DataSize", "DataType"} & set(parameters)
                assert "0" in (parameters.get("DataSize"), parameters.get("DataType"))


def test_files_for_another_tool_hold_its_names_numbers_and_holdon(tmp_path):
    tool = tmp_path / "clamp.yaml"
    text = (ROOT / "config/tools/vacuum_frame.yaml").read_text()
    text = text.replace(
        "vacuum: {on_stop: keep, opens: false}", "vacuum: {on_stop: keep, opens: false}\n  lamp: {on_stop: off}"
    )
    tool.write_text(text)
    assert make_krl.main(["--tool", str(tool), "--to", str(tmp_path / "krl"), "--first-out", "33"]) == 0
    layout = load_ethernet_xml(tmp_path / "krl/ethernet/ctwin_tool_ethernet.xml").layout
    assert layout.switched == ("Enable", "vacuum", "lamp")
    assert layout.switched_holdon == (True, True, False)
    code = (tmp_path / "krl/rsi3/Program/ctwin_tool.src").read_text()
    assert "$OUT[34] = FALSE" in code and "$OUT[33] = FALSE" not in code
    graph = Graph(tmp_path / "krl/rsi3/SensorInterface/ctwin_tool.rsi.xml")
    numbers = [p["Index"] for kind, _, p in graph.objects.values() if kind == "SETDIGOUT"]
    assert numbers == ["33", "34"]
