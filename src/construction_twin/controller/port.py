"""What the gateway asks of a make of robot controller.

A make is one folder beside this one. It offers a `Make`; `makes` finds it by its name. Each function of a `Make` is asked at the
start, and what it returns is bound there: nothing is looked up per telegram. Targets are absolute, or corrections to an origin that
stays, never increments (docs/architecture.md, law 2). rad, m, ms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from construction_twin.controller.axis_unit import AxisUnit
from construction_twin.controller.last_resort import LastResort
from construction_twin.controller.telegram import Reply, Telegram
from construction_twin.controller.tool import GatewayTool, ToolReading
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits


class Layout(Protocol):
    """What is fixed about the telegrams of one controller. It is a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def make(self) -> str:
        """Name of the make, see `makes`."""

    @property
    def port(self) -> int:
        """UDP port of the PC."""

    @property
    def answered(self) -> bool:
        """False: the controller expects no answers and takes nothing."""

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
        """Channels that no reply fills, for people."""

    @property
    def summary(self) -> str:
        """What is written in telegrams, for people: the few words that a person compares with the controller's file."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs of a tool that telegrams tell."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs of a tool that telegrams tell."""

    def document(self) -> dict[str, Any]:
        """Return what configuration file and hash hold of it."""


#: The layout of one make: what its functions return they take again, so that mypy checks a make as a whole.
LayoutT = TypeVar("LayoutT", bound=Layout)
_LayoutOut = TypeVar("_LayoutOut", bound=Layout, covariant=True)


class Axes(Protocol[_LayoutOut]):
    """The axes of an arm and their telegrams."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Length n. Names of the axes in the telegrams."""

    @property
    def units(self) -> tuple[AxisUnit, ...]:
        """Length n. How each one is written; of a mock also (): all revolute, in the controller's own units."""

    @property
    def layout(self) -> _LayoutOut:
        """The make's own."""


class Setup(Axes[_LayoutOut], Protocol[_LayoutOut]):
    """What a make may know of the arm: the gateway's configuration."""

    @property
    def limits(self) -> MotionLimits:
        """Of the axes."""

    @property
    def cycle(self) -> int:
        """The controller's [ms]."""

    @property
    def reference(self) -> str:
        """What corrections are relative to, in the make's word."""

    @property
    def start_tolerances(self) -> tuple[float, ...]:
        """Length n. How close to the held pose a stream may begin [rad], [m]."""

    @property
    def tool(self) -> GatewayTool | None:
        """None without one."""


class ControllerStatus(Protocol):
    """What a controller says of itself: its mode, its program, what stops or limits the arm."""

    @property
    def sentence(self) -> str:
        """Why the arm may not move, or not as expected; "" when nothing of this kind is known."""

    def report(self) -> dict[str, str | float]:
        """Return what `status` tells of it; {} when nothing is known."""


@dataclass(frozen=True)
class Reader:
    """Reads the telegrams of one controller.

    Attributes:
        parse: A datagram as telegram, or TelegramError with the reason why it is none.
        status: Of a datagram that is a telegram: what the controller says of itself, and how many of its channels cannot be read.
            None: it says nothing.
        tool: The same for a tool's outputs and inputs; it returns None when they are not told clearly. None: no tool.
    """

    parse: Callable[[bytes], Telegram]
    status: Callable[[bytes], tuple[ControllerStatus, int]] | None = None
    tool: Callable[[bytes], ToolReading | None] | None = None


class Encoder(Protocol):
    """Writes the replies to one controller."""

    def template(self, stop: bool | None, switched: tuple[bool, ...] = (), /) -> bytes:
        """Return what a reply is made from that ends the program (True) or does not; the make's own last resort takes it."""

    def encode(
        self, target: Sequence[float], stamp: int, stop: bool | None = None, switched: tuple[bool, ...] = (), /
    ) -> bytes:
        """Return the reply to a telegram.

        Args:
            target: Length n. Position of the axes, or its correction, as `Make.absolute` says [rad], [m].
            stop: True: it ends the controller's program; None: it does not.
            switched: One value per name of `Layout.switched`; () leaves a tool's outputs alone.
        """


class SessionRules(Protocol):
    """How the sessions of one controller begin, beyond what every make has: silence, another source, a jump of its clock.

    Attributes:
        follows: Whether corrections are relative to the programmed position, and so move with it.
    """

    follows: bool

    def drifted(self, distance: str) -> str:
        """Return the sentence on how far an axis is off where it was programmed."""

    def begin(self) -> None:
        """Forget the session before."""

    def origin(self, telegram: Telegram) -> tuple[tuple[float, ...], str]:
        """Return what targets are relative to, () while it is not known, and why the session must not be answered ("": it may)."""

    def restarted(
        self, telegram: Telegram, origin: tuple[float, ...], correction: tuple[float, ...], moving: bool
    ) -> str:
        """Return what shows that a session was ended and begun again faster than silence does; "" when nothing.

        Asked where cycles are missing, which that cannot do without. `correction` is that of the last reply, () for none;
        `moving`: it is being changed.
        """


class MockSetup(Axes[_LayoutOut], Protocol[_LayoutOut]):
    """What a make may know of the controller that a mock stands for."""

    @property
    def precision(self) -> int:
        """Decimals of sent values."""

    @property
    def stop_required(self) -> bool:
        """Whether a reply that does not say if it ends the program, and should, is none."""


