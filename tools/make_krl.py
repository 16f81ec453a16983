"""Writes krl/: KRL programs, RSI contexts and Ethernet XMLs for the controller, all from the table of channels in krl_variants.py.

Every file says who may use it and that it was not tried on a controller. Run it after a change; a test compares the files.
Facts: the numbers of objects, parameters and channels are those of KUKA's RSI (docs/controller.md names where they come from).
"""

from __future__ import annotations

import sys
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from krl_program import program
from krl_variants import FLAG, PRECISION, SPAN, TIMEOUT, TRACK, VARIANTS, Variant

from construction_twin.rsi.ethernet_xml_text import NOTICE, ethernet_xml_text

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class RsiObject:
    """An object of the context: inputs as (own input, ETHERNET output), parameters as (name, RSI 3 number, value, public)."""

    kind: str
    number: int
    name: str
    inputs: tuple[tuple[str, int, int], ...] = ()
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
    found = [RsiObject("ETHERNET", 64, "ETHERNET1", (), parameters)]
    if variant.read_only:
        return found
    lower = tuple((f"LowerLim{a}", i, -s, True) for i, (a, s) in enumerate(SPAN.items(), 1))
    upper = tuple((f"UpperLim{a}", i, s, True) for i, (a, s) in enumerate(SPAN.items(), 13))
    inputs = tuple((f"CorrA{i}", i, i + 1) for i in range(1, 7))
    found.append(RsiObject("AXISCORR", 33, "AXISCORR1", inputs, lower + upper))
    if variant.external:
        lower = tuple((f"LowerLimE{i}", i + 6, -TRACK if i == 1 else -5, True) for i in range(1, 7))
        upper = tuple((f"UpperLimE{i}", i + 18, TRACK if i == 1 else 5, True) for i in range(1, 7))
        found.append(RsiObject("AXISCORREXT", 33, "AXISCORREXT1", (("CorrE1", 7, 8),), lower + upper))
    monitor = [(f"Max{a}", i, s, True) for i, (a, s) in enumerate(SPAN.items(), 1)]
    monitor += [(f"MaxE{i}", i + 6, TRACK if i == 1 and variant.external else 6, True) for i in range(1, 7)]
    found.append(RsiObject("AXISCORRMON", 82, "AXISCORRMON1", (), tuple(monitor)))
    # mode 4, ExitMoveCorr: RSI_MOVECORR ends and the program goes on
    found.append(RsiObject("STOP", 18, "STOP1", (("In1", 1, 1),), (("Mode", 1, 4, False), ("Channel", 2, 0, False))))
    return found


def ethernet_xml(variant: Variant) -> str:
    """Return the Ethernet XML."""
    axes = [*SPAN, *(["E1"] if variant.external else [])]
    return ethernet_xml_text(axes, receives=not variant.read_only)


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
            for _, own, output in item.inputs:
                lines.append(f'      <Input InIdx="{own}" OutObjID="ETHERNET1" OutIdx="{output}"/>')
            lines.append("    </Inputs>")
        lines.append("    <Parameters>")
        for name, number, value, public in item.parameters:
            more = ' IsPublic="true"' if public else ' IsRuntime="false"' if name == "ConfigFile" else ""
            lines.append(f'      <Parameter Name="{name}" ParamID="{number}" ParamValue="{value}"{more}/>')
        lines += ["    </Parameters>", "  </RSIObject>"]
    return "\n".join([*lines, "</RSIObjects>"]) + "\n"


def outputs(variant: Variant, item: RsiObject) -> list[str]:
    """Return the names of an object's output ports."""
    return {
        "ETHERNET": [f"Out{index}" for _, _, index, _ in variant.channels],
        "AXISCORR": ["Stat", *SPAN],
        "AXISCORREXT": ["Stat", *(f"E{i}" for i in range(1, 7))],
        "AXISCORRMON": [*SPAN, *(f"E{i}" for i in range(1, 7))],
    }.get(item.kind, [])


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
            for name, _, output in item.inputs:
                kind = 'signalType="Bool"' if item.kind == "STOP" else 'mandatory="false"'
                lines += [
                    f'        <rSIInPort name="{name}" {kind}>',
                    f'          <source><rSIOutPortMoniker name="//ETHERNET1/Out{output}"/></source>',
                    "        </rSIInPort>",
                ]
            lines.append("      </rSIInPorts>")
        if outputs(variant, item):
            lines.append("      <rSIOutPorts>")
            for name in outputs(variant, item):
                kind = ' signalType="Int"' if name == "Stat" else ""
                lines.append(f'        <rSIOutPort name="{name}"{kind}/>')
            lines.append("      </rSIOutPorts>")
        lines.append("      <rSIParameters>")
        lines += [_model_parameter(*parameter) for parameter in item.parameters]
        lines += ["      </rSIParameters>", "    </rSIElement>"]
    return "\n".join([*lines, "  </rSIObjects>", "</rSIModel>"]) + "\n"


