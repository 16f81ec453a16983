"""Writes krl/: KRL programs, RSI contexts and Ethernet XMLs for the controller, all from the one table of channels below.

Every file says who may use it and that it was not tried on a controller. Run it after a change; a test compares.
Facts: the numbers of objects, parameters and channels are those of KUKA's RSI (docs/controller.md names where they come from).
"""

from __future__ import annotations

import sys
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: Address of the PC and its UDP port; the user edits the address.
ADDRESS, PORT, SENTYPE = "192.168.1.10", 49152, "ImFree"
TIMEOUT, FLAG, PRECISION = 100, 1, 6
#: Length of each axis' range [deg]: a correction can never be larger, wherever the session starts. KR 120 R2500 pro.
SPAN = {"A1": 370, "A2": 135, "A3": 275, "A4": 700, "A5": 250, "A6": 700}
#: Placeholder for a track [mm]: longer than any.
TRACK = 30000
NOTICE = "construction_twin. Written from published facts, NOT TRIED ON A CONTROLLER: check every value before use (docs/controller.md)."


@dataclass(frozen=True)
class Variant:
    """One set of files: its name, whether it moves E1, whether it only listens."""

    name: str
    external: bool = False
    read_only: bool = False

    @property
    def ethernet(self) -> str:
        """Name of the Ethernet XML."""
        return f"{self.name}_ethernet.xml"

    @property
    def channels(self) -> list[tuple[str, str, int, int]]:
        """RECEIVE: TAG, TYPE, INDX, HOLDON."""
        if self.read_only:
            return []
        axes = [(f"AK.A{i}", "DOUBLE", i + 1, 1) for i in range(1, 7)]
        return [("Stop", "BOOL", 1, 0), *axes, *([("EK.E1", "DOUBLE", 8, 1)] if self.external else [])]


VARIANTS = (Variant("ctwin"), Variant("ctwin_e1", external=True), Variant("ctwin_ro", read_only=True))


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
    external = ("EIPos", "ESPos") if variant.external else ()
    send = ["RIst", "RSol", "AIPos", "ASPos", *external]
    lines = [
        "<ROOT>",
        f"  <!-- {NOTICE} -->",
        "  <!-- Gateway and mock read this very file: give them the copy that is on the controller. -->",
        "  <CONFIG>",
        "    <!-- EDIT: address of the PC that runs rsi_gateway, in the RSI subnet -->",
        f"    <IP_NUMBER>{ADDRESS}</IP_NUMBER>",
        f"    <PORT>{PORT}</PORT>",
        f"    <SENTYPE>{SENTYPE}</SENTYPE>",
        f"    <ONLYSEND>{'TRUE' if variant.read_only else 'FALSE'}</ONLYSEND>",
        "  </CONFIG>",
        "  <SEND>",
        "    <ELEMENTS>",
        *(f'      <ELEMENT TAG="DEF_{name}" TYPE="DOUBLE" INDX="INTERNAL"/>' for name in send),
        '      <ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>',
        "    </ELEMENTS>",
        "  </SEND>",
        "  <RECEIVE>",
        "    <ELEMENTS>",
    ]
    for tag, kind, index, holdon in variant.channels:
        lines.append(f'      <ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}" HOLDON="{holdon}"/>')
    return "\n".join([*lines, "    </ELEMENTS>", "  </RECEIVE>", "</ROOT>"]) + "\n"


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


# -- KRL -----------------------------------------------------------------------------------------------------------------


