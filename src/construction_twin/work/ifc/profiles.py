"""Profiles as polygons, from their attributes. Units are the file's; x and y in the profile's own position.

A profile of straight lines is exact. Where a curve bounds it, the polygon contains the profile, by little: circles become 32
tangents, a rounded corner one more. What is no such profile is None, and stays triangles.
"""

from __future__ import annotations

import math

import ifcopenshell
import numpy as np

#: Sides of the polygon around a circle: at most 0.5 % of the radius outside of it.
SIDES = 32

Outline = list[tuple[float, float]]
Outlines = tuple[np.ndarray, tuple[np.ndarray, ...]]


def outlines(profile: ifcopenshell.entity_instance) -> Outlines | None:
    """Return outline and holes of a profile.

    Returns:
        (array of shape (k, 2), tuple of arrays of shape (k, 2)) or None. The outline counter-clockwise, holes clockwise, no corner
        repeated. None: it becomes no polygon.
    """
    kind = profile.is_a()
    if profile.ProfileType != "AREA":
        return None
    if kind in ("IfcArbitraryClosedProfileDef", "IfcArbitraryProfileDefWithVoids"):
        inner = profile.InnerCurves if kind == "IfcArbitraryProfileDefWithVoids" else ()
        curves = [_curve(curve) for curve in (profile.OuterCurve, *inner)]
        if any(curve is None for curve in curves):
            return None
        return _finished(np.eye(3), [curve for curve in curves if curve is not None])
    if kind in ("IfcDerivedProfileDef", "IfcMirroredProfileDef"):
        return _derived(profile)
    make = _PARAMETRIC.get(kind)
    loops = None if make is None else make(profile)
    if loops is None:
        return None
    return _finished(_position(getattr(profile, "Position", None)), loops)


def _position(placement: ifcopenshell.entity_instance | None) -> np.ndarray:
    # ifcopenshell's own function for it fails under a profiler or debugger
    position = np.eye(3)
    if placement is not None:
        x, y = placement.RefDirection.DirectionRatios[:2] if placement.RefDirection else (1.0, 0.0)
        position[:2, :2] = np.array([[x, -y], [y, x]]) / math.hypot(x, y)
        position[:2, 2] = placement.Location.Coordinates[:2]
    return position


def is_curved(profile: ifcopenshell.entity_instance) -> bool:
    """Return whether curves bound a profile, so that its polygon only contains it."""
    if profile.is_a("IfcCircleProfileDef") or profile.is_a("IfcEllipseProfileDef"):
        return True
    if profile.is_a("IfcDerivedProfileDef"):
        return is_curved(profile.ParentProfile)
    return any("Radius" in name and value for name, value in profile.get_info(recursive=False).items())


def _finished(position: np.ndarray, loops: list[Outline]) -> Outlines | None:
    placed = []
    for turn, loop in zip([1.0] + [-1.0] * (len(loops) - 1), loops, strict=True):
        corners = _without_repeats(np.array(loop, dtype=float).reshape(-1, 2) @ position[:2, :2].T + position[:2, 2])
        if len(corners) < 3 or not np.isfinite(corners).all():
            return None
        placed.append(corners if signed_area(corners) * turn > 0 else corners[::-1])
    return placed[0], tuple(placed[1:])


def _without_repeats(corners: np.ndarray) -> np.ndarray:
    size = np.ptp(corners, axis=0).max() if len(corners) else 0.0
    keep = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1) > 1e-9 * size
    return corners[keep]


