"""Writes krl/: KRL programs, RSI contexts and Ethernet XMLs for the controller, all from the table of channels in krl_variants.py.

Every file says who may use it and that it was not tried on a controller. Run it after a change; a test compares the files.
Facts: the numbers of objects, parameters and channels are those of KUKA's RSI (docs/rsi.md, section 6).
"""

from __future__ import annotations

import argparse
import sys
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from krl_program import program
from krl_variants import FLAG, PRECISION, SPAN, TIMEOUT, TRACK, VARIANTS, Variant

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.tool import read_tool
from construction_twin.rsi.make import NOTICE, ethernet_xml_text

ROOT = Path(__file__).resolve().parents[1]
#: Objects whose inputs are Boolean.
LOGIC = ("AND", "NOT", "SETDIGOUT", "RESETDIGOUT")


@dataclass(frozen=True)
class Link:
    """An object's input: its name and number, and the output of an object that it is connected to."""

    name: str
    own: int
    output: int
    source: str = "ETHERNET1"


@dataclass(frozen=True)
class RsiObject:
    """An object of the context: parameters are (name, RSI 3 number, value, public)."""

    kind: str
    number: int
    name: str
    inputs: tuple[Link, ...] = ()
    parameters: tuple[tuple[str, int, object, bool], ...] = ()


# -- the content -------------------------------------------------------------------------------------------------------


def objects(variant: Variant) -> list[RsiObject]:
    """Return the objects of a context; numbers as in RSI 3, which counts from 1."""
    parameters = (
        ("ConfigFile", 1, variant.ethernet, False),
        ("Timeout", 1, TIMEOUT, False),
        ("Flag", 4, FLAG, False),
        ("Precision", 8, PRECISION, False),
    )
    read = _signals(variant)
    found = [RsiObject("ETHERNET", 64, "ETHERNET1", tuple(link for link, _ in read), parameters)]
    if variant.read_only:
        return found
    lower = tuple((f"LowerLim{a}", i, -s, True) for i, (a, s) in enumerate(SPAN.items(), 1))
    upper = tuple((f"UpperLim{a}", i, s, True) for i, (a, s) in enumerate(SPAN.items(), 13))
    inputs = tuple(Link(f"CorrA{i}", i, i + 1) for i in range(1, 7))
    found.append(RsiObject("AXISCORR", 33, "AXISCORR1", inputs, lower + upper))
    if variant.external:
        lower = tuple((f"LowerLimE{i}", i + 6, -TRACK if i == 1 else -5, True) for i in range(1, 7))
        upper = tuple((f"UpperLimE{i}", i + 18, TRACK if i == 1 else 5, True) for i in range(1, 7))
        found.append(RsiObject("AXISCORREXT", 33, "AXISCORREXT1", (Link("CorrE1", 7, 8),), lower + upper))
    monitor = [(f"Max{a}", i, s, True) for i, (a, s) in enumerate(SPAN.items(), 1)]
    monitor += [(f"MaxE{i}", i + 6, TRACK if i == 1 and variant.external else 6, True) for i in range(1, 7)]
    found.append(RsiObject("AXISCORRMON", 82, "AXISCORRMON1", (), tuple(monitor)))
    # mode 4, ExitMoveCorr: RSI_MOVECORR ends and the program goes on
    found.append(
        RsiObject("STOP", 18, "STOP1", (Link("In1", 1, 1),), (("Mode", 1, 4, False), ("Channel", 2, 0, False)))
    )
    return [*found, *(item for _, item in read), *_switches(variant)]


def _signals(variant: Variant) -> list[tuple[Link, RsiObject]]:
    """Return what reads the tool's outputs and inputs, and the inputs of ETHERNET that they are connected to."""
    found, wanted = [], [("DIGOUT", 43, variant.first_out, len(variant.outputs))]
    wanted.append(("DIGIN", 29, variant.first_in, len(variant.inputs)))
    for kind, number, first, count in wanted:
        for n in range(count):
            # a single signal: its number is that of $OUT or $IN
            parameters = (("Index", 1, first + n, False), ("DataSize", 2, 0, False))
            item = RsiObject(kind, number, f"{kind}{n + 1}", (), parameters)
            found.append((Link(f"In{len(found) + 1}", len(found) + 1, 1, item.name), item))
    return found


