"""The port to a make of robot controller, a `Make`, and the makes by their names: the one place that names a make's folder.

Each function of a `Make` is asked at the start, and what it returns is bound there. Targets are absolute, or corrections to an
origin that stays, never increments (docs/architecture.md, law 2). rad, m, ms.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from construction_twin.controller.last_resort import LastResort
from construction_twin.controller.telegram import AxisUnit, Reply, Telegram
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits

#: The channel without which none of the outputs may be changed; no output can have its name.
ENABLE = "Enable"
#: What may become of an output when RSI ends or a reply is missed, and the HOLDON that says so.
HOLDON = {"keep": True, "off": False}

_is_name = re.compile(r"[a-z][a-z0-9_]{0,23}").fullmatch


def is_tool_name(name: str) -> bool:
    """Return whether a name is valid for a tool's output or input."""
    return _is_name(name) is not None


@dataclass(frozen=True)
class ToolOutput:
    """An output; `on_stop`: ``keep`` or ``off`` at RSI's end or a missed reply; `opens`: the value that lets go, if one does."""

    name: str
    on_stop: str
    opens: bool | None = None


@dataclass(frozen=True)
class GatewayTool:
    """A tool, as its file was checked by `robot.tool`."""

    name: str
    outputs: tuple[ToolOutput, ...]
    inputs: tuple[str, ...]

    @classmethod
    def of_document(cls, document: dict) -> GatewayTool:
        """Return the tool of a configuration file; TypeError or KeyError for an invalid one."""
        outputs = tuple(ToolOutput(**output) for output in document["outputs"])
        return cls(**document | {"outputs": outputs, "inputs": tuple(document["inputs"])})


@dataclass(frozen=True, slots=True)
class ToolReading:
    """A tool's signals in a telegram, in the order of the reader's names."""

    outputs: tuple[bool, ...]
    inputs: tuple[bool, ...]


class Layout(Protocol):
    """The telegram layout of one controller; a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def make(self) -> str:
        """Name of the make, see `MODULES`."""

    @property
    def port(self) -> int:
        """UDP port of the PC."""

    @property
    def expects_replies(self) -> bool:
        """Whether the controller expects replies."""

    @property
    def stop(self) -> bool:
        """Whether a reply can end the controller's program."""

    @property
    def switched(self) -> tuple[str, ...]:
        """Channels of a reply that set a tool's outputs, in order: `ENABLE` and the outputs' names."""

    @property
    def switched_holdon(self) -> tuple[bool, ...]:
        """Per channel of `switched`: whether it keeps its value when a reply is missed, or falls to 0."""

    @property
    def not_filled(self) -> tuple[str, ...]:
        """Declared channels of a reply that stay empty."""

    @property
    def summary(self) -> str:
        """Short description of the telegrams, to be compared with the controller's file."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """A tool's outputs in telegrams."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """A tool's inputs in telegrams."""


#: The layout of one make: what its functions return they take again, so that mypy checks a make as a whole.
LayoutT = TypeVar("LayoutT", bound=Layout)
LayoutT_co = TypeVar("LayoutT_co", bound=Layout, covariant=True)


class Setup(Protocol[LayoutT_co]):
    """A make's view of an arm and its link: the gateway's configuration. Tuples are of length n; rad, m."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names in telegrams."""

    @property
    def units(self) -> tuple[AxisUnit, ...]:
        """How each axis is written in telegrams."""

    @property
    def limits(self) -> MotionLimits:
        """The axes' limits."""

    @property
    def start_tolerances(self) -> tuple[float, ...]:
        """How close to the held pose a stream may begin."""

    @property
    def cycle(self) -> int:
        """The controller's cycle [ms]."""

    @property
    def reference(self) -> str:
        """What corrections are relative to, of `Make.references`; "": nothing to choose."""

    @property
    def layout(self) -> LayoutT_co:
        """The controller's telegrams."""

    @property
    def tool(self) -> GatewayTool | None:
        """The tool at the flange."""