@dataclass(frozen=True, slots=True)
class MockStatus:
    """What a mock controller is to say of itself, in the make's numbers, override in percent; None: what is.

    `slow`: it limits the tool's speed.
    """

    mode: int | None = None
    program: int | None = None
    override: float | None = None
    slow: bool = False


class TelegramEncoder(Protocol):
    """Writes the telegrams of a mock controller."""

    def __call__(
        self,
        stamp: int,
        measured: Sequence[float],
        followed: Sequence[float],
        measured_pose: Sequence[float],
        followed_pose: Sequence[float],
        missed: int,
        status: MockStatus,
        outputs: Mapping[str, bool] | None,
        inputs: Mapping[str, bool],
        /,
    ) -> bytes:
        """Return a telegram.

        Args:
            measured, followed: Length n. Where the axes are, and what they follow [rad], [m].
            measured_pose, followed_pose: Length 6. Position [m] and A, B, C [rad] of the tool for both.
            outputs, inputs: A tool's, by their names; None where they are not told.
        """


@dataclass(frozen=True)
class ControllerSide:
    """The controller's side of the telegrams, for a mock of it.

    Attributes:
        decode: A reply, or TelegramError; None: no reply is expected.
        holds: Length n. Whether an axis keeps its target when a reply is missed, or falls back to the start pose.
        holds_stop: The same for the end of the program.
        status: What a telegram says of the controller.
    """

    encode: TelegramEncoder
    decode: Callable[[bytes], Reply] | None
    holds: tuple[bool, ...]
    holds_stop: bool
    status: Callable[[MockStatus], ControllerStatus]


@dataclass(frozen=True)
class Words:
    """What people call things on a make's pendant and in its files.

    Attributes:
        stamp: The count in a telegram.
        read_only: That nothing is answered, and why.
        no_stop: Why a reply cannot end the program, and what to do.
        ends, ended: What happens when the end was asked for, and what has happened then.
        cycle, cycles: How a cycle is chosen on the controller, with ``{}`` for its name, and the same of all of them.
        timeout: The controller's own time-out.
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


class Described(Protocol[_LayoutOut]):
    """A file that describes the telegrams of one controller."""

    @property
    def layout(self) -> _LayoutOut:
        """What it says of the telegrams."""

    @property
    def text(self) -> str:
        """What stands in it."""


@dataclass(frozen=True)
class FileForm(Generic[LayoutT]):
    """The files in which a make describes its telegrams. Each reader raises ConfigurationError for what is no such file.

    Attributes:
        name: For messages.
        ending: Of the name of a file that was written for an arm.
        to_fill: What a person must fill into a file that was written.
        read, load: A file, from its text and its name for messages; from its path.
        write: The text of a file, from the axes.
        sends_to: Address that a controller sends to, from the path of its file, which must say what the layout does.
    """

    name: str
    ending: str
    to_fill: str
    read: Callable[[str, str], Described[LayoutT]]
    load: Callable[[str | Path], Described[LayoutT]]
    write: Callable[[Sequence[str]], str]
    sends_to: Callable[[str, LayoutT], str]


@dataclass(frozen=True)
class Make(Generic[LayoutT]):
    """One make of controller.

    Attributes:
        name: As `makes` knows it, and `Layout.make`.
        absolute: True: replies carry positions of the axes; False: corrections to an origin.
        cycles: Those that it has [ms], each with its name on the controller.
        references: What corrections may be relative to, in its words, the usual one first; (): there is nothing to choose.
        no_status: What it says of itself before the first telegram.
        plain: The layout of an arm without a file, from its axes.
        read_layout: The layout from what `Layout.document` returned; TypeError when it is none.
        check: Raises ConfigurationError when the arm cannot be served as configured.
        check_axes: Raises ConfigurationError when the layout is not one of these axes.
        controller_side: Of a mock.
        tool_channels: The channels of a tool that a layout has, for people; none: a tool without hands.
        file: None: no file describes its telegrams.
    """

    name: str
    absolute: bool
    cycles: Mapping[int, str]
    words: Words
    no_status: ControllerStatus
    plain: Callable[[Sequence[str]], LayoutT]
    read_layout: Callable[[dict[str, Any]], LayoutT]
    check: Callable[[Setup[LayoutT]], None]
    reader: Callable[[Setup[LayoutT]], Reader]
    encoder: Callable[[Setup[LayoutT]], Encoder]
    rules: Callable[[Setup[LayoutT]], SessionRules]
    last_resort: Callable[[Setup[LayoutT]], LastResort]
    check_axes: Callable[[LayoutT, Sequence[str]], None]
    controller_side: Callable[[MockSetup[LayoutT]], ControllerSide]
    tool_channels: Callable[[LayoutT], tuple[str, ...]]
    file: FileForm[LayoutT] | None = None
    references: tuple[str, ...] = ()

    def layout_of(self, given: str, axes: Sequence[str]) -> LayoutT:
        """Return the layout of an arm, by path or text (several lines) of the file that describes it; the plain one for ""."""
        if not given:
            return self.plain(axes)
        form = self.form_of(given)
        return (form.read(given, form.name) if "\n" in given else form.load(given)).layout

    def form_of(self, given: str) -> FileForm[LayoutT]:
        """Return the form of a file that was given; ConfigurationError when the make has no files."""
        if self.file is None:
            raise ConfigurationError(
                "file of the controller", given, f"none: {self.name} has no file for its telegrams"
            )
        return self.file