def _model_parameter(name: str, number: int, value: object, public: bool) -> str:
    kind, low, high, more = "System.Double", -2147483648, 2147483647, ""
    if name == "ConfigFile":
        kind, more = "System.FileName", ' isRuntime="false"'
    elif name == "Mode":
        kind, value, more = "KUKA.RSIVisual.RSI_StopType", "ExitMoveCorr", ""
    elif not public:
        kind = "System.Int32"
        low, high = {"Flag": (-1, 999), "Precision": (1, 32)}.get(name, (0, high))
    elif name.startswith("Max"):
        low = 0
    more += ' isPublic="true"' if public else ""
    return (
        f'        <rSIParameter name="{name}" value="{value}" paramType="{kind}" minVal="{low}" maxVal="{high}" '
        f'isEnum="{str(name == "Mode").lower()}"{more} index="{number}"/>'
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
        ports = [("In", name) for name, _, _ in item.inputs] + [("Out", name) for name in outputs(variant, item)]
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
        links += [(ids[item.name, name], f"Out{output}") for name, _, output in item.inputs]
        top += 0.0 if item.kind == "ETHERNET" else height + 0.5
    for target, output in links:
        lines += [
            '    <rSISignalConnector fixedFrom="Algorithm" fixedTo="Algorithm">',
            "      <nodes>",
            f'        <rSIInPortShapeMoniker Id="{target}"/>',
            f'        <rSIOutPortShapeMoniker Id="{ids["ETHERNET1", output]}"/>',
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
    "AXISCORRMON": ("AxisCorrMon", 82), "STOP": ("Stop", 18),
}  # fmt: skip


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
        lines.append(f'    <RsiObject ObjTypeId="{number}" ObjType="{kind}" ObjId="{kind}_1">')
        if item.inputs:
            lines.append("      <Inputs>")
            first = 7 if item.kind == "AXISCORREXT" else 1
            for _, own, output in item.inputs:
                lines.append(f'        <Input InIdx="{own - first}" OutObjId="Ethernet_1" OutIdx="{output - 1}"/>')
            lines.append("      </Inputs>")
        lines.append("      <Parameters>")
        for position, (name, number, value, public) in enumerate(item.parameters):
            number = position if public else number - 1
            more = ' IsPublic="true"' if public else ' IsRuntime="false"' if name == "ConfigFile" else ""
            lines.append(f'        <Parameter{more} Name="{name}" ParamId="{number}" ParamValue="{value}"/>')
        lines += ["      </Parameters>", "    </RsiObject>"]
    return "\n".join([*lines, "  </RsiObjects>", "</RsiContext>"]) + "\n"


# -- files ---------------------------------------------------------------------------------------------------------------


def files() -> Iterable[tuple[str, str]]:
    """Yield path under krl/ and text of every file."""
    for variant in VARIANTS:
        name = variant.name
        yield f"ethernet/{variant.ethernet}", ethernet_xml(variant)
        yield f"rsi3/SensorInterface/{name}.rsi.xml", rsi_xml(variant)
        yield f"rsi3/SensorInterface/{name}.rsi", rsi_model(variant)
        yield f"rsi3/SensorInterface/{name}.rsi.diagram", rsi_diagram(variant)
        yield f"rsi3/Program/{name}.src", program(variant, rsi41=False)
        yield f"rsi41/SensorInterface/{name}.rsix", rsix(variant)
        yield f"rsi41/Program/{name}.src", program(variant, rsi41=True)


def main() -> int:
    """Write the files; return the exit code."""
    for name, text in files():
        path = ROOT / "krl" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
