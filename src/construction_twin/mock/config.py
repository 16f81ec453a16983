"""Settings of the mock controller. Rad throughout."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.controller.port import DEFAULT_MAKE, Layout, make_of
from construction_twin.controller.telegram import AxisUnit
from construction_twin.core.errors import ConfigurationError
from construction_twin.mock.gripper import Gripper


@dataclass(frozen=True)
class MockConfig:
    """Settings of the controller. Tuples are of length n, in the order of `axes`; rad throughout.

    Attributes:
        start_pose: Of the first session, inside the soft limits.
        lower, upper: Soft limits.
        velocity, acceleration: Limits that the supervision is a multiple of.
        layout: Default: that of the default make without a file.
        units: Default: deg, and no axis linear.
        cycle: What the stamp advances by in a cycle [ms].
        precision: Decimals of sent values, 1 to 32. Real controllers default to 1 and run with 4; 6 keeps an evaluation exact.
        timeout: Cycles without a valid reply after which the session stops.
        correction_lower, correction_upper: Bounds of the correction, <= 0 and >= 0; clamps without an error. None: what the soft
            limits leave.
        velocity_factor: The session stops when the setpoint moves faster than this times `velocity`; 0 switches it off.
        acceleration_factor: The same for `acceleration`. A single missed reply at speed v is an acceleration of v / cycle, at 4 ms
            hundreds of times the limit; the default allows the step from rest that `velocity_factor` allows.
        first_stamp: Of the first packet [ms].
        restart_gap: How far the controller's clock has advanced when the next session starts [ms].
        gripper: What the tool does, where the layout has channels of one.
    """

    axes: tuple[str, ...]
    start_pose: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    layout: Layout = None  # type: ignore[assignment]  # `__post_init__` puts the plain layout of the axes in its place
    units: tuple[AxisUnit, ...] = ()
    cycle: int = 4
    precision: int = 6
    timeout: int = 100
    correction_lower: tuple[float, ...] | None = None
    correction_upper: tuple[float, ...] | None = None
    velocity_factor: float = 2.0
    acceleration_factor: float = 400.0
    first_stamp: int = 4_208_163_634
    restart_gap: int = 10_000
    gripper: Gripper = Gripper()

    def __post_init__(self) -> None:
        if self.layout is None:
            object.__setattr__(self, "layout", make_of(DEFAULT_MAKE).plain(self.axes))
        make = make_of(self.layout.make)
        make.check_axes(self.layout, self.axes)
        if self.cycle not in make.cycles:
            raise ConfigurationError("cycle", self.cycle, f"{' or '.join(map(str, make.cycles))} ms")

    @property
    def period(self) -> float:
        """Length of a cycle [s]."""
        return self.cycle / 1000
