"""What the gateway asks of a make of robot controller.

A make is one folder beside this one. It offers a `Make`; `makes` finds it by its name. Each function of a `Make` is asked at the
start, and what it returns is bound there: nothing is looked up per telegram. Targets are absolute, or corrections to an origin that
stays, never increments (docs/architecture.md, law 2). Standard library only; rad, m, ms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from construction_twin.controller.axis_unit import AxisUnit
from construction_twin.controller.last_resort import LastResort
from construction_twin.controller.telegram import Reply, Telegram
from construction_twin.controller.tool import GatewayTool, ToolReading
from construction_twin.core.limits import MotionLimits


class Layout(Protocol):
    """What is fixed about the telegrams of one controller. It is a frozen dataclass."""

    @property
    def make(self) -> str:
        """Name of the make, see `makes`."""
        ...

    @property
    def port(self) -> int:
        """UDP port of the PC."""
        ...

    @property
    def answered(self) -> bool:
        """False: the controller expects no answers and takes nothing."""
        ...

    @property
    def stop(self) -> bool:
        """Whether a reply can end the controller's program."""
        ...

    @property
    def switched(self) -> tuple[str, ...]:
        """Channels of a reply that set a tool's outputs, in order: `ENABLE` and the outputs' names."""
        ...

    @property
    def switched_holdon(self) -> tuple[bool, ...]:
        """Per channel of `switched`: whether it keeps its value when a reply is missed, or falls to 0."""
        ...

    @property
    def not_filled(self) -> tuple[str, ...]:
        """Channels that no reply fills, for people."""
        ...

    @property
    def summary(self) -> str:
        """What is written in telegrams, for people: the few words that a person compares with the controller's file."""
        ...

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs of a tool that telegrams tell."""
        ...

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs of a tool that telegrams tell."""
        ...

    def document(self) -> dict[str, Any]:
        """Return what configuration file and hash hold of it."""
        ...


class Setup(Protocol):
    """What a make may know of the arm: the gateway's configuration."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Length n. Names of the axes in the telegrams."""
        ...

    @property
    def units(self) -> tuple[AxisUnit, ...]:
        """Length n. How each one is written."""
        ...

    @property
    def layout(self) -> Any:
        """The make's own, see `Layout`."""
        ...

    @property
    def limits(self) -> MotionLimits:
        """Of the axes."""
        ...

    @property
    def cycle(self) -> int:
        """The controller's [ms]."""
        ...

    @property
    def reference(self) -> str:
        """What corrections are relative to, in the make's word."""
        ...

    @property
    def start_tolerances(self) -> tuple[float, ...]:
        """Length n. How close to the held pose a stream may begin [rad], [m]."""
        ...

    @property
    def tool(self) -> GatewayTool | None:
        """None without one."""
        ...


class Said(Protocol):
    """What a controller says of itself: its mode, its program, what stops or limits the arm."""

    @property
    def sentence(self) -> str:
        """Why the arm may not move, or not as expected; "" when nothing of this kind is known."""
        ...

    def report(self) -> dict[str, str | float]:
        """Return what `status` tells of it; {} when nothing is known."""
        ...


@dataclass(frozen=True)
class Reader:
    """Reads the telegrams of one controller.

    Attributes:
        parse: A datagram as telegram, or TelegramError with the reason why it is none.
        said: Of a datagram that is a telegram: what the controller says of itself, and how many of its channels cannot be read.
            None: it says nothing.
        tool: The same for a tool's outputs and inputs; it returns None when they are not told clearly. None: no tool.
    """

    parse: Callable[[bytes], Telegram]
    said: Callable[[bytes], tuple[Said, int]] | None = None
    tool: Callable[[bytes], ToolReading | None] | None = None


class Encoder(Protocol):
    """Writes the replies to one controller."""

    def template(self, stop: bool | None, switched: tuple[bool, ...] = (), /) -> bytes:
        """Return what a reply is made from that ends the program (True) or does not; the make's own last resort takes it."""
        ...

    def encode(
        self, target: Sequence[float], stamp: int, stop: bool | None = None, switched: tuple[bool, ...] = (), /
    ) -> bytes:
        """Return the reply to a telegram.

        Args:
            target: Length n. Position of the axes, or its correction, as `Make.absolute` says [rad], [m].
            stamp: Of the telegram.
            stop: True: it ends the controller's program; None: it does not.
            switched: One value per name of `Layout.switched`; () leaves a tool's outputs alone.
        """
        ...