def _switches(variant: Variant) -> list[RsiObject]:
    """Return what sets and resets each output, on the rising edge of its channel and of its opposite, while Set.Enable is 1."""
    found = []
    channel = {tag: index for tag, _, index, _ in variant.channels}
    for n, name in enumerate(variant.outputs, 1):
        enable, wanted = channel["Set.Enable"], channel[f"Set.{name}"]
        index = (("Index", 1, variant.first_out + n - 1, False),)
        on, off = f"AND{2 * n - 1}", f"AND{2 * n}"
        found += [
            RsiObject("NOT", 10, f"NOT{n}", (Link("In1", 1, wanted),)),
            RsiObject("AND", 8, on, (Link("In1", 1, enable), Link("In2", 2, wanted))),
            RsiObject("AND", 8, off, (Link("In1", 1, enable), Link("In2", 2, 1, f"NOT{n}"))),
            RsiObject("SETDIGOUT", 12, f"SETDIGOUT{n}", (Link("In1", 1, 1, on),), index),
            RsiObject("RESETDIGOUT", 13, f"RESETDIGOUT{n}", (Link("In1", 1, 1, off),), index),
        ]
    return found


def ethernet_xml(variant: Variant) -> str:
    """Return the Ethernet XML."""
    return ethernet_xml_text(variant.axes, not variant.read_only, variant.outputs, variant.inputs)


# -- RSI 3: .rsi.xml, .rsi, .rsi.diagram ---------------------------------------------------------------------------------


def rsi_xml(variant: Variant) -> str:
    """Return what an RSI 3 controller executes."""
    schema = "/Roboter/Config/System/Common/Schemes/RSIContext.xsd"
    lines = [
        '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>',
        f"<!-- {NOTICE} -->",
        f'<RSIObjects xsi:noNamespaceSchemaLocation="{schema}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">',
    ]
    for item in objects(variant):
        lines.append(f'  <RSIObject ObjType="{item.kind}" ObjTypeID="{item.number}" ObjID="{item.name}">')
        if item.inputs:
            lines.append("    <Inputs>")
            for link in item.inputs:
                lines.append(f'      <Input InIdx="{link.own}" OutObjID="{link.source}" OutIdx="{link.output}"/>')
            lines.append("    </Inputs>")
        if item.parameters:
            lines.append("    <Parameters>")
            for name, number, value, public in item.parameters:
                more = ' IsPublic="true"' if public else ' IsRuntime="false"' if name == "ConfigFile" else ""
                lines.append(f'      <Parameter Name="{name}" ParamID="{number}" ParamValue="{value}"{more}/>')
            lines.append("    </Parameters>")
        lines.append("  </RSIObject>")
    return "\n".join([*lines, "</RSIObjects>"]) + "\n"


def outputs(variant: Variant, item: RsiObject) -> list[str]:
    """Return the names of an object's output ports."""
    return {
        "ETHERNET": [f"Out{index}" for _, _, index, _ in variant.channels],
        "AXISCORR": ["Stat", *SPAN],
        "AXISCORREXT": ["Stat", *(f"E{i}" for i in range(1, 7))],
        "AXISCORRMON": [*SPAN, *(f"E{i}" for i in range(1, 7))],
    }.get(item.kind, ["Out1"] if item.kind in ("AND", "NOT", "DIGIN", "DIGOUT") else [])


def rsi_model(variant: Variant) -> str:
    """Return the model that RSIVisual opens."""
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- {NOTICE} -->",
        '<rSIModel dslVersion="1.0.0.0" name="" xmlns="http://schemas.microsoft.com/dsltools/RSIVisual">',
        "  <rSIObjects>",
    ]
    for item in objects(variant):
        ports = 64 if item.kind == "ETHERNET" else 0
        lines.append(
            f'    <rSIElement name="{item.name}" objType="{item.kind}" objTypeID="{item.number}" '
            f'maxInputs="{ports}" maxOutputs="{ports}">'
        )
        if item.inputs:
            lines.append("      <rSIInPorts>")
            for link in item.inputs:
                kind = 'signalType="Bool"' if item.kind in ("STOP", *LOGIC) else 'mandatory="false"'
                lines += [
                    f'        <rSIInPort name="{link.name}" {kind}>',
                    f'          <source><rSIOutPortMoniker name="//{link.source}/Out{link.output}"/></source>',
                    "        </rSIInPort>",
                ]
            lines.append("      </rSIInPorts>")
        if outputs(variant, item):
            lines.append("      <rSIOutPorts>")
            for name in outputs(variant, item):
                whole = name == "Stat" or item.kind in ("DIGIN", "DIGOUT")
                kind = ' signalType="Int"' if whole else ' signalType="Bool"' if item.kind in LOGIC else ""
                lines.append(f'        <rSIOutPort name="{name}"{kind}/>')
            lines.append("      </rSIOutPorts>")
        if item.parameters:
            lines.append("      <rSIParameters>")
            lines += [_model_parameter(*parameter) for parameter in item.parameters]
            lines.append("      </rSIParameters>")
        lines.append("    </rSIElement>")
    return "\n".join([*lines, "  </rSIObjects>", "</rSIModel>"]) + "\n"


