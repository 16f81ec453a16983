"""RSI as a make of controller: the functions behind the port, each bound once at the start."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from construction_twin.controller.last_resort import BareProtocol, LastResort
from construction_twin.controller.port import (
    ENABLE,
    HOLDON,
    ControllerSide,
    FileForm,
    GatewayTool,
    Make,
    MockStatus,
    Reader,
    Setup,
    Terms,
)
from construction_twin.controller.telegram import AxisUnit, Telegram
from construction_twin.core.limits import distance_off, outside_tolerance
from construction_twin.core.sentences import Sentence
from construction_twin.rsi.controller_codec import RobotEncoder, SensorDecoder
from construction_twin.rsi.ethernet_xml import (
    EthernetXmlError,
    check_axes,
    check_gateway,
    load_ethernet_xml,
    matching_address,
    read_ethernet_xml,
    tool_channels,
)
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder, read_tool_pose
from construction_twin.rsi.layout import (
    EXTERNAL_AXES,
    IN,
    OUT,
    SET,
    STOP,
    RsiLayout,
    ToolReader,
    default_element,
    names_of,
)
from construction_twin.rsi.status_channels import RsiStatus, StatusReader, status_channels

NOTICE = (
    "construction_twin. Written from published facts, NOT TRIED ON A CONTROLLER: "
    "check every value before use (docs/controller.md)."
)
_TEXT = f"""<ROOT>
  <!-- {NOTICE} -->
  <!-- Gateway and mock read this very file: give them the copy that is on the controller. -->
  <CONFIG>
    <!-- EDIT: address of the PC that runs rsi_gateway, in the RSI subnet -->
    <IP_NUMBER>192.168.1.10</IP_NUMBER>
    <PORT>49152</PORT>
    <SENTYPE>ImFree</SENTYPE>
    <ONLYSEND>{{}}</ONLYSEND>
  </CONFIG>
  <SEND>
    <ELEMENTS>
{{}}    </ELEMENTS>
  </SEND>
  <RECEIVE>
    <ELEMENTS>
{{}}    </ELEMENTS>
  </RECEIVE>
</ROOT>
"""


def receive_channels(axes: Sequence[str], holdon: Mapping[str, bool] | None = None) -> list[tuple[str, str, int]]:
    """Return TAG, TYPE and HOLDON of a reply's channels, in the order of their INDX, from 1."""
    corrections = [(f"{default_element(axis)}.{axis}", "DOUBLE", 1) for axis in sorted(axes)]
    outputs = [(f"{SET}.{name}", "BOOL", int(held)) for name, held in (holdon or {}).items()]
    return [(STOP, "BOOL", 0), *corrections, *([(f"{SET}.{ENABLE}", "BOOL", 1)] if outputs else []), *outputs]


def send_channels(outputs: Sequence[str], inputs: Sequence[str]) -> list[str]:
    """Return the TAGs by which a tool is read, in the order of their INDX, which counts from 1."""
    return [*(f"{OUT}.{name}" for name in outputs), *(f"{IN}.{name}" for name in inputs)]


def ethernet_xml_text(
    axes: Sequence[str], receives: bool = True, holdon: Mapping[str, bool] | None = None, inputs: Sequence[str] = ()
) -> str:
    """Return the text of an Ethernet XML; `holdon`: whether each of the tool's outputs keeps its value when a reply is missed."""
    external = ["EIPos", "ESPos"] if any(axis in EXTERNAL_AXES for axis in axes) else []
    internal = [(f"DEF_{name}", "DOUBLE", "INTERNAL") for name in ("RIst", "RSol", "AIPos", "ASPos", *external)]
    signals = [(tag, "BOOL", str(index)) for index, tag in enumerate(send_channels(list(holdon or ()), inputs), 1)]
    send = [*internal, ("DEF_Delay", "LONG", "INTERNAL"), *signals]
    receive = enumerate(receive_channels(axes, holdon) if receives else [], 1)
    return _TEXT.format(
        "FALSE" if receives else "TRUE",
        "".join(f'      <ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}"/>\n' for tag, kind, index in send),
        "".join(
            f'      <ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}" HOLDON="{held}"/>\n'
            for index, (tag, kind, held) in receive
        ),
    )