class ControllerStatus(Protocol):
    """A controller's report on itself: its mode, its program, what stops or limits the arm."""

    @property
    def sentence(self) -> str:
        """Why the arm is stopped or limited; "": unknown."""

    def status_fields(self) -> dict[str, str | float]:
        """Return its fields of `status`; {}: unknown."""


@dataclass(frozen=True)
class Reader:
    """Reads the telegrams of one controller.

    Attributes:
        parse: A datagram as telegram, or TelegramError.
        status: The status in a datagram, and the number of its channels that cannot be read; None: telegrams carry none.
        tool: A tool's signals in a datagram, None where they are not clear; None: no tool.
        tool_pose: The measured pose of the controller's tool in its base, X, Y, Z [m], A, B, C [rad] (KUKA's), None where it is not
            clear; None: telegrams carry none.
    """

    parse: Callable[[bytes], Telegram]
    status: Callable[[bytes], tuple[ControllerStatus, int]] | None = None
    tool: Callable[[bytes], ToolReading | None] | None = None
    tool_pose: Callable[[bytes], tuple[float, ...] | None] | None = None


class Encoder(Protocol):
    """Writes the replies to one controller."""

    def template(self, stop: bool | None, switched: tuple[bool, ...] = (), /) -> bytes:
        """Return the template of a reply that ends the program (True) or does not, for the make's last resort."""

    def encode(
        self, target: Sequence[float], stamp: int, stop: bool | None = None, switched: tuple[bool, ...] = (), /
    ) -> bytes:
        """Return the reply to a telegram.

        Args:
            target: Length n. Position of the axes, or its correction (`Make.absolute`) [rad], [m].
            stop: True ends the controller's program.
            switched: One value per name of `Layout.switched`; () leaves a tool's outputs alone.
        """


class SessionRules(Protocol):
    """Rules for the begin of a controller's sessions, besides silence, another source and a jump of its clock.

    Attributes:
        follows_setpoint: Whether corrections are relative to the programmed position, and so move with it.
    """

    follows_setpoint: bool

    def drift_sentence(self, distance: str) -> str:
        """Return the sentence for an axis off its programmed position."""

    def begin(self) -> None:
        """Forget the session before."""

    def origin(self, telegram: Telegram) -> tuple[tuple[float, ...], str]:
        """Return the origin of corrections, () while unknown, and why the session must stay unanswered ("": answer it)."""

    def restart_sign(
        self, telegram: Telegram, origin: tuple[float, ...], correction: tuple[float, ...], moving: bool
    ) -> str:
        """Return the evidence of a restart shorter than the silence timeout, as a clause; "" for none.

        `correction` is that of the last reply, () for none; `moving`: it is being changed.
        """


@dataclass(frozen=True, slots=True)
class MockStatus:
    """Status of a mock in the make's numbers, override in percent; None: unchanged. `slow`: its tool speed is limited."""

    mode: int | None = None
    program: int | None = None
    override: float | None = None
    slow: bool = False


@dataclass(frozen=True)
class ControllerSide:
    """The controller's side of the telegrams, for a mock of it.

    Attributes:
        encode: A telegram, from stamp, measured and followed position (length n), both as pose of the tool (length 6: [m],
            A, B, C [rad]), count of missed replies, status, and a tool's outputs (None: hidden) and inputs by name.
        decode: A reply, or TelegramError; None: no reply is expected.
        holds: Length n. Whether an axis keeps its target when a reply is missed, or falls back to the start pose.
        holds_stop: The same for the end of the program.
    """

    encode: Callable[..., bytes]
    decode: Callable[[bytes], Reply] | None
    holds: tuple[bool, ...]
    holds_stop: bool
    status: Callable[[MockStatus], ControllerStatus]


