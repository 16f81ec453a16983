"""The looks of a KUKA KR 120 R2500 pro: one solid per link and colour, in the link's frame of urdf/kr120r2500.urdf.xacro. Metres.

Joint origins are those of docs/rsi.md, section 10. Castings, motors, covers and screws are drawn after pictures of the
KR QUANTEC series, not after KUKA's CAD, and fitted into the URDF's collision shapes.
"""

from __future__ import annotations

from collections.abc import Callable

from manifold3d import Manifold
from model.solids import (
    block,
    bolts,
    chain,
    holes,
    hose,
    joined,
    motor,
    ring,
    rod,
    rounded,
    skin,
    turned,
)

#: Solids of one link by the name of the URDF's colour.
Parts = dict[str, Manifold]

#: Distances between joint origins: height of A2, its distance from A1, upper arm, forearm, its offset, wrist centre to flange [m].
SHOULDER_HEIGHT, SHOULDER, UPPER_ARM, FOREARM, DROP, FLANGE = 0.675, 0.350, 1.150, 1.000, -0.041, 0.215


def base_frame() -> Parts:
    """Return link_0: the plate with its four feet, the pedestal, the connector panel at the back."""
    feet = []
    for x in (-0.365, 0.305):
        for y in (-0.335, 0.335):
            inward = (0.5 * (x + 0.03) - 0.03, 0.5 * y)
            foot = rod(0.085, "z", 0.0, 0.045, (x, y, 0), 0.008)
            feet += [foot, skin(foot, rod(0.11, "z", 0.0, 0.078, (*inward, 0), 0.008))]
    plate = skin(*(rod(0.085, "z", 0.0, 0.032, (x, y, 0), 0.008) for x in (-0.365, 0.305) for y in (-0.335, 0.335)))
    profile = [(0.345, 0.0), (0.345, 0.035), (0.33, 0.05), (0.318, 0.08), (0.285, 0.16), (0.278, 0.2), (0.285, 0.235),
               (0.315, 0.262),
               (0.34, 0.268), (0.345, 0.274), (0.345, 0.300), (0.34, 0.306), (0.31, 0.306), (0.31, 0.312)]  # fmt: skip
    body = turned(profile, "z", segments=64)
    ribs = joined(
        skin(
            block((0.24, -0.016, 0.02), (0.342, 0.016, 0.08), 0.006),
            block((0.24, -0.012, 0.2), (0.318, 0.012, 0.262), 0.006),
        ).rotate((0, 0, angle))
        for angle in (18, 54, 90, 126, 234, 270, 306, 342)
    )
    box = block((-0.452, -0.185, 0.02), (-0.2, 0.185, 0.262), 0.018)
    panel = block((-0.4595, -0.165, 0.06), (-0.44, 0.165, 0.24), 0.004) - block(
        (-0.47, -0.15, 0.075), (-0.4545, 0.15, 0.225), 0.003
    )
    plugs = [
        rod(0.032, "-x", 0.44, 0.4595, (0, y, z), 0.004, 24)
        for y, z in ((-0.09, 0.17), (0.0, 0.17), (0.09, 0.17), (-0.045, 0.11))
    ]
    screws = joined(
        bolts(1, 0.0, 0.05, "z", 0.018, (x, y, 0.045)) + rod(0.037, "z", 0.04, 0.049, (x, y, 0), 0.002, 24)
        for x in (-0.365, 0.305) for y in (-0.335, 0.335)
    )  # fmt: skip
    top = bolts(24, 0.328, 0.022, "z", 0.008, (0, 0, 0.305))
    return {"black": joined([plate, *feet, body, ribs, box, panel]), "grey": joined([screws, top, *plugs])}