def check_tool(tool: GatewayTool | None, layout: RsiLayout, where: str) -> None:
    """Check that the channels of an Ethernet XML are those of a tool, held as the tool file says."""
    if tool is None:
        if layout.switched:
            expected = "no such channel, or the tool file that it belongs to (launch argument tool)"
            raise EthernetXmlError(where, f"RECEIVE {SET}.{layout.switched[0]}", "no tool", expected)
        return
    declared = {
        SET: tuple(name for name in layout.switched if name != ENABLE),
        OUT: names_of(OUT, layout.send),
        IN: names_of(IN, layout.send),
    }
    outputs = tuple(output.name for output in tool.outputs)
    for element, section, wanted in ((SET, "RECEIVE", outputs), (OUT, "SEND", outputs), (IN, "SEND", tool.inputs)):
        if element == SET and layout.onlysend:
            continue
        missing = [name for name in wanted if name not in declared[element]]
        foreign = [name for name in declared[element] if name not in wanted]
        if missing or foreign:
            name = (missing or foreign)[0]
            expected = f"{element}.{', '.join(wanted)}, as the tool file of {tool.name} has them"
            raise EthernetXmlError(where, f"{section} {element}.{name}", None if missing else name, expected)
    holdon = dict(zip(layout.switched, layout.switched_holdon))
    for output in tool.outputs:
        if output.name in holdon and holdon[output.name] is not HOLDON[output.on_stop]:
            found = str(int(holdon[output.name]))
            expected = f'"{int(HOLDON[output.on_stop])}": the tool file of {tool.name} says on_stop: {output.on_stop}'
            raise EthernetXmlError(where, f"RECEIVE {SET}.{output.name} HOLDON", found, expected)


class RsiSessionRules:
    """One RSI session after the other, see `SessionRules`."""

    def __init__(self, setup: Setup[RsiLayout]):
        self.follows_setpoint = setup.reference == "ASPos"
        self._limits = setup.limits
        self._tolerances = setup.start_tolerances
        self._empty_telegrams = 0

    def drift_sentence(self, distance: str) -> str:
        """See `SessionRules.drift_sentence`."""
        return Sentence(
            "{distance} off where ASPos was: a program of the controller moves the arm while a stream does; if ASPos "
            "contains the corrections, set reference to AIPos",
            distance=distance,
        )

    def begin(self) -> None:
        """Forget the session before."""
        self._empty_telegrams = 0

    def origin(self, telegram: Telegram) -> tuple[tuple[float, ...], str]:
        """Return ASPos, or by option AIPos, and why the session must not be answered."""
        measured, setpoint = telegram.measured, telegram.setpoint
        if measured is None and setpoint is None and not self._empty_telegrams:
            # RSI up to 2.3 opens a session with a telegram that holds only IPOC (docs/rsi.md, section 2)
            self._empty_telegrams += 1
            return (), ""
        if measured is None or setpoint is None:
            return (), Sentence(
                "telegrams lack AIPos or ASPos, so the correction is unknown: declare DEF_AIPos and DEF_ASPos in the Ethernet XML"
            )
        if telegram.missed is None:
            return (), Sentence(
                "telegrams lack Delay, so a lost reply would go unnoticed: declare DEF_Delay in the Ethernet XML"
            )
        distance = distance_off(measured, setpoint, self._limits, self._tolerances)
        if distance:
            return (), Sentence(
                "{distance} off its programmed position already: joined a running session, not answering; it times out, "
                "then start the program again",
                distance=distance,
            )
        return setpoint if self.follows_setpoint else measured, ""

    def restart_sign(
        self, telegram: Telegram, origin: tuple[float, ...], correction: tuple[float, ...], moving: bool
    ) -> str:
        """See `SessionRules.restart_sign`; the correction is zero then."""
        measured, setpoint, tolerances = telegram.measured, telegram.setpoint, self._tolerances
        if not origin or outside_tolerance(correction, (0.0,) * len(correction), tolerances) is None:
            return ""
        if measured is None and setpoint is None:
            # so a session of RSI up to 2.3 begins, but no pose says that this is one: it is not answered
            self._empty_telegrams = 1
            return Sentence("a telegram with nothing but IPOC")
        if not self.follows_setpoint or measured is None or setpoint is None:
            return ""
        if moving and outside_tolerance(setpoint, origin, tolerances) is None:
            # at the beginning of a motion the servo may be no further yet
            return ""
        elsewhere = outside_tolerance(measured, setpoint, tolerances) is not None
        return "" if elsewhere else Sentence("ASPos is where the arm stands")


#: Cycles that RSI has [ms], and their names in KRL (docs/rsi.md, section 1).
CYCLES = {4: "#IPO_FAST", 12: "#IPO"}
#: The file's name in messages about a configuration.
_FILE = "Ethernet XML"
#: What a controller says that runs its program: in T1 or AUT, `ProState_R` ACTIVE, at full override.
_T1, _AUT, _ACTIVE, _FULL = 1, 3, 3, 100.0
_find_ipoc = re.compile(rb"<IPOC>\s*([0-9]{1,20})\s*</IPOC>").search
_find_delay = re.compile(rb"""<Delay\s+D\s*=\s*["']([0-9]{1,20})["']""").search


def check(setup: Setup[RsiLayout]) -> None:
    """Check that RSI can serve an arm as it is configured."""
    check_gateway(setup.layout, setup.axes, _FILE)
    check_tool(setup.tool, setup.layout, _FILE)


def layout_of(path_or_text: str) -> RsiLayout:
    """Return the layout of an Ethernet XML, from its path or text (several lines)."""
    return (read_ethernet_xml(path_or_text, _FILE) if "\n" in path_or_text else load_ethernet_xml(path_or_text)).layout