def signed_area(corners: np.ndarray) -> float:
    """Return the area of a polygon, shape (k, 2); negative where its corners go clockwise."""
    x, y = (corners - corners[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def _curve(curve: ifcopenshell.entity_instance) -> Outline | None:
    """Corners of a closed curve that is made of straight lines."""
    if curve.is_a("IfcPolyline"):
        return [tuple(point.Coordinates[:2]) for point in curve.Points]
    if curve.is_a("IfcIndexedPolyCurve"):
        if any(segment.is_a() != "IfcLineIndex" for segment in curve.Segments or ()):
            return None
        points = curve.Points.CoordList
        if not curve.Segments:
            return [tuple(point[:2]) for point in points]
        return [tuple(points[index - 1][:2]) for segment in curve.Segments for index in segment.wrappedValue]
    if curve.is_a("IfcCompositeCurve"):
        corners: Outline = []
        for segment in curve.Segments:
            if segment.is_a() != "IfcCompositeCurveSegment" or not segment.ParentCurve.is_a("IfcPolyline"):
                return None
            part = [tuple(point.Coordinates[:2]) for point in segment.ParentCurve.Points]
            corners += part if segment.SameSense else part[::-1]
        return corners
    return None


def _derived(profile: ifcopenshell.entity_instance) -> Outlines | None:
    parent = profile.ParentProfile
    if parent.is_a("IfcDerivedProfileDef"):
        return None
    found = outlines(parent)
    if found is None:
        return None
    position = np.eye(3)
    if profile.is_a("IfcMirroredProfileDef"):
        position[0, 0] = -1
    else:
        operator = profile.Operator
        if operator.is_a() != "IfcCartesianTransformationOperator2D":
            return None
        x = np.array(operator.Axis1.DirectionRatios[:2] if operator.Axis1 else (1.0, 0.0))
        x = x / np.linalg.norm(x)
        y = np.array([-x[1], x[0]])
        if operator.Axis2 and y @ operator.Axis2.DirectionRatios[:2] < 0:
            y = -y
        scale = operator.Scale or 1.0
        position = np.array([[scale * x[0], scale * y[0], 0], [scale * x[1], scale * y[1], 0], [0, 0, 1.0]])
        position[:2, 2] = operator.LocalOrigin.Coordinates[:2]
    outline, holes = found
    return _finished(position, [[tuple(corner) for corner in each] for each in (outline, *holes)])


def _rectangle(x: float, y: float) -> Outline:
    return [(-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)]


def _around(x: float, y: float) -> Outline:
    """Tangents of an ellipse: a polygon that contains it."""
    angles = (np.arange(SIDES) + 0.5) * 2 * math.pi / SIDES
    out = 1 / math.cos(math.pi / SIDES)
    return [(x * out * math.cos(a), y * out * math.sin(a)) for a in angles]


def _within(radius: float) -> Outline:
    """Chords of a circle: a polygon inside of it, for a hole of a profile that must be contained."""
    angles = (np.arange(SIDES) + 0.5) * 2 * math.pi / SIDES
    return [(radius * math.cos(a), radius * math.sin(a)) for a in angles]


def _rounded(corners: list[tuple[float, float, float]], solid: bool) -> Outline:
    """A counter-clockwise outline whose corners (x, y, radius) are rounded.

    Of a solid what contains it, of a hole what it contains: a convex rounding of a solid gets a tangent, a concave one a
    chord; of a hole the other way round.
    """
    found: Outline = []
    for k, (x, y, radius) in enumerate(corners):
        if radius <= 0:
            found.append((x, y))
            continue
        at = np.array([x, y])
        before, after = (np.array(corners[other][:2]) - at for other in (k - 1, (k + 1) % len(corners)))
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        turn = math.atan2(-before[0] * after[1] + before[1] * after[0], -before @ after)
        tangent = radius * math.tan(abs(turn) / 2)
        if (turn > 0) == solid:
            # where the tangent at the middle of the arc meets the two sides
            tangent -= radius * math.tan(abs(turn) / 4)
        found += [tuple(at + before * tangent), tuple(at + after * tangent)]
    return found


def _straight(profile: ifcopenshell.entity_instance, *slopes: str) -> bool:
    return not any(getattr(profile, slope, None) for slope in slopes)


def _rectangular(p: ifcopenshell.entity_instance) -> list[Outline]:
    return [_rectangle(p.XDim, p.YDim)]


def _rounded_rectangle(p: ifcopenshell.entity_instance) -> list[Outline]:
    return [_rounded([(x, y, p.RoundingRadius) for x, y in _rectangle(p.XDim, p.YDim)], solid=True)]


def _hollow_rectangle(p: ifcopenshell.entity_instance) -> list[Outline]:
    wall = 2 * p.WallThickness
    return [
        _rounded([(x, y, p.OuterFilletRadius or 0.0) for x, y in _rectangle(p.XDim, p.YDim)], solid=True),
        _rounded(
            [(x, y, p.InnerFilletRadius or 0.0) for x, y in _rectangle(p.XDim - wall, p.YDim - wall)], solid=False
        ),
    ]


def _circle(p: ifcopenshell.entity_instance) -> list[Outline]:
    return [_around(p.Radius, p.Radius)]


def _hollow_circle(p: ifcopenshell.entity_instance) -> list[Outline]:
    return [_around(p.Radius, p.Radius), _within(p.Radius - p.WallThickness)]


def _ellipse(p: ifcopenshell.entity_instance) -> list[Outline]:
    return [_around(p.SemiAxis1, p.SemiAxis2)]


def _trapezium(p: ifcopenshell.entity_instance) -> list[Outline]:
    x, y = p.BottomXDim / 2, p.YDim / 2
    top = -x + p.TopXOffset
    return [[(-x, -y), (x, -y), (top + p.TopXDim, y), (top, y)]]


def _i_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    if not _straight(p, "FlangeSlope", "FlangeEdgeRadius"):
        return None
    b, d, w, t, r = p.OverallWidth / 2, p.OverallDepth / 2, p.WebThickness / 2, p.FlangeThickness, p.FilletRadius or 0.0
    side = [(b, -d, 0), (b, -d + t, 0), (w, -d + t, r), (w, d - t, r), (b, d - t, 0), (b, d, 0)]
    return [_rounded(side + [(-x, -y, radius) for x, y, radius in side], solid=True)]


def _asymmetric_i_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    names = ("TopFlangeSlope", "BottomFlangeSlope", "TopFlangeEdgeRadius", "BottomFlangeEdgeRadius")
    # IFC2x3 has other attributes, and none for the bottom
    if not hasattr(p, "BottomFlangeWidth") or not _straight(p, *names) or p.TopFlangeThickness is None:
        return None
    b, c, d, w = p.BottomFlangeWidth / 2, p.TopFlangeWidth / 2, p.OverallDepth / 2, p.WebThickness / 2
    low, high = -d + p.BottomFlangeThickness, d - p.TopFlangeThickness
    below, above = p.BottomFlangeFilletRadius or 0.0, p.TopFlangeFilletRadius or 0.0
    right = [(b, -d, 0), (b, low, 0), (w, low, below), (w, high, above), (c, high, 0), (c, d, 0)]
    return [_rounded(right + [(-x, y, radius) for x, y, radius in reversed(right)], solid=True)]


def _l_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    if not _straight(p, "LegSlope", "EdgeRadius"):
        return None
    d, t = p.Depth / 2, p.Thickness
    b = (p.Width if p.Width is not None else p.Depth) / 2
    r = p.FilletRadius or 0.0
    return [
        _rounded([(-b, -d, 0), (b, -d, 0), (b, -d + t, 0), (-b + t, -d + t, r), (-b + t, d, 0), (-b, d, 0)], solid=True)
    ]


def _t_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    if not _straight(p, "WebSlope", "FlangeSlope", "WebEdgeRadius", "FlangeEdgeRadius"):
        return None
    b, d, w, t, r = p.FlangeWidth / 2, p.Depth / 2, p.WebThickness / 2, p.FlangeThickness, p.FilletRadius or 0.0
    corners = [
        (-w, -d, 0),
        (w, -d, 0),
        (w, d - t, r),
        (b, d - t, 0),
        (b, d, 0),
        (-b, d, 0),
        (-b, d - t, 0),
        (-w, d - t, r),
    ]
    return [_rounded(corners, solid=True)]


def _u_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    if not _straight(p, "FlangeSlope", "EdgeRadius"):
        return None
    b, d, w, t, r = p.FlangeWidth / 2, p.Depth / 2, p.WebThickness, p.FlangeThickness, p.FilletRadius or 0.0
    corners = [
        (-b, -d, 0), (b, -d, 0), (b, -d + t, 0), (-b + w, -d + t, r),
        (-b + w, d - t, r), (b, d - t, 0), (b, d, 0), (-b, d, 0),
    ]  # fmt: skip
    return [_rounded(corners, solid=True)]


def _c_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    if p.InternalFilletRadius:
        return None
    b, d, t, g = p.Width / 2, p.Depth / 2, p.WallThickness, p.Girth
    return [[
        (-b, -d), (b, -d), (b, -d + g), (b - t, -d + g), (b - t, -d + t), (-b + t, -d + t),
        (-b + t, d - t), (b - t, d - t), (b - t, d - g), (b, d - g), (b, d), (-b, d),
    ]]  # fmt: skip


def _z_shape(p: ifcopenshell.entity_instance) -> list[Outline] | None:
    if p.EdgeRadius:
        return None
    # the flange's width counts from the middle of the web, as in the kernel
    b, d, w, t, r = p.FlangeWidth, p.Depth / 2, p.WebThickness / 2, p.FlangeThickness, p.FilletRadius or 0.0
    half = [(-w, -d, 0), (b, -d, 0), (b, -d + t, 0), (w, -d + t, r)]
    return [_rounded(half + [(-x, -y, radius) for x, y, radius in half], solid=True)]


_PARAMETRIC = {
    "IfcRectangleProfileDef": _rectangular,
    "IfcRoundedRectangleProfileDef": _rounded_rectangle,
    "IfcRectangleHollowProfileDef": _hollow_rectangle,
    "IfcCircleProfileDef": _circle,
    "IfcCircleHollowProfileDef": _hollow_circle,
    "IfcEllipseProfileDef": _ellipse,
    "IfcTrapeziumProfileDef": _trapezium,
    "IfcIShapeProfileDef": _i_shape,
    "IfcAsymmetricIShapeProfileDef": _asymmetric_i_shape,
    "IfcLShapeProfileDef": _l_shape,
    "IfcTShapeProfileDef": _t_shape,
    "IfcUShapeProfileDef": _u_shape,
    "IfcCShapeProfileDef": _c_shape,
    "IfcZShapeProfileDef": _z_shape,
}