def carousel() -> Parts:
    """Return link_1: the rotating column up to the A2 bearing, motors of A1 and A2, the counterbalance."""
    table = turned(
        [(0.335, -0.352), (0.345, -0.346), (0.345, -0.30), (0.335, -0.285), (0.315, -0.278)], "z", segments=64
    )
    neck = rod(0.295, "z", -0.285, -0.215, (-0.01, 0, 0), 0.02)
    bearing = rod(0.19, "y", -0.075, 0.185, (0.35, 0, 0), 0.02)
    front = skin(rod(0.255, "z", -0.29, -0.23, (0.03, 0.03, 0), 0.02), bearing)
    rear = skin(
        rod(0.27, "z", -0.285, -0.2, (-0.06, 0.0, 0), 0.02), block((-0.27, -0.2, -0.12), (0.1, 0.2, -0.03), 0.03)
    )
    saddle = skin(
        block((-0.13, -0.1, -0.05), (0.12, 0.19, 0.0), 0.02), rod(0.13, "y", -0.06, 0.17, (0.31, 0, 0.02), 0.02)
    )
    # the counterbalance hangs in two lugs and pushes on the shoulder through a fork
    lugs = joined(
        skin(
            rod(0.055, "y", y, y + 0.025, (-0.14, 0, 0.10), 0.005, 32),
            block((-0.2, y, -0.06), (-0.08, y + 0.025, -0.03), 0.006),
        )
        for y in (-0.036, 0.184)
    )
    fork = skin(
        rod(0.06, "y", 0.045, 0.13, (0.245, 0, 0.12), 0.008, 32), rod(0.1, "y", 0.045, 0.13, (0.33, 0, 0.08), 0.008, 32)
    )
    gearbox = rod(0.185, "y", 0.18, 0.235, (0.35, 0, 0), 0.008)
    grooves = ring(0.36, 0.339, "z", -0.333, -0.328)
    windows = joined(block((0.12, y - 0.05, -0.17), (0.24, y + 0.05, -0.07), 0.02) for y in (-0.19, 0.24))
    orange = joined([table, neck, front, rear, saddle, lugs, fork, gearbox, bearing]) - grooves - windows
    cylinder = _counterbalance().translate((0, 0.085, 0.10))
    drive_1 = motor(0.092, "z", -0.05, 0.222, (-0.10, -0.145, 0))
    drive_2 = motor(0.118, "y", 0.232, 0.438, (0.35, 0, 0))
    seal = rod(0.165, "y", -0.088, -0.07, (0.35, 0, 0), 0.004)
    cable = hose([(-0.30, -0.10, -0.16), (-0.32, -0.12, -0.05), (-0.27, -0.17, 0.04), (-0.13, -0.215, 0.03)], 0.022)
    mount = rod(0.098, "z", -0.06, -0.012, (-0.10, -0.145, 0), 0.006)
    screws = joined([
        bolts(30, 0.33, 0.016, "z", 0.008, (0, 0, -0.284)), bolts(16, 0.165, 0.02, "y", 0.008, (0.35, 0.236, 0)),
        rod(0.028, "x", 0.15, 0.25, (0, 0.085, 0.10), 0.004, 24), rod(0.028, "y", -0.042, -0.03, (-0.14, 0, 0.10), 0.003, 24),
        rod(0.028, "y", 0.205, 0.2095, (-0.14, 0, 0.10), 0.001, 24), rod(0.026, "y", 0.038, 0.137, (0.245, 0, 0.12), 0.003, 24),
    ])  # fmt: skip
    return {"orange": orange + mount, "black": joined([cylinder, drive_1, drive_2, seal, cable]), "grey": screws}


def _counterbalance() -> Manifold:
    """Return the counterbalance cylinder along x, its middle at the trunnion above the column."""
    profile = [(0.07, -0.462), (0.085, -0.455), (0.088, -0.44), (0.088, -0.40), (0.098, -0.392), (0.098, 0.09), (0.09, 0.10),
               (0.09, 0.125), (0.07, 0.135),
               (0.05, 0.137), (0.045, 0.16)]  # fmt: skip
    body = turned(profile, "x", segments=SEGMENTS_FINE)
    bands = joined(ring(0.1, 0.09, "x", x, x + 0.03, edge=0.002) for x in (-0.36, -0.02))
    return body + bands + block((-0.40, -0.03, 0.085), (-0.22, 0.03, 0.118), 0.008)


