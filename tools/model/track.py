"""The looks of the linear track of urdf/kr120_track.urdf.xacro: rail and carriage, one solid per colour. Metres.

Sizes are the URDF's stand-in track, after the only public data (docs/rsi.md, section 11), not a particular product.
"""

from __future__ import annotations

from collections.abc import Callable

from manifold3d import CrossSection, Manifold
from model.arm import Parts
from model.solids import block, bolts, joined, rod, skin

#: Length, width and height of the rail; length, width and thickness of the carriage [m].
RAIL, CARRIAGE = (3.4, 0.70, 0.266), (1.0, 0.90, 0.08)
#: Pitch of the rack's teeth [m].
_PITCH = 0.02


def rail() -> Parts:
    """Return track_rail: two beams on cross ties, guide rails on top, the rack between them; it stands on the floor."""
    half = RAIL[0] / 2
    beams, guides = [], []
    for side in (-1, 1):
        y = side * 0.265
        beams += [block((-half, y - 0.08, 0.175), (half, y + 0.08, 0.205), 0.005),
                  block((-half, y - 0.08, 0.035), (half, y + 0.08, 0.06), 0.005),
                  block((-half, y - 0.03, 0.05), (half, y + 0.03, 0.19), 0.005)]  # fmt: skip
        guides.append(_along([(-0.017, 0.0), (0.017, 0.0), (0.017, 0.014), (0.011, 0.024), (0.017, 0.036), (0.017, 0.052),
                              (-0.017, 0.052), (-0.017, 0.036),
                              (-0.011, 0.024), (-0.017, 0.014)], y, 0.204))  # fmt: skip
    places = [-1.5 + 0.6 * number for number in range(6)]
    ties = [block((x - 0.06, -0.345, 0.0), (x + 0.06, 0.345, 0.045), 0.006) for x in places]
    ties += [block((x - 0.02, -0.26, 0.04), (x + 0.02, 0.26, 0.15), 0.006) for x in places]
    stops = [
        block((side * (half - 0.05) - 0.035, y - 0.05, 0.2), (side * (half - 0.05) + 0.035, y + 0.05, 0.262), 0.008)
        for side in (-1, 1)
        for y in (-0.265, 0.265)
    ]
    feet = joined(
        bolts(1, 0.0, 0.036, "z", 0.016, (x + dx, y, 0.044))
        for x in places
        for dx in (-0.035, 0.035)
        for y in (-0.318, 0.318)
    )
    duct = block((-half + 0.1, -0.16, 0.1), (half - 0.1, -0.03, 0.2), 0.01) - block(
        (-half + 0.11, -0.148, 0.14), (half - 0.11, -0.042, 0.3), 0.004
    )
    return {
        "track_grey": joined([*beams, *ties]),
        "black": joined([*stops, duct]),
        "grey": joined([*guides, feet, _rack()]),
    }


def carriage() -> Parts:
    """Return track_carriage: the plate the arm stands on, with its shoes below; its frame lies on its top."""
    length, width, thickness = CARRIAGE
    plate = block((-length / 2, -width / 2, -0.05), (length / 2, width / 2, 0.0), 0.008)
    plate -= joined(
        block((x - 0.035, y - 0.16, -0.03), (x + 0.035, y + 0.16, 0.01), 0.006) for x in (-0.465,) for y in (0.0,)
    )
    skirts = joined(
        block(
            (-length / 2 + 0.02, side * 0.435 - 0.012, -0.079), (length / 2 - 0.02, side * 0.435 + 0.012, -0.03), 0.004
        )
        for side in (-1, 1)
    )
    shoes = joined(
        skin(block((x - 0.09, y - 0.06, -0.079), (x + 0.09, y + 0.06, -0.045), 0.006))
        for x in (-0.36, 0.36)
        for y in (-0.265, 0.265)
    )
    gear = rod(0.07, "z", -0.079, -0.045, (0.0, 0.12, 0), 0.004)
    screws = joined(
        bolts(1, 0.0, 0.028, "z", 0.012, (x, y, -0.014)) for x in (-0.46, 0.46) for y in (-0.4, -0.2, 0.2, 0.4)
    )
    plate -= joined(
        rod(0.024, "z", -0.014, 0.02, (x, y, 0), 0.0, 24) for x in (-0.46, 0.46) for y in (-0.4, -0.2, 0.2, 0.4)
    )
    return {"orange": plate, "black": shoes + gear + skirts, "grey": screws}


def _along(section: list[tuple[float, float]], y: float, z: float) -> Manifold:
    """Return a profile of (y, z) corners drawn out along the rail."""
    solid = Manifold.extrude(CrossSection([section]), RAIL[0])
    # the profile's x and y become y and z, its depth x
    return solid.transform([[0, 0, 1, -RAIL[0] / 2], [1, 0, 0, y], [0, 1, 0, z]])


def _rack() -> Manifold:
    """Return the rack: a bar whose teeth point to +y."""
    count = round((RAIL[0] - 0.2) / _PITCH)
    start = -count * _PITCH / 2
    outline = [(start, 0.0)] + [(start + count * _PITCH, 0.0)]
    for tooth in reversed(range(count)):
        x = start + tooth * _PITCH
        outline += [(x + 0.016, 0.022), (x + 0.012, 0.036), (x + 0.006, 0.036), (x + 0.002, 0.022)]
    bar = Manifold.extrude(CrossSection([outline]), 0.03)
    return bar.translate((0, 0.03, 0.215)) + block((start, 0.03, 0.1), (-start, 0.055, 0.22), 0.003)


#: How each link of the track is made.
LINKS: dict[str, Callable[[], Parts]] = {"track_rail": rail, "track_carriage": carriage}
