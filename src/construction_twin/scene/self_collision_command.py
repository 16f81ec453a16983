"""Command line: samples a robot's self collisions, writes the file, and proposes convex hulls. Needs no ROS master.

A hull in place of a collision mesh is closed, quick to check, and encloses its mesh; but it also fills hollows, which the arm then
cannot use. Nothing is replaced: the proposal is a URDF of its own beside its meshes. Metres; volumes in m^3.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from scipy.spatial import ConvexHull, QhullError

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
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
from construction_twin.scene.solids import parts, solid, union
from construction_twin.scene.triangle_mesh import hull_mesh


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of one collision mesh.

    Attributes:
        number: Which collision element of the link, from 0.
        triangles: Of the mesh.
        volume: Of the mesh [m^3]; None: it is not closed, so that it has none.
        vertices: Shape (v, 3). Of the hull, in the frame of the collision element [m].
        faces: Shape (t, 3), integers. Of the hull, counterclockwise seen from outside.
        hull_volume: [m^3]
    """

    link: str
    number: int
    triangles: int
    volume: float | None
    vertices: np.ndarray
    faces: np.ndarray
    hull_volume: float


def mesh_hulls(bodies: RobotBodies) -> list[Hull]:
    """Return the hull of every collision mesh that is not convex itself, in the order of the links."""
    hulls = []
    numbers: dict[str, int] = {}
    for body in bodies.bodies:
        number = numbers.get(body.link, 0)
        numbers[body.link] = number + 1
        if not isinstance(body.geometry, coal.BVHModelBase):
            continue
        vertices, triangles = mesh_triangles(body.geometry)
        if is_convex(vertices, triangles):
            continue
        try:
            # of the numbers that an STL file can hold: rounded later, the faces would no longer be those of a convex body
            hull = ConvexHull(vertices.astype(np.float32).astype(float))
        except QhullError as error:
            raise ConfigurationError(
                f"URDF link {body.link} collision mesh", f"{len(triangles)} triangles in one plane",
                "a mesh that has a volume; mend it, or have no hulls proposed",
            ) from error  # fmt: skip
        closed = solid(vertices, triangles)
        # closed surfaces that reach into each other count once
        volume = None if closed is None else float(union(parts(closed)).volume())
        corners, faces = hull_mesh(hull)
        hulls.append(Hull(body.link, number, len(triangles), volume, corners, faces, float(hull.volume)))
    return hulls


def write_proposal(urdf: str, hulls: Sequence[Hull], folder: Path) -> Path:
    """Write the meshes of the hulls, and a URDF with them in place of the meshes, into a folder; return the URDF's path."""
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    root = ElementTree.fromstring(urdf.encode())
    links = {link.get("name"): link for link in root.iter("link")}
    for hull in hulls:
        file = folder / f"{hull.link}_{hull.number}.stl"
        file.write_bytes(binary_stl(hull.vertices[hull.faces]))
        mesh = links[hull.link].findall("collision")[hull.number].find("geometry/mesh")
        assert mesh is not None
        # the hull is in metres: a scale was applied
        mesh.attrib = {"filename": f"file://{file}"}
    path = folder / "robot.urdf"
    note = "<!-- A proposal by `rosrun construction_twin self_collision`: convex hulls in place of the collision meshes. -->"
    text = f'<?xml version="1.0"?>\n{note}\n{ElementTree.tostring(root, encoding="unicode")}\n'
    path.write_text(text, encoding="utf-8")
    return path


def hull_lines(hulls: Sequence[Hull]) -> list[str]:
    """Return a table of the hulls for a terminal: volumes in litres."""
    width = max(len("link"), *(len(hull.link) for hull in hulls))
    lines = [f"{'link':<{width}}  {'triangles':>17}  {'mesh':>9}  {'hull':>9}  added"]
    for hull in hulls:
        mesh, added = "?", "unknown: the mesh is not closed"
        if hull.volume is not None:
            more = hull.hull_volume - hull.volume
            mesh, added = f"{hull.volume * 1e3:.2f} l", f"{more * 1e3:.2f} l ({100 * more / hull.volume:.0f} %)"
        lines.append(
            f"{hull.link:<{width}}  {hull.triangles:>7} -> {len(hull.faces):>6}  {mesh:>9}  "
            f"{hull.hull_volume * 1e3:>7.2f} l  {added}"
        )
    return lines


#: Without a terminal a line is printed each time this part of the poses is done.
_PART = 0.25


def main(arguments: Sequence[str] | None = None) -> None:
    """Sample a robot's self collisions and write the file."""
    options = _parser().parse_args(arguments)
    if options.samples < 1 or options.seed < 0:
        sys.exit(f"self_collision: found {options.samples} samples, seed {options.seed}; expected 1 or more, 0 or more")
    output = None if options.output == "-" else Path(options.output).absolute()
    try:
        _check_folder(output)
        robot = read_robot_files(options.urdf, options.robot, options.robot_xacro_args)
        _check_owner(output, robot)
        with progress(options.samples) as report:
            found = sample_self_collision(robot, options.samples, options.seed, report)
        text = self_collision_yaml(robot, found, options.samples, options.seed)
        if output is None:
            print(text, end="")
            return
        output.write_text(text, encoding="utf-8")
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
        prog="self_collision",
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


def propose_hulls(robot: RobotModel, folder: Path) -> list[str]:
    """Write the proposal of a robot's hulls, if it has meshes that are not convex; return what to tell about it."""
    hulls = mesh_hulls(RobotBodies(robot))
    if not hulls:
        return []
    path = write_proposal(robot.urdf, hulls, folder)
    return [
        f"{path}: a proposal, convex hulls in place of {len(hulls)} meshes; take it as URDF where the added volume does no harm:",
        *(f"  {line}" for line in hull_lines(hulls)),
    ]


@contextmanager
def progress(samples: int) -> Iterator[Callable[[int, int], None]]:
    """Give a function that shows how far the sampling is: a bar on a terminal, single lines otherwise. On standard error."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield _lines(samples)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("sampling", total=samples)

        def report(poses: int, pairs: int) -> None:
            bar.update(task, completed=poses, description=f"sampling, {pairs} pairs not decided")

        yield report


def _lines(samples: int) -> Callable[[int, int], None]:
    reported = 0.0

    def report(poses: int, pairs: int) -> None:
        nonlocal reported
        done = min(1.0, poses / samples)
        if done - reported >= _PART or (done == 1.0 and reported < 1.0):
            reported = done - done % _PART
            print(f"sampling: {poses} of {samples} poses, {pairs} pairs not decided", file=sys.stderr, flush=True)

    return report


def _check_folder(output: Path | None) -> None:
    """Refuse an output that cannot be written, before anything is computed."""
    if output is None:
        return
    writable = output if output.exists() else output.parent
    if output.is_dir() or not os.access(writable, os.W_OK):
        raise ConfigurationError(str(output), "not writable", "a file in a folder that exists and can be written")