def _model_parameter(name: str, number: int, value: object, public: bool) -> str:
    kind, low, high, more = "System.Double", -2147483648, 2147483647, ""
    if name == "ConfigFile":
        kind, more = "System.FileName", ' isRuntime="false"'
    elif name == "Mode":
        kind, value, more = "KUKA.RSIVisual.RSI_StopType", "ExitMoveCorr", ""
    elif name == "DataSize":
        kind, value = "KUKA.RSIVisual.RSI_DataSize", "Bit"
    elif not public:
        kind = "System.Int32"
        low, high = {"Flag": (-1, 999), "Precision": (1, 32), "Index": (1, 4096)}.get(name, (0, high))
    elif name.startswith("Max"):
        low = 0
    more += ' isPublic="true"' if public else ""
    return (
        f'        <rSIParameter name="{name}" value="{value}" paramType="{kind}" minVal="{low}" maxVal="{high}" '
        f'isEnum="{str(name in ("Mode", "DataSize")).lower()}"{more} index="{number}"/>'
    )


def rsi_diagram(variant: Variant) -> str:
    """Return where RSIVisual draws what; nothing on the controller reads it."""
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- {NOTICE} -->",
        f'<rSIObjectDiagram dslVersion="1.0.0.0" absoluteBounds="0, 0, 12, 24" name="{variant.name}">',
        '  <rSIModelMoniker name="/"/>',
        "  <nestedChildShapes>",
    ]
    top, ids, links = 1.0, {}, []
    for item in objects(variant):
        left = 2.0 if item.kind == "ETHERNET" else 7.0
        ports = [("In", link.name) for link in item.inputs] + [("Out", name) for name in outputs(variant, item)]
        height = 0.5 + 0.4 * max(1, len(ports))
        y = 1.0 if item.kind == "ETHERNET" else top
        shape = _identity(variant, item.name)
        lines += [
            f'    <rSIElementShape Id="{shape}" absoluteBounds="{left}, {y:.2f}, 1.5, {height:.2f}" fillColor="BlanchedAlmond">',
            f'      <rSIElementMoniker name="//{item.name}"/>',
            "      <relativeChildShapes>",
        ]
        for row, (side, name) in enumerate(ports):
            ids[item.name, name] = _identity(variant, f"{item.name}/{name}")
            x = left - 0.4 if side == "In" else left + 1.5
            lines += [
                f'        <rSI{side}PortShape Id="{ids[item.name, name]}" '
                f'absoluteBounds="{x}, {y + 0.25 + 0.4 * row:.2f}, 0.4, 0.075" fillColor="White">',
                f'          <rSI{side}PortMoniker name="//{item.name}/{name}"/>',
                "          <relativeChildShapes/>",
                f"        </rSI{side}PortShape>",
            ]
        lines += ["      </relativeChildShapes>", "    </rSIElementShape>"]
        links += [(ids[item.name, link.name], (link.source, f"Out{link.output}")) for link in item.inputs]
        top += 0.0 if item.kind == "ETHERNET" else height + 0.5
    for target, output in links:
        lines += [
            '    <rSISignalConnector fixedFrom="Algorithm" fixedTo="Algorithm">',
            "      <nodes>",
            f'        <rSIInPortShapeMoniker Id="{target}"/>',
            f'        <rSIOutPortShapeMoniker Id="{ids[output]}"/>',
            "      </nodes>",
            "    </rSISignalConnector>",
        ]
    return "\n".join([*lines, "  </nestedChildShapes>", "</rSIObjectDiagram>"]) + "\n"


def _identity(variant: Variant, name: str) -> uuid.UUID:
    return uuid.uuid5(uuid.NAMESPACE_URL, f"construction_twin/krl/{variant.name}/{name}")


# -- RSI 4.1: .rsix ------------------------------------------------------------------------------------------------------

#: Names of the objects in RSI 4.1; AxisCorrExt is an object of its own there.
NAMES_41 = {
    "ETHERNET": ("Ethernet", 64), "AXISCORR": ("AxisCorr", 33), "AXISCORREXT": ("AxisCorrExt", 87),
    "AXISCORRMON": ("AxisCorrMon", 82), "STOP": ("Stop", 18), "DIGIN": ("DigIn", 29), "DIGOUT": ("DigOut", 43),
    "SETDIGOUT": ("SetDigOut", 12), "RESETDIGOUT": ("ResetDigOut", 13), "AND": ("AND", 8), "NOT": ("NOT", 10),
}  # fmt: skip
#: Parameters that have another name there.
PARAMETERS_41 = {"DataSize": "DataType"}