@dataclass(frozen=True)
class Terms:
    """Terms of a make's pendant and files.

    Attributes:
        no_stop: Why a reply cannot end the program, and what to do.
        ends, ended: How the program will end, and has ended.
        cycle, cycles: How a cycle is chosen on the controller, with ``{}`` for its name, and the same of all of them.
        description: The file that describes the telegrams.
    """

    protocol: str
    stamp: str
    read_only: str
    no_stop: str
    ends: str
    ended: str
    cycle: str
    cycles: str
    timeout: str
    description: str


@dataclass(frozen=True)
class FileForm(Generic[LayoutT]):
    """The files in which a make describes its telegrams.

    Attributes:
        ending: Of a written file's name.
        to_fill: What a person must fill into a written file.
        read: The layout in a file, given by path or text (several lines).
        write: The text of a file, from the axes.
        sends_to: Address that a controller sends to, from the path of its file, which must have the same layout.
    """

    name: str
    ending: str
    to_fill: str
    read: Callable[[str], LayoutT]
    write: Callable[[Sequence[str]], str]
    sends_to: Callable[[str, LayoutT], str]


@dataclass(frozen=True)
class Make(Generic[LayoutT]):
    """One make of controller.

    Attributes:
        absolute: True: replies carry positions of the axes; False: corrections to an origin.
        cycles: Its cycles [ms], each with its name on the controller.
        references: What corrections may be relative to, in its words, the usual one first; (): nothing to choose.
        plain: The layout of an arm without a file, from its axes.
        read_layout: The layout from its fields; TypeError when they are none.
        check: Raises ConfigurationError when the arm cannot be served as configured.
        check_axes: Raises ConfigurationError when the layout is not one of these axes.
        controller_side: Of a mock, from layout, axes, their units and the decimals of sent values.
        tool_channels: The channels of a tool in a layout, for people; none: a tool without hands.
        file: None: no file describes its telegrams.
    """

    name: str
    absolute: bool
    cycles: Mapping[int, str]
    terms: Terms
    no_status: ControllerStatus
    plain: Callable[[Sequence[str]], LayoutT]
    read_layout: Callable[[dict[str, Any]], LayoutT]
    check: Callable[[Setup[LayoutT]], None]
    reader: Callable[[Setup[LayoutT]], Reader]
    encoder: Callable[[Setup[LayoutT]], Encoder]
    rules: Callable[[Setup[LayoutT]], SessionRules]
    last_resort: Callable[[Setup[LayoutT]], LastResort]
    check_axes: Callable[[LayoutT, Sequence[str]], None]
    controller_side: Callable[[LayoutT, tuple[str, ...], tuple[AxisUnit, ...], int], ControllerSide]
    tool_channels: Callable[[LayoutT], tuple[str, ...]]
    file: FileForm[LayoutT] | None = None
    references: tuple[str, ...] = ()

    def layout_of(self, path_or_text: str, axes: Sequence[str]) -> LayoutT:
        """Return the layout in a file, given by path or text (several lines); "": the make's plain layout."""
        return self.form_of(path_or_text).read(path_or_text) if path_or_text else self.plain(axes)

    def form_of(self, path_or_text: str) -> FileForm[LayoutT]:
        """Return the form of the files, by one of them; ConfigurationError when the make has no files."""
        if self.file is None:
            expected = f"none: {self.name} has no file for its telegrams"
            raise ConfigurationError("file of the controller", path_or_text, expected)
        return self.file


#: The make of a configuration that names none.
DEFAULT_MAKE = "rsi"
#: Module of each make; its `MAKE` is the make.
MODULES = {DEFAULT_MAKE: "construction_twin.rsi.make"}


@cache
def make_of(name: str) -> Make:
    """Return a make by its name; ConfigurationError for an unknown one."""
    if name not in MODULES:
        raise ConfigurationError("make", name, f"one of {', '.join(MODULES)}")
    return import_module(MODULES[name]).MAKE