class SessionRules(Protocol):
    """How the sessions of one controller begin, beyond what every make has: silence, another source, a jump of its clock.

    Attributes:
        follows: Whether corrections are relative to the programmed position, and so move with it.
        drifted: Ends a sentence on how far an axis is off where it was programmed.
    """

    follows: bool
    drifted: str

    def begin(self) -> None:
        """Forget the session before."""
        ...

    def origin(self, telegram: Telegram) -> tuple[tuple[float, ...], str]:
        """Return what targets are relative to, () while it is not known, and why the session must not be answered ("": it may)."""
        ...

    def restarted(
        self, telegram: Telegram, origin: tuple[float, ...], correction: tuple[float, ...], moving: bool
    ) -> str:
        """Return what shows that a session was ended and begun again faster than silence does; "" when nothing.

        Asked where cycles are missing, which that cannot do without.

        Args:
            origin: Length n. [rad]; () while it is not known.
            correction: Length n. What the last reply commanded, less the origin [rad]; () for nothing.
            moving: Whether that is being changed.
        """
        ...


@dataclass(frozen=True)
class ControllerSide:
    """The controller's side of the telegrams, for a mock of it.

    Attributes:
        encode: A telegram, from its stamp, where the axes are and what they follow (length n each), position and A, B, C of the
            tool for both (length 6 each), the count of missed replies, what it says of itself, and a tool's outputs and inputs by
            their names: None where they are not told.
        decode: A reply, or TelegramError; None: no reply is expected.
        holds: Length n. Whether an axis keeps its target when a reply is missed, or falls back to the start pose.
        holds_stop: The same for the end of the program.
    """

    encode: Callable[..., bytes]
    decode: Callable[[bytes], Reply] | None
    holds: tuple[bool, ...]
    holds_stop: bool


@dataclass(frozen=True)
class Words:
    """What people call things on a make's pendant and in its files.

    Attributes:
        protocol: Between controller and PC.
        stamp: The count in a telegram.
        read_only: That nothing is answered, and why.
        no_stop: Why a reply cannot end the program, and what to do.
        ends: What happens when the end was asked for.
        cycle: How a cycle is chosen on the controller, with ``{}`` for its name.
        cycles: The same of all of them, in words.
        description: The file that describes the telegrams.
    """

    protocol: str
    stamp: str
    read_only: str
    no_stop: str
    ends: str
    cycle: str
    cycles: str
    description: str


@dataclass(frozen=True)
class Make:
    """One make of controller.

    Attributes:
        absolute: True: replies carry positions of the axes; False: corrections to an origin.
        cycles: Those that it has [ms], each with its name on the controller.
        nothing_said: What it says of itself before the first telegram.
        plain: The layout of an arm without a file, from its axes.
        read_layout: The layout from what `Layout.document` returned; TypeError when it is none.
        check: Raises ConfigurationError when the arm cannot be served as configured.
        check_axes: Raises ConfigurationError when the layout is not one of these axes.
        controller_side: Of a mock, from its `MockConfig`.
        read_file: The layout of a file that describes the telegrams, from its text and its name for messages.
        load_file: The same, from its path.
        load_text: The text of such a file, which was found to be one, from its path.
        write_file: The text of such a file, from the axes.
        sends_to: Address that a controller sends to, from the path of its file, which must say what the layout does.
        tool_channels: The channels of a tool that a layout has, for people; none: a tool without hands.
    """

    absolute: bool
    cycles: Mapping[int, str]
    words: Words
    nothing_said: Said
    plain: Callable[[Sequence[str]], Any]
    read_layout: Callable[[dict], Any]
    check: Callable[[Setup], None]
    reader: Callable[[Setup], Reader]
    encoder: Callable[[Setup], Encoder]
    rules: Callable[[Setup], SessionRules]
    last_resort: Callable[[Setup], LastResort]
    check_axes: Callable[[Any, Sequence[str]], None]
    controller_side: Callable[[Any], ControllerSide]
    read_file: Callable[[str, str], Any]
    load_file: Callable[[Any], Any]
    load_text: Callable[[Any], str]
    write_file: Callable[[Sequence[str]], str]
    sends_to: Callable[[str, Any], str]
    tool_channels: Callable[[Any], tuple[str, ...]]
