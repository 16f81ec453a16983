"""Command line: samples a robot's self collisions, writes the file, and proposes convex hulls. Needs no ROS master."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.convex_hulls import hull_lines, mesh_hulls, write_proposal
from construction_twin.scene.self_collision import (
    SAMPLES,
    SEED,
    parse_pairs,
    read_pairs_yaml,
    sample_self_collision,
    self_collision_yaml,
)

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
            for line in propose_hulls(robot, hull_folder(output)):
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
        owner = parse_pairs(read_pairs_yaml(output), str(output)).robot
    except ConfigurationError:
        # half a file, or one of an older version: that it is to be written is what was asked for
        return
    if owner != robot.name:
        raise ConfigurationError(
            str(output), f"the file of robot {owner}", f"a new file for {robot.name}, or one of its own"
        )


def hull_folder(output: Path) -> Path:
    """Return the folder beside a self_collision file in which hulls are proposed."""
    return output.with_name(f"{output.stem.removesuffix('_self_collision')}_hulls")


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
    """Refuse an output that cannot be written, before anything is computed.

    Raises ConfigurationError.
    """
    if output is None:
        return
    writable = output if output.exists() else output.parent
    if output.is_dir() or not os.access(writable, os.W_OK):
        raise ConfigurationError(str(output), "not writable", "a file in a folder that exists and can be written")
