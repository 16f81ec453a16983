"""The paper's joint string (Figure 6): rad inside, degrees on the wire. Standard library only.

One string is ``+012.345,-090.000,...``: per axis a sign, three digits, a point and a fixed number of decimals, so that a PLC can
cut it by position. Fields stand in the order of the controller's axes, A1 first, external axes last. A linear axis, which the
paper does not have, is in mm with five digits before the point: ``+01234.567``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.units import degrees, radians

#: Digits before the point: of degrees, the paper's; of mm, for tracks of up to 100 m to either side.
DIGITS, LINEAR_DIGITS = 3, 5


class JointStringCodec:
    """Encodes and decodes joint strings of one length and one number of decimals.

    Args:
        decimals: Of a degree, and of a mm, 1 to 6. The paper's are 3.
        mapping: Sign and offset [rad], [m] per joint: the wire carries the axis value ``sign * q + offset``. None: the same.
        axes: Name of each joint's axis; fields are in their alphabetical order: A1 to A6, then E1. Default: as the joints are.
        linear: Which joints are m inside and mm on the wire. Default: none.

    References:
        Liang et al., section 3.3 and Figure 6.
    """

    def __init__(
        self,
        joints: int,
        decimals: int = 3,
        mapping: Sequence[tuple[int, float]] | None = None,
        axes: Sequence[str] = (),
        linear: Sequence[bool] = (),
    ):
        if not 1 <= decimals <= 6:
            raise ConfigurationError("decimals", decimals, "1 to 6 decimals of a degree")
        if joints < 1:
            raise ConfigurationError("joints", joints, "at least one joint")
        for name, per_joint in (("axes", axes), ("linear", linear)):
            if per_joint and len(per_joint) != joints:
                raise ConfigurationError(name, tuple(per_joint), f"one for each of {joints} joints")
        self.joints = joints
        self.decimals = decimals
        self._mapping = mapping if mapping and any(entry != (1, 0.0) for entry in mapping) else None
        order = sorted(range(joints), key=lambda joint: axes[joint]) if axes else list(range(joints))
        is_linear = [bool(linear and linear[joint]) for joint in order]
        # None: the paper's string, whose fields are the joints; the common case stays as quick as it can be
        self._fields = list(zip(order, is_linear)) if any(is_linear) or order != sorted(order) else None
        self._places = [(order.index(joint), is_linear[order.index(joint)]) for joint in range(joints)]
        self._digits = [LINEAR_DIGITS if linear else DIGITS for linear in is_linear]
        self.length = sum(digits + 2 + decimals for digits in self._digits) + joints - 1
        self._template = ",".join(f"%+0{digits + 2 + decimals}.{decimals}f" for digits in self._digits)
        self._zeros = [f"+{'0' * digits}.{'0' * decimals}" for digits in sorted(set(self._digits))]
        self._pattern = re.compile(b",".join(rb"([+-]\d{%d}\.\d{%d})" % (digits, decimals) for digits in self._digits))

    @classmethod
    def of(cls, robot, decimals: int = 3) -> JointStringCodec:
        """Return the codec for a `RobotModel`'s joints."""
        mapping = [(axis.sign, axis.offset) for axis in robot.axes]
        return cls(len(robot.joint_names), decimals, mapping, [axis.name for axis in robot.axes], robot.linear)

    @classmethod
    def of_config(cls, config) -> JointStringCodec:
        """Return the codec for a `GatewayConfig`'s axes: the gateway's side of `of`."""
        linear = [axis in config.linear for axis in config.axes]
        return cls(len(config.axes), config.decimals, None, config.axes, linear)

    def encode(self, q: tuple[float, ...]) -> bytes:
        """Return the joint string of a pose [rad], [m]: ASCII; zero is ``+000.000``, rounding is half-even on the exact value.

        Raises:
            PayloadError: ``count``, ``values`` (nan, inf) or ``range`` (1000 degrees, or 100 m, or more after rounding).
        """
        if len(q) != self.joints:
            raise PayloadError("count", f"{len(q)} joint values; expected {self.joints}")
        if not all(map(math.isfinite, q)):
            raise PayloadError("values", f"joint values {tuple(q)} are not all finite numbers")
        if self._mapping:
            q = tuple([sign * value + offset for value, (sign, offset) in zip(q, self._mapping)])
        if self._fields is None:
            text = self._template % degrees(q)
        else:
            values = [1e3 * q[joint] if linear else math.degrees(q[joint]) for joint, linear in self._fields]
            text = self._template % tuple(values)
        # a huge angle in rad is infinite in degrees, and "+0000inf" would have the right length
        if len(text) != self.length or "inf" in text:
            most = "1000 degrees" if max(self._digits) == DIGITS else "1000 degrees or 100 m"
            raise PayloadError("range", f"{text!r} does not fit the format: a joint is at or beyond {most}")
        for zero in self._zeros:
            text = text.replace("-" + zero[1:], zero)
        return text.encode("ascii")

    def decode(self, payload: bytes) -> tuple[float, ...]:
        """Return the pose of a joint string; PayloadError ``decimals``, ``length`` or ``format``."""
        match = self._pattern.fullmatch(payload) if len(payload) == self.length else None
        if match is None:
            raise self._why(payload)
        fields = match.groups()
        if self._fields is None:
            axes = radians(map(float, fields))
        else:
            values = [(float(fields[place]), linear) for place, linear in self._places]
            axes = tuple([value / 1e3 if linear else math.radians(value) for value, linear in values])
        if self._mapping:
            return tuple([sign * (value - offset) for value, (sign, offset) in zip(axes, self._mapping)])
        return axes

    def quantise(self, q: tuple[float, ...]) -> tuple[float, ...]:
        """Return `q` as the receiver of its joint string will see it [rad], [m]; idempotent."""
        return self.decode(self.encode(q))

    def _why(self, payload: bytes) -> PayloadError:
        shown = payload[:80]
        first, *others = self._digits
        any_decimals = rb"[+-]\d{%d}\.(\d+)" % first + b"".join(rb",[+-]\d{%d}\.\d+" % digits for digits in others)
        other = re.fullmatch(any_decimals, payload[:512])
        if other and len(other.group(1)) != self.decimals:
            found = f"joint string with {len(other.group(1))} decimals; this side is configured for {self.decimals}"
            return PayloadError("decimals", found)
        if len(payload) != self.length:
            return PayloadError("length", f"{len(payload)} bytes {shown!r}; expected {self.length}")
        digits = " or ".join(map(str, sorted(set(self._digits))))
        return PayloadError(
            "format", f"{shown!r} is not {self.joints} times a sign, {digits} digits, a point, {self.decimals} digits"
        )