def reader(setup: Setup[RsiLayout]) -> Reader:
    """Return the reader of one configuration's telegrams."""
    channels, tool = status_channels(setup.layout.send), setup.tool
    return Reader(
        RobotDecoder(setup.axes, setup.units).parse,
        StatusReader(channels).read if channels else None,
        ToolReader([output.name for output in tool.outputs], tool.inputs).read if tool else None,
        read_tool_pose if "RIst" in setup.layout.send else None,
    )


def encoder(setup: Setup[RsiLayout]) -> SensorEncoder:
    """Return the encoder of one configuration's replies."""
    return SensorEncoder.of(setup.layout, setup.axes, setup.units)


def last_resort(setup: Setup[RsiLayout]) -> LastResort:
    """Return RSI's view for the last resort."""
    if not setup.layout.expects_replies:
        return LastResort(setup.limits, None, setup.cycle)
    copied = encoder(setup)
    counts = partial(_count, _find_ipoc), partial(_count, _find_delay)
    bare = BareProtocol(*counts, _filling(copied.order), (copied.template(None), copied.template(True)))
    return LastResort(setup.limits, bare, setup.cycle)


def status_of(shown: MockStatus) -> RsiStatus:
    """Return the status in a mock's telegrams."""
    return RsiStatus(
        shown.mode or (_T1 if shown.slow else _AUT),
        shown.program or _ACTIVE,
        _FULL if shown.override is None else shown.override,
    )


def controller_side(
    layout: RsiLayout, axes: tuple[str, ...], units: tuple[AxisUnit, ...], precision: int
) -> ControllerSide:
    """Return the side of a KR C4 with this layout; a hidden output is left out: 0 would be a value."""
    shown = tuple(tag for tag in layout.send if not tag.startswith(f"{OUT}."))
    full = RobotEncoder(axes, precision, layout.send, units)
    hiding = full if shown == layout.send else RobotEncoder(axes, precision, shown, units)

    def encode(
        ipoc: int,
        measured: Sequence[float],
        setpoint: Sequence[float],
        measured_pose: Sequence[float],
        setpoint_pose: Sequence[float],
        delay: int,
        shown: MockStatus,
        outputs: Mapping[str, bool] | None,
        inputs: Mapping[str, bool],
    ) -> bytes:
        signals = {f"{IN}.{name}": value for name, value in inputs.items()}
        signals |= {f"{OUT}.{name}": value for name, value in (outputs or {}).items()}
        encoder = hiding if outputs is None else full
        poses = measured, setpoint, measured_pose, setpoint_pose
        return encoder.encode(ipoc, *poses, delay, status_of(shown), signals)

    decode = None
    if layout.expects_replies:
        decode = SensorDecoder(layout.sentype, axes, layout.receive, units, layout.switched).parse
    holdon = dict(zip(layout.receive, layout.holdon))
    holds = [any(held for channel, held in holdon.items() if channel.partition(".")[2] == axis) for axis in axes]
    return ControllerSide(encode, decode, tuple(holds), holdon.get(STOP, False), status_of)


def _count(find: Callable[[bytes], re.Match[bytes] | None], data: bytes) -> int | None:
    found = find(data)
    return int(found[1]) if found else None


def _filling(order: Sequence[tuple[int, float]]) -> Callable[[bytes, tuple[float, ...], int], bytes]:
    def fill(text: bytes, target: tuple[float, ...], ipoc: int) -> bytes:
        filled = text % (*[target[index] * factor for index, factor in order], ipoc)
        return filled.replace(b'"-0.000000"', b'"0.000000"')

    return fill


MAKE = Make(
    name=RsiLayout.make,
    absolute=False,
    cycles=CYCLES,
    terms=Terms(
        protocol="RSI",
        stamp="IPOC",
        read_only=Sentence("read-only: the Ethernet XML has ONLYSEND TRUE"),
        no_stop=Sentence("the Ethernet XML declares no Stop element: end the program on the pendant"),
        ends=Sentence("RSI_MOVECORR ends as soon as the arm is at rest"),
        ended="RSI_MOVECORR ended",
        cycle="RSI_ON(..., {})",
        cycles=f"RSI_ON with {' or '.join(CYCLES.values())}",
        timeout="Timeout of the controller's ETHERNET object",
        description="the Ethernet XML",
    ),
    no_status=RsiStatus(),
    plain=RsiLayout.plain,
    read_layout=lambda document: RsiLayout(**document),
    check=check,
    reader=reader,
    encoder=encoder,
    rules=RsiSessionRules,
    last_resort=last_resort,
    check_axes=lambda layout, axes: check_axes(layout, axes, _FILE),
    controller_side=controller_side,
    tool_channels=tool_channels,
    file=FileForm(
        name=_FILE,
        ending="_ethernet.xml",
        to_fill="IP_NUMBER, the address of the PC that runs rsi_gateway; for a controller that speaks KUKA RSI",
        read=layout_of,
        write=ethernet_xml_text,
        sends_to=matching_address,
    ),
    references=("ASPos", "AIPos"),
)
