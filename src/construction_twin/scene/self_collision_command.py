"""Command line: samples a robot's self collisions, writes the file, and proposes convex hulls. Needs no ROS master.

A hull in place of a collision mesh is closed, quick to check, and encloses its mesh; but it also fills hollows, which the arm then
cannot use. Nothing is replaced: the proposal is a URDF of its own beside its meshes. Metres; volumes in m^3.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.files import check_writable, write_atomically
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.scene.collision_bodies import RobotBodies, is_convex, mesh_triangles
from construction_twin.scene.mesh_file import binary_stl
from construction_twin.scene.self_collision import (
    SAMPLES,
    SEED,
    read_pairs,
    sample_self_collision,
    self_collision_yaml,
)
from construction_twin.scene.solids import hull_solid, mesh_of, parts, solid, union


def propose_hulls(robot: RobotModel, folder: Path) -> list[str]:
    """Write the hulls of a robot's collision meshes that are not convex, and a URDF with them; return what to tell about it."""
    folder = folder.absolute()
    root = ElementTree.fromstring(robot.urdf.encode())
    links = {link.get("name"): link for link in root.iter("link")}
    numbers: Counter[str] = Counter()
    lines = []
    for body in RobotBodies(robot).bodies:
        number = numbers[body.link]
        numbers[body.link] += 1
        if not isinstance(body.geometry, coal.BVHModelBase):
            continue
        vertices, triangles = mesh_triangles(body.geometry)
        if is_convex(vertices, triangles):
            continue
        # of the numbers that an STL file can hold: rounded later, the faces would no longer be those of a convex body
        hull = hull_solid(vertices.astype(np.float32))
        if not hull.volume() > 0.0:
            raise ConfigurationError(
                f"URDF link {body.link} collision mesh", f"{len(triangles)} triangles in one plane",
                "a mesh that has a volume; mend it, or have no hulls proposed",
            )  # fmt: skip
        corners, faces = mesh_of(hull)
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / f"{body.link}_{number}.stl"
        file.write_bytes(binary_stl(corners[faces]))
        mesh = links[body.link].findall("collision")[number].find("geometry/mesh")
        assert mesh is not None
        # the hull is in metres: a scale was applied
        mesh.attrib = {"filename": f"file://{file}"}
        added, closed = "? l more, the mesh is not closed", solid(vertices, triangles)
        if closed is not None:
            # closed surfaces that reach into each other count once
            volume = union(parts(closed)).volume()
            more = hull.volume() - volume
            added = f"{more * 1e3:.2f} l more than {volume * 1e3:.2f} l ({100 * more / volume:.0f} %)"
        lines.append(f"  {body.link} {number}: {len(triangles)} -> {len(faces)} triangles, {added}")
    if not lines:
        return []
    path = folder / "robot.urdf"
    note = "<!-- A proposal by `new_arm self_collision`: convex hulls in place of the collision meshes. -->"
    text = f'<?xml version="1.0"?>\n{note}\n{ElementTree.tostring(root, encoding="unicode")}\n'
    path.write_text(text, encoding="utf-8")
    return [
        f"{path}: a proposal, convex hulls in place of {len(lines)} meshes; take it as URDF where the added volume does no harm:",
        *lines,
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Sample a robot's self collisions and write the file."""
    options = _parser().parse_args(arguments)
    if options.samples < 1 or options.seed < 0:
        sys.exit(f"self_collision: found {options.samples} samples, seed {options.seed}; expected 1 or more, 0 or more")
    output = None if options.output == "-" else Path(options.output).absolute()
    try:
        if output is not None:
            if not output.parent.is_dir():
                raise ConfigurationError("--output", str(output), "a file in a folder that exists")
            check_writable(output.parent)
        robot = read_robot_files(options.urdf, options.robot, options.robot_xacro_args)
        _check_owner(output, robot)
        print(f"sampling {options.samples} poses", file=sys.stderr, flush=True)
        found = sample_self_collision(robot, options.samples, options.seed)
        text = self_collision_yaml(robot, found, options.samples, options.seed)
        if output is None:
            print(text, end="")
            return
        write_atomically(output, text)
        print(f"{output}: {len(found.ignored)} pairs left out, geometry {found.geometry_hash[:12]} of {robot.name}")
        if not options.no_hulls:
            for line in propose_hulls(robot, output.with_name(f"{output.stem.removesuffix('_self_collision')}_hulls")):
                print(line)
    except (ConstructionTwinError, OSError) as error:
        sys.exit(f"self_collision: {error}")
    except KeyboardInterrupt:
        sys.exit(130)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="new_arm self_collision",
        description="Find the pairs of links that need no check against each other, and write them to a YAML file. Collision "
        "meshes that are not convex: propose their hulls in a folder beside it.",
    )
    parser.add_argument("urdf", help="URDF or xacro")
    parser.add_argument("robot", help="robot YAML, e.g. config/kr120.yaml")
    parser.add_argument("output", help="file to write; - for the terminal")
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="random poses [%(default)s]")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the random numbers [%(default)s]")
    parser.add_argument("--no-hulls", action="store_true", help="propose no hulls")
    return parser


def _check_owner(output: Path | None, robot: RobotModel) -> None:
    """Refuse to write over the file of another arm, which would no longer start."""
    if output is None or not output.exists():
        return
    try:
        owner = read_pairs(output).robot
    except ConfigurationError:
        # half a file, or one of an older version: that it is to be written is what was asked for
        return
    if owner != robot.name:
        raise ConfigurationError(
            str(output), f"the file of robot {owner}", f"a new file for {robot.name}, or one of its own"
        )