def rsix(variant: Variant) -> str:
    """Return the single-file context; everything is counted from 0, per object without gaps."""
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- {NOTICE} -->",
        '<RsiContext xsi:schemaLocation="RsiContext RsiContext.xsd" SchemaVersion="2.0.0" '
        'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xmlns="RsiContext">',
        '  <RsiObjects xmlns="RsiDriver">',
    ]
    for item in objects(variant):
        kind, number = NAMES_41[item.kind]
        lines.append(f'    <RsiObject ObjTypeId="{number}" ObjType="{kind}" ObjId="{_name_41(item.name)}">')
        if item.inputs:
            lines.append("      <Inputs>")
            first = 7 if item.kind == "AXISCORREXT" else 1
            for link in item.inputs:
                source = _name_41(link.source)
                lines.append(
                    f'        <Input InIdx="{link.own - first}" OutObjId="{source}" OutIdx="{link.output - 1}"/>'
                )
            lines.append("      </Inputs>")
        if item.parameters:
            lines.append("      <Parameters>")
            for position, (name, number, value, public) in enumerate(item.parameters):
                number, name = position if public else number - 1, PARAMETERS_41.get(name, name)
                more = ' IsPublic="true"' if public else ' IsRuntime="false"' if name == "ConfigFile" else ""
                lines.append(f'        <Parameter{more} Name="{name}" ParamId="{number}" ParamValue="{value}"/>')
            lines.append("      </Parameters>")
        lines.append("    </RsiObject>")
    return "\n".join([*lines, "  </RsiObjects>", "</RsiContext>"]) + "\n"


def _name_41(name: str) -> str:
    """Return an object's name of RSI 3, e.g. ``AND2``, as RSI 4.1 writes it."""
    kind = name.rstrip("0123456789")
    return f"{NAMES_41[kind][0]}_{name[len(kind) :]}"


# -- files ---------------------------------------------------------------------------------------------------------------


def files(variants: Iterable[Variant] = VARIANTS) -> Iterable[tuple[str, str]]:
    """Yield path under krl/ and text of every file."""
    for variant in variants:
        name = variant.name
        yield f"ethernet/{variant.ethernet}", ethernet_xml(variant)
        yield f"rsi3/SensorInterface/{name}.rsi.xml", rsi_xml(variant)
        yield f"rsi3/SensorInterface/{name}.rsi", rsi_model(variant)
        yield f"rsi3/SensorInterface/{name}.rsi.diagram", rsi_diagram(variant)
        yield f"rsi3/Program/{name}.src", program(variant, rsi41=False)
        yield f"rsi41/SensorInterface/{name}.rsix", rsix(variant)
        yield f"rsi41/Program/{name}.src", program(variant, rsi41=True)


def tool_variants(path: Path, first_out: int, first_in: int) -> list[Variant]:
    """Return the sets of files for a tool file, with and without track."""
    tool = read_tool(path).tool
    outputs = {name: output.on_stop == "keep" for name, output in tool.outputs.items()}
    numbers = {"first_out": first_out, "first_in": first_in}
    return [
        Variant(name, external, outputs=outputs, inputs=tool.inputs, **numbers)
        for name, external in (("ctwin_tool", False), ("ctwin_e1_tool", True))
    ]


def main(argv: list[str] | None = None) -> int:
    """Write the files; return the exit code."""
    parser = argparse.ArgumentParser(
        description="Write krl/, or the files of ctwin_tool and ctwin_e1_tool for another tool."
    )
    parser.add_argument("--tool", type=Path, help="tool file; without it the files of krl/ are written")
    parser.add_argument("--to", type=Path, help="folder for the files of --tool")
    parser.add_argument("--first-out", type=int, default=1, help="number of the first output in $OUT [%(default)s]")
    parser.add_argument("--first-in", type=int, default=1, help="number of the first input in $IN [%(default)s]")
    given = parser.parse_args(argv)
    if (given.tool is None) != (given.to is None):
        parser.error("--tool and --to belong together")
    variants, folder = VARIANTS, ROOT / "krl"
    if given.tool is not None:
        try:
            variants, folder = tool_variants(given.tool, given.first_out, given.first_in), given.to
        except ConfigurationError as error:
            sys.exit(f"make_krl: {error}")
    for name, text in files(variants):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
