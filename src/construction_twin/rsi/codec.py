"""RSI telegrams as bytes: `Rob` (controller to PC) and `Sen` (PC to controller), both directions of both.

The border where degrees and millimetres end: every function takes and returns rad and m. Axis values are in the order
of the `axes` argument (wire names, "A1"...) and in the controller's own sense of rotation; signs and offsets of a robot's
joints are not known here. Telegrams are checked completely or refused: a value is never guessed. Standard library only,
and fast enough for every 4 ms cycle: the gateway on the cell PC answers with it.

A refused telegram raises `TelegramError` with one of these reasons: ``size``, ``encoding`` (not ASCII text), ``markup``
(declaration, entity, comment, processing instruction), ``xml`` (not well-formed), ``root``, ``sentype``, ``ipoc``,
``element`` (missing or twice), ``attribute`` (missing), ``number`` (not a finite plain decimal).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from construction_twin.errors import ConfigurationError, TelegramError

#: Largest UDP payload we receive; a telegram with every block declared exceeds 1 kB (rsi.md section 2).
MAX_TELEGRAM = 65535
#: Decimals of a degree in a correction, as every known driver sends them (rsi.md section 3).
CORRECTION_DECIMALS = 6

# Fixed notation without exponent, infinity, underscore or white space; the digit limits keep every match finite.
_NUMBER = re.compile(r"[+-]?[0-9]{1,15}(?:\.[0-9]{1,32})?").fullmatch
_COUNT = re.compile(r"[0-9]{1,20}").fullmatch
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}").fullmatch
_UINT64_MAX = 2**64 - 1


@dataclass(frozen=True, slots=True)
class RobotTelegram:
    """One controller packet.

    Attributes
    ----------
    ipoc : int
        Controller time [ms]; the reply must carry it unchanged.
    measured : tuple of float, length n, or None
        Actual axis positions, `AIPos` [rad]; None when the packet has none (first packet of old controllers).
    setpoint : tuple of float, length n, or None
        Programmed axis positions, `ASPos` [rad]; constant during a correction.
    delay : int or None
        The controller's count of cycles without a valid reply.
    """

    ipoc: int
    measured: tuple[float, ...] | None
    setpoint: tuple[float, ...] | None
    delay: int | None


@dataclass(frozen=True, slots=True)
class SensorTelegram:
    """One reply.

    Attributes
    ----------
    ipoc : int
        Echo of the packet it answers.
    correction : tuple of float, length n
        Axis correction `AK` [rad], relative to the session's start pose.
    stop : bool or None
        Content of the `Stop` element; None without one.
    """

    ipoc: int
    correction: tuple[float, ...]
    stop: bool | None


def parse_robot(data: bytes, axes: tuple[str, ...]) -> RobotTelegram:
    """Read a controller packet.

    The root's attribute and unknown elements are ignored; a packet holding only `IPOC` is legal.

    Parameters
    ----------
    data : bytes
        One datagram.
    axes : tuple of str, length n
        Attribute names to read, in the order wanted.

    Returns
    -------
    telegram : RobotTelegram
        Angles in rad.

    Raises
    ------
    TelegramError
        With the reason (see the module) when anything read is not as the protocol says.
    """
    found = _children(_document(data, "Rob"), _ROBOT_ELEMENTS)
    measured, setpoint, delay = found.get("AIPos"), found.get("ASPos"), found.get("Delay")
    return RobotTelegram(
        _ipoc(found),
        None if measured is None else _angles(measured, axes),
        None if setpoint is None else _angles(setpoint, axes),
        None if delay is None else _count(delay.get("D"), "Delay D", "number"),
    )


def parse_sensor(data: bytes, sentype: str, axes: tuple[str, ...]) -> SensorTelegram:
    """Read a reply, as a controller configured with `sentype` and `axes` does.

    Parameters
    ----------
    data : bytes
        One datagram.
    sentype : str
        The SENTYPE of the controller's Ethernet configuration.
    axes : tuple of str, length n
        Declared attributes of `AK`; all must be there.

    Returns
    -------
    telegram : SensorTelegram
        Correction in rad.

    Raises
    ------
    TelegramError
        With the reason; ``sentype`` when the reply is meant for another configuration.
    """
    root = _document(data, "Sen")
    if root.get("Type") != sentype:
        raise TelegramError("sentype", f"the reply's Type is {root.get('Type')!r}; expected the SENTYPE {sentype!r}")
    found = _children(root, _SENSOR_ELEMENTS)
    if "AK" not in found:
        raise TelegramError("element", "the reply has no AK element")
    stop = found.get("Stop")
    if stop is not None and stop.text not in ("0", "1"):
        raise TelegramError("number", f"Stop is {stop.text!r}; expected 0 or 1")
    return SensorTelegram(_ipoc(found), _angles(found["AK"], axes), None if stop is None else stop.text == "1")


class SensorEncoder:
    """Writes replies of one configuration; everything that stays the same is prepared once.

    Parameters
    ----------
    sentype : str
        The SENTYPE of the controller's Ethernet configuration.
    axes : tuple of str, length n
        Axis names, in the order of the corrections.

    Raises
    ------
    ConfigurationError
        If a name cannot stand in a telegram.
    """

    def __init__(self, sentype: str, axes: tuple[str, ...]):
        _check_names("SENTYPE", (sentype,))
        _check_names("axes", axes)
        self._count = len(axes)
        correction = f"<AK {_attributes(axes, CORRECTION_DECIMALS)}/>"
        self._templates = {
            stop: f'<Sen Type="{sentype}">{element}{correction}<IPOC>%d</IPOC></Sen>'.encode()
            for stop, element in ((None, ""), (False, "<Stop>0</Stop>"), (True, "<Stop>1</Stop>"))
        }

    def encode(self, correction: Sequence[float], ipoc: int, stop: bool | None = None) -> bytes:
        """Write one reply.

        Parameters
        ----------
        correction : sequence of float, length n
            Axis corrections [rad].
        ipoc : int
            IPOC of the packet being answered.
        stop : bool, optional
            Content of the `Stop` element; default None leaves the element out.

        Returns
        -------
        data : bytes
            The datagram: fixed point, six decimals of a degree, never ``-0.000000``.

        Raises
        ------
        TelegramError
            If a correction is missing or not finite.
        """
        _check_values("correction", correction, self._count)
        return (self._templates[stop] % (*map(math.degrees, correction), ipoc)).replace(b'"-0.000000"', b'"0.000000"')


class RobotEncoder:
    """Writes controller packets with the blocks RIst, RSol, AIPos, ASPos, Delay and IPOC, in this order.

    Parameters
    ----------
    axes : tuple of str, length n
        Axis names, in the order of the positions.
    precision : int
        Decimals of every sent value, 1 to 32 (the ETHERNET object's `Precision`).

    Raises
    ------
    ConfigurationError
        If a name cannot stand in a telegram or the precision is out of range.
    """

    def __init__(self, axes: tuple[str, ...], precision: int):
        _check_names("axes", axes)
        if not 1 <= precision <= 32:
            raise ConfigurationError("precision", precision, "1 to 32 decimals")
        self._count = len(axes)
        pose, joints = _attributes(("X", "Y", "Z", "A", "B", "C"), precision), _attributes(axes, precision)
        self._template = (
            f'<Rob Type="KUKA"><RIst {pose}/><RSol {pose}/><AIPos {joints}/><ASPos {joints}/>'
            '<Delay D="%d"/><IPOC>%d</IPOC></Rob>'
        ).encode()
        zero = f"{0:.{precision}f}".encode()
        self._negative_zero, self._zero = b'"-' + zero + b'"', b'"' + zero + b'"'

    def encode(
        self,
        ipoc: int,
        measured: Sequence[float],
        setpoint: Sequence[float],
        measured_pose: Sequence[float],
        setpoint_pose: Sequence[float],
        delay: int,
    ) -> bytes:
        """Write one packet.

        Parameters
        ----------
        ipoc : int
            Controller time [ms].
        measured, setpoint : sequence of float, length n
            Axis positions for AIPos and ASPos [rad].
        measured_pose, setpoint_pose : sequence of float, length 6
            X, Y, Z [m] and A, B, C [rad] of the tool in the base, for RIst and RSol.
        delay : int
            Cycles without a valid reply.

        Returns
        -------
        data : bytes
            The datagram.

        Raises
        ------
        TelegramError
            If a value is missing or not finite.
        """
        _check_values("AIPos", measured, self._count)
        _check_values("ASPos", setpoint, self._count)
        _check_values("RIst", measured_pose, 6)
        _check_values("RSol", setpoint_pose, 6)
        values = (
            *_pose_on_wire(measured_pose),
            *_pose_on_wire(setpoint_pose),
            *map(math.degrees, measured),
            *map(math.degrees, setpoint),
        )
        return (self._template % (*values, delay, ipoc)).replace(self._negative_zero, self._zero)


_ROBOT_ELEMENTS = frozenset(("AIPos", "ASPos", "Delay", "IPOC"))
_SENSOR_ELEMENTS = frozenset(("AK", "Stop", "IPOC"))


def _document(data: bytes, root_tag: str) -> ElementTree.Element:
    if not 0 < len(data) <= MAX_TELEGRAM:
        raise TelegramError("size", f"telegram of {len(data)} B; expected 1 to {MAX_TELEGRAM} B")
    # Without NUL, because "<" followed by NUL makes the parser read UTF-16, in which markup looks different from below.
    if not data.isascii() or b"\0" in data:
        raise TelegramError("encoding", "telegram holds bytes that are not ASCII text")
    # No controller sends any; refusing them before the parser sees them rules out entity expansion.
    if b"<!" in data or b"<?" in data:
        raise TelegramError("markup", "telegram holds a declaration, comment or processing instruction")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise TelegramError("xml", f"telegram is not well-formed: {error}") from error
    if root.tag != root_tag:
        raise TelegramError("root", f"the telegram's root is {root.tag[:64]!r}; expected {root_tag}")
    return root


def _children(root: ElementTree.Element, wanted: frozenset[str]) -> dict[str, ElementTree.Element]:
    found = {}
    for child in root:
        tag = child.tag
        if tag in wanted:
            if tag in found:
                raise TelegramError("ipoc" if tag == "IPOC" else "element", f"the telegram has {tag} twice")
            found[tag] = child
    return found


def _ipoc(found: dict[str, ElementTree.Element]) -> int:
    element = found.get("IPOC")
    if element is None:
        raise TelegramError("ipoc", "the telegram has no IPOC")
    if len(element):
        raise TelegramError("ipoc", "IPOC holds elements; expected a number")
    return _count(element.text, "IPOC", "ipoc")


def _count(text: str | None, name: str, reason: str) -> int:
    if text is None or not _COUNT(text) or int(text) > _UINT64_MAX:
        shown = text if text is None else text[:32]
        raise TelegramError(reason, f"{name} is {shown!r}; expected a whole number from 0 to {_UINT64_MAX}")
    return int(text)


def _angles(element: ElementTree.Element, axes: tuple[str, ...]) -> tuple[float, ...]:
    values = [element.get(axis) for axis in axes]
    for axis, text in zip(axes, values):
        if text is None:
            raise TelegramError("attribute", f"{element.tag} has no {axis}")
        if not _NUMBER(text):
            raise TelegramError("number", f"{element.tag} {axis} is {text[:32]!r}; expected a plain decimal number")
    return tuple(map(math.radians, map(float, values)))


def _pose_on_wire(pose: Sequence[float]) -> tuple[float, ...]:
    return (*(1e3 * value for value in pose[:3]), *map(math.degrees, pose[3:]))


def _attributes(names: Sequence[str], decimals: int) -> str:
    return " ".join(f'{name}="%.{decimals}f"' for name in names)


def _check_names(where: str, names: Sequence[str]) -> None:
    for name in names:
        if not _NAME(name):
            raise ConfigurationError(where, name, "a letter, then letters, digits, '_', '.' or '-'")


def _check_values(name: str, values: Sequence[float], count: int) -> None:
    if len(values) != count:
        raise TelegramError("number", f"{name} has {len(values)} values; expected {count}")
    if not all(map(math.isfinite, values)):
        raise TelegramError("number", f"{name} is {tuple(values)}; expected finite numbers")