def program(variant: Variant, rsi41: bool) -> str:
    """Return the KRL program of a context."""
    context = variant.name if rsi41 else f"{variant.name}.rsi"
    body = _read_only_body() if variant.read_only else _motion_body(variant, rsi41)
    limits = rsi41 and not variant.read_only
    lines = [
        "&ACCESS RVP",
        "&REL 1",
        f"&COMMENT construction_twin, RSI {'4.1 and later' if rsi41 else '3.x'}: not tried on a controller",
        f"DEF {variant.name}()",
        *(f"; {line}" for line in _heading(variant, rsi41)),
        "DECL INT ret, container",
        "",
        ";FOLD INI",
        "  ;FOLD BASISTECH INI",
        "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM()",
        "    INTERRUPT ON 3",
        "    BAS(#INITMOV, 0)",
        "  ;ENDFOLD (BASISTECH INI)",
        ";ENDFOLD (INI)",
        "",
        "; block coincidence: a motion to where the arm already stands",
        "PTP $AXIS_ACT_MEAS",
        "",
        f'ret = RSI_CREATE("{context}", container, TRUE)',
        *_check("ret"),
        *(["", "ctwin_limits(container)"] if limits else []),
        "",
        *body,
        "",
        "ret = RSI_OFF()",
        *_check("ret"),
        "ret = RSI_DELETE(container)",
        *_check("ret"),
        "END",
    ]
    if limits:
        lines += ["", *_limits(variant)]
    return "\n".join(lines) + "\n"


def _heading(variant: Variant, rsi41: bool) -> list[str]:
    files = f"{variant.name}.rsix" if rsi41 else f"{variant.name}.rsi, .rsi.diagram and .rsi.xml"
    lines = [
        NOTICE,
        f"Needs {files}, and {variant.ethernet}, in Config/User/Common/SensorInterface.",
        "Start rsi_gateway on the PC first: the exchange begins with RSI_ON.",
    ]
    if variant.read_only:
        return [*lines, "The controller only reports (ONLYSEND TRUE): nothing on the PC can move the arm."]
    return [*lines, "The PC moves the arm from RSI_MOVECORR on. First runs: T1, commissioning mode of the gateway."]


def _check(name: str) -> list[str]:
    return [f"IF ({name} <> RSIOK) THEN", "  HALT", "ENDIF"]


def _motion_body(variant: Variant, rsi41: bool) -> list[str]:
    note = (
        "the bounds of the corrections are set from the soft limits above"
        if rsi41
        else "bounds of the corrections: wide ones in the context; soft limits and the gateway's own range hold"
    )
    return [
        f"; {note}",
        "; absolute: a correction is the offset from this pose, and a missed reply holds it (HOLDON 1)",
        "ret = RSI_ON(#ABSOLUTE, #IPO_FAST)",
        *_check("ret"),
        "",
        "; returns when the gateway sends Stop 1, at rest",
        "RSI_MOVECORR()",
    ]


def _read_only_body() -> list[str]:
    return [
        "ret = RSI_ON(#ABSOLUTE, #IPO_FAST)",
        *_check("ret"),
        "",
        "; no RSI_MOVECORR: with ONLYSEND nothing corrects. Put your own motions in place of the loop.",
        "LOOP",
        "  WAIT SEC 1.0",
        "ENDLOOP",
    ]


def _limits(variant: Variant) -> list[str]:
    axes: list[tuple[str, int, str]] = [(axis, index, "AxisCorr_1") for index, axis in enumerate(SPAN, 1)]
    if variant.external:
        axes.append(("E1", 7, "AxisCorrExt_1"))
    lines = [
        "DEF ctwin_limits(container :IN)",
        "; From here to the soft limits, per axis: AXISCORR would clamp a larger correction without a message.",
        "DECL INT container, ret",
        "DECL REAL below, above, most",
        "",
    ]
    for axis, index, name in axes:
        lines += [
            f"below = $SOFTN_END[{index}] - $AXIS_ACT_MEAS.{axis}",
            f"above = $SOFTP_END[{index}] - $AXIS_ACT_MEAS.{axis}",
            "most = above",
            "IF (-below > above) THEN",
            "  most = -below",
            "ENDIF",
            f'ret = RSI_SetPublicPar(container, "{name}", "LowerLim{axis}", below)',
            *_check("ret"),
            f'ret = RSI_SetPublicPar(container, "{name}", "UpperLim{axis}", above)',
            *_check("ret"),
            f'ret = RSI_SetPublicPar(container, "AxisCorrMon_1", "Max{axis}", most)',
            *_check("ret"),
            "",
        ]
    return [*lines, "END"]


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