def link_arm() -> Parts:
    """Return link_2: the link arm beside the column, from A2 to A3."""

    def disc(x: float, z: float, radius: float, low: float, high: float) -> Manifold:
        return rod(radius, "y", low, high, (x, 0, z), 0.014, 40)

    casting = chain([
        disc(0.0, 0.0, 0.205, -0.295, -0.115), disc(0.09, 0.003, 0.176, -0.293, -0.119), disc(0.19, 0.006, 0.146, -0.29, -0.126),
        disc(0.33, 0.010, 0.125, -0.287, -0.136), disc(0.50, 0.012, 0.115, -0.283, -0.14), disc(0.78, 0.010, 0.112, -0.28, -0.14),
        disc(0.95, 0.004, 0.121, -0.283, -0.134), disc(1.06, 0.001, 0.14, -0.287, -0.122), disc(1.15, 0.0, 0.163, -0.29, -0.115),
    ])  # fmt: skip
    pocket = chain(
        [
            disc(x, z, radius, -0.34, -0.262)
            for x, z, radius in ((0.27, 0.008, 0.085), (0.42, 0.012, 0.078), (0.78, 0.01, 0.072), (0.92, 0.004, 0.08))
        ]
    )
    rib = block((0.55, -0.283, -0.09), (0.585, -0.25, 0.11), 0.006) + block(
        (0.2, -0.276, 0.0), (1.0, -0.25, 0.02), 0.006
    )
    hub = rod(0.185, "y", -0.313, -0.28, (0, 0, 0), 0.012) + rod(0.145, "y", -0.31, -0.28, (1.15, 0, 0), 0.012)
    inner = rod(0.168, "y", -0.13, -0.105, (0, 0, 0), 0.006) + rod(0.15, "y", -0.125, -0.105, (1.15, 0, 0), 0.006)
    cover = turned([*rounded(0.105, 0.30, 0.3275, 0.008)], "-y") + turned(
        [*rounded(0.085, 0.30, 0.3225, 0.008)], "-y", (1.15, 0, 0)
    )
    seals = rod(0.15, "y", -0.11, -0.093, (0, 0, 0), 0.003) + rod(0.13, "y", -0.11, -0.098, (1.15, 0, 0), 0.003)
    cable = hose(
        [(0.02, -0.117, 0.1), (0.2, -0.118, 0.118), (0.6, -0.12, 0.12), (0.95, -0.118, 0.124), (1.12, -0.117, 0.09)],
        0.0165,
    )
    clamps = joined(block((x, -0.15, 0.09), (x + 0.045, -0.101, 0.146), 0.006) for x in (0.3, 0.85))
    screws = bolts(16, 0.15, 0.022, "-y", 0.008, (0, -0.312, 0)) + bolts(
        14, 0.118, 0.018, "-y", 0.007, (1.15, -0.309, 0)
    )
    orange = (casting - pocket) + (rib ^ casting) + hub + inner
    return {"orange": orange, "black": joined([cover, seals, cable, clamps]), "grey": screws}


def forearm() -> Parts:
    """Return link_3: elbow and arm, the wrist's three motors behind the elbow, the motor of A3 beside it."""
    hub = rod(0.155, "y", -0.088, 0.10, (0, 0, 0), 0.016)
    tube = rod(0.118, "x", 0.27, 0.50, (0, 0, DROP), 0.01)
    rear = block((-0.165, -0.09, -0.185), (-0.05, 0.135, 0.11), 0.03)
    casting = joined([
        skin(hub, block((0.12, -0.085, -0.155), (0.22, 0.1, 0.075), 0.03)), skin(hub, rear),
        skin(block((0.12, -0.085, -0.155), (0.22, 0.1, 0.075), 0.03), rod(0.122, "x", 0.27, 0.31, (0, 0, DROP), 0.008)),
    ])  # fmt: skip
    nose = turned(
        [(0.118, 0.40), (0.113, 0.50), (0.112, 0.57), (0.122, 0.578), (0.122, 0.603), (0.118, 0.608)], "x", (0, 0, DROP)
    )
    pocket = block((0.03, 0.088, -0.11), (0.19, 0.2, 0.03), 0.02) + block(
        (0.03, -0.2, -0.11), (0.19, -0.08, 0.03), 0.02
    )
    plate = block((-0.185, -0.105, -0.205), (-0.155, 0.152, 0.128), 0.01)
    places = ((-0.045, -0.14), (0.092, -0.14), (0.024, 0.05))
    motors = joined(motor(0.058, "-x", 0.18, 0.402 if z < 0 else 0.38, (0, y, z)) for y, z in places)
    drive = motor(0.098, "y", 0.098, 0.179, (0, 0, 0))
    band = ring(0.1235, 0.1, "x", 0.606, 0.624, (0, 0, DROP))
    box = block((0.02, -0.05, 0.09), (0.2, 0.09, 0.168), 0.014)
    cable = joined(
        hose([(-0.36, y, z + 0.055), (-0.3, y, z + 0.085), (-0.2, y * 0.7, 0.13), (-0.08, 0.02, 0.145), (0.06, 0.02, 0.135)], 0.014)
        for y, z in places[2:]
    )  # fmt: skip
    screws = joined([
        bolts(14, 0.135, 0.016, "y", 0.006, (0, 0.1, 0)),
        *(bolts(4, 0.066, 0.012, "-x", 0.006, (-0.184, y, z), 45.0) for y, z in places),
        joined(bolts(1, 0.0, 0.014, "z", 0.005, (x, y, 0.167)) for x in (0.04, 0.18) for y in (-0.032, 0.072)),
    ])  # fmt: skip
    orange = joined([casting, tube, nose, plate]) - pocket
    return {"orange": orange, "black": joined([motors, drive, band, box, cable]), "grey": screws}


