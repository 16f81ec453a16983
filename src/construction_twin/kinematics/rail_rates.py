"""How the joints of an arm of the OPW kind move while its base travels along a straight line and its target stands still.

A joint's rate is by how much it turns for each metre of travel. The rates follow from the wrist centre's velocity as seen from the
base (joints 1 to 3), and from the angular velocity with which the wrist must undo theirs (joints 4 to 6). At a singularity (an
elbow stretched or folded, a wrist centre on axis 1, axes 4 and 6 in line) they are infinite; near one they are large. In plain
floats, because they are asked for few positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from construction_twin.kinematics.opw import OpwModel

#: An axis this level is horizontal.
_LEVEL = 1e-9
#: A position at an edge of the reach is this far within it: the arm is almost stretched or folded there [m].
AT_EDGE = 1e-11


class RailRates:
    """An arm whose base travels.

    Args:
        travel: Shape (3,). By how much the base moves for each metre of travel, in the directions of the model's base.
    """

    def __init__(self, model: OpwModel, travel: np.ndarray):
        self._model = model
        self._travel = tuple(travel.tolist())
        #: Whether the edges of the reach are known.
        self.level = abs(self._travel[2]) <= _LEVEL and math.hypot(*self._travel[:2]) > 0.7
        self._forearm, self._bend = math.hypot(model.a2, model.c3), math.atan2(model.a2, model.c3)
        self._lengths = model.a1, model.b, model.c2, self._forearm

    def rates(self, q: Sequence[float]) -> list[float]:
        """Return the rates of joints.

        Args:
            q: Length 6. Joint values on the target [rad].

        Returns:
            Length 6. [rad/m]; nan at a singularity, and huge beside it.
        """
        (tx, ty, tz), (a1, b, c2, forearm) = self._travel, self._lengths
        q1, q2, q3, q4, q5, _ = q
        s1, s2, s3, s4, s5, s6 = self._model.signs
        o1, o2, o3, o4, o5, _ = self._model.offsets
        theta1, theta2, theta3, theta4, theta5 = s1 * q1 - o1, s2 * q2 - o2, s3 * q3 - o3, s4 * q4 - o4, s5 * q5 - o5
        sin1, cos1, sin2, cos2 = math.sin(theta1), math.cos(theta1), math.sin(theta2), math.cos(theta2)
        # axis 4, and the line from the elbow to the wrist centre, against the vertical
        theta3 += theta2
        sin3, cos3 = math.sin(theta3), math.cos(theta3)
        theta3 += self._bend
        sin_arm, cos_arm = math.sin(theta3), math.cos(theta3)
        sin4, cos4, sin5, cos5 = math.sin(theta4), math.cos(theta4), math.sin(theta5), math.cos(theta5)
        try:
            # the wrist centre moves against the travel; outwards and upwards as joints 2 and 3 see it
            first = (tx * sin1 - ty * cos1) / (a1 + c2 * sin2 + forearm * sin_arm)
            out, up = b * first - tx * cos1 - ty * sin1, -tz
            elbow = sin_arm * cos2 - cos_arm * sin2
            second = (out * sin_arm + up * cos_arm) / (c2 * elbow)
            arm = (out * sin2 + up * cos2) / (-forearm * elbow)
            # the forearm's angular velocity about its own axes; the wrist turns against it
            about_x, about_z = -sin3 * first, cos3 * first
            last = -(cos4 * about_x + sin4 * arm) / sin5
        except ZeroDivisionError:
            return [math.nan] * 6
        return [
            s1 * first,
            s2 * second,
            s3 * (arm - second),
            s4 * (-about_z - last * cos5),
            s5 * (sin4 * about_x - cos4 * arm),
            s6 * last,
        ]

    def steep_positions(self, flange: np.ndarray) -> tuple[list[float], tuple[float, float] | None]:
        """Return the positions near which joints 1 to 3 move fast.

        Args:
            flange: Shape (4, 4). Target ``opw_T_flange`` with the base at position zero.

        Returns:
            edges: Positions just within the edges of a shoulder's reach [m]. Empty for travel that is not level.
            at_axis: Where the wrist centre passes axis 1 most closely, and how closely [m]; None for travel that is not level.
        """
        model = self._model
        (x, y, z), (dx, dy, _) = model.wrist_centre(flange), self._travel
        square = dx * dx + dy * dy
        if not self.level:
            return [], None
        closest, beside = (x * dx + y * dy) / square, (x * dy - y * dx) ** 2 / square
        edges = []
        for offset in (model.a1, -model.a1):
            for sense, radius in ((1.0, model.c2 + self._forearm), (-1.0, abs(model.c2 - self._forearm))):
                level = radius**2 - (z - model.c1) ** 2
                if level < 0.0:
                    continue
                for root in (math.sqrt(level), -math.sqrt(level)):
                    # horizontal distance of the wrist centre to axis 1, without b
                    distance = offset + root
                    half = (distance**2 + model.b**2 - beside) / square
                    if distance < 0.0 or half <= 0.0:
                        continue
                    half = math.sqrt(half)
                    # with growing distance from axis 1 the wrist centre leaves the outer edge if it is on its far side
                    outwards = sense * (1.0 if root > 0.0 else -1.0)
                    edges += [closest + half - outwards * AT_EDGE, closest - half + outwards * AT_EDGE]
        return edges, (closest, math.sqrt(beside))