def wrist_tube() -> Parts:
    """Return link_4: the turning tube of the in-line wrist and its fork."""
    tube = turned(
        [
            (0.108, -0.366),
            (0.112, -0.36),
            (0.112, -0.32),
            (0.1, -0.305),
            (0.098, -0.22),
            (0.104, -0.16),
            (0.104, -0.10),
            (0.098, -0.092),
        ],
        "x",
    )
    cheeks = []
    for side in (-1, 1):
        low, high = sorted((side * 0.083, side * 0.114))
        disc = rod(0.069, "y", low, high, (0, 0, 0), 0.008, 40)
        root = block((-0.2, min(side * 0.045, side * 0.1), -0.07), (-0.1, max(side * 0.045, side * 0.1), 0.07), 0.015)
        cheeks.append(skin(disc, root))
    clearance = rod(0.0915, "y", -0.0825, 0.0825, (0, 0, 0), 0.0)
    covers = joined(rod(0.048, "y", *sorted((side * 0.11, side * 0.1185)), (0, 0, 0), 0.003, 32) for side in (-1, 1))
    seal = ring(0.115, 0.1, "x", -0.378, -0.362)
    screws = joined(bolts(8, 0.057, 0.012, axis, 0.004, (0, side * 0.1135, 0)) for side, axis in ((-1, "-y"), (1, "y")))
    screws = screws + bolts(16, 0.105, 0.011, "x", 0.005, (-0.3205, 0, 0))
    return {"orange": (tube + joined(cheeks)) - clearance, "black": joined([covers, seal]), "grey": screws}


def wrist() -> Parts:
    """Return link_5: the hand that swings about A5."""
    hub = rod(0.08, "y", -0.078, 0.078, (0, 0, 0), 0.012, 40)
    nose = rod(0.074, "x", 0.085, 0.125, (0, 0, 0), 0.006)
    neck = turned([(0.076, 0.118), (0.078, 0.121), (0.078, 0.143), (0.075, 0.146)], "x")
    seal = turned([(0.07, 0.14), (0.07, 0.1535)], "x")
    screws = bolts(12, 0.0695, 0.009, "x", 0.004, (0.1455, 0, 0))
    caps = joined(rod(0.045, "y", *sorted((side * 0.07, side * 0.0798)), (0, 0, 0), 0.002, 32) for side in (-1, 1))
    return {"orange": skin(hub, nose) + neck, "black": seal + caps, "grey": screws}


def flange() -> Parts:
    """Return link_6: the mounting flange with eleven threads on a 125 mm circle, like ISO 9409-1-125."""
    disc = turned(
        [(0.07, 0.150), (0.07, 0.158), (0.08, 0.160), (0.08, 0.207), (0.078, 0.209), (0.078, 0.2145), (0.0775, 0.215)],
        "x",
        segments=64,
    )
    centre = rod(0.0315, "x", 0.207, 0.23, edge=0.0)
    threads = holes(12, 0.0625, 0.005, "x", 0.014, (FLANGE, 0, 0))
    mark = block((0.168, -0.006, 0.076), (0.198, 0.006, 0.0835), 0.002, 8)
    return {"grey": disc - centre - threads, "black": mark + ring(0.0812, 0.07, "x", 0.176, 0.186, edge=0.001)}


SEGMENTS_FINE = 56

#: How each link of the URDF is made.
LINKS: dict[str, Callable[[], Parts]] = {
    "link_0": base_frame, "link_1": carousel, "link_2": link_arm, "link_3": forearm,
    "link_4": wrist_tube, "link_5": wrist, "link_6": flange,
}  # fmt: skip
