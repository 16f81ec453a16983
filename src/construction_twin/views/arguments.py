"""The command line `twin`: its commands, options and exit codes. Angles in deg, lengths in mm."""

from __future__ import annotations

import argparse
import contextlib
import enum
import math
import os
import re

from construction_twin.core.extensions import ExtensionAbsent, import_extension

#: How long a service or a topic may stay silent before the command gives up [s].
TIMEOUT = 5.0

#: Commands that call the service of the same name, which takes nothing.
TRIGGERS = {
    "stop": "brake on the path and take the plan out of review",
    "pause": "rest on the path",
    "resume": "go on along the path after a pause",
    "reset": "after a fault: new session, the twin takes the arm's pose",
}


class Exit(enum.IntEnum):
    """What the command's exit code says; `docs/reference/command_line.md` lists them for scripts."""

    DONE = 0
    #: The system refused; its reason is on standard error.
    REFUSED = 1
    #: The command line is wrong.
    USAGE = 2
    #: No ROS master, no robot of this name, or a node that does not answer.
    SILENT = 3
    #: `--wait`: the motion ended, but not at its goal.
    NOT_FINISHED = 4
    #: `approve`: the person said no, or there is no terminal to ask on.
    NOT_CONFIRMED = 5
    #: The command was interrupted; a motion goes on.
    INTERRUPTED = 130


def read_command_line(words: list[str]) -> argparse.Namespace:
    """Return the options of the words of a command line; SystemExit for help and for what is refused."""
    # rospy.myargv would load rospy; argparse takes "-30,5" for an option, and accepts its comma
    words = [f" {word}" if re.match(r"-\.?\d.*,", word) else word for word in words if ":=" not in word]
    command_line = parser(os.environ.get("ROS_NAMESPACE", "").strip("/") or "kr120")
    options = command_line.parse_args(words)
    if problem := check(options):
        command_line.error(problem)
    return options


def parser(robot: str) -> argparse.ArgumentParser:
    """Return the parser of the whole command line; `robot`: namespace of the robot when none is given."""
    root = argparse.ArgumentParser(
        prog="twin",
        description="Plan, review and watch the motions of one robot and its twin. Angles in deg, lengths in mm.",
        epilog="exit codes: 0 done, 1 refused, 2 usage, 3 no system answers, 4 motion not finished, 5 not confirmed",
    )
    common = argparse.ArgumentParser(add_help=False)
    # given before or after the command; only the first of the two has a default
    for target, default, seconds in ((root, robot, TIMEOUT), (common, argparse.SUPPRESS, argparse.SUPPRESS)):
        target.add_argument("--robot", default=default, metavar="NAMESPACE", help=f"which robot [{robot}]")
        text = f"wait so long for the system [{TIMEOUT:g} s]"
        target.add_argument("--timeout", default=seconds, type=_positive, metavar="S", help=text)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        return commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", parents=[common])

    _add_plan(command("plan", "have a motion planned for review; nothing moves"))
    _add_pace(command("home", "have a motion to the home pose planned for review; nothing moves"))
    command("back", "have the way back out of an engaged segment planned for review; nothing moves")
    command("show", "show the plan under review")
    export = command("export", "write the newest plan, whatever became of it, as a CSV file that plan --csv reads")
    export.add_argument("file", metavar="FILE", help="the file to write; -: standard output")
    export.add_argument("--deg", action="store_true", help="in deg and mm [rad and m, to the last bit]")
    gateway = command("gateway", "write the gateway's configuration for the cell PC, from the parameters of a bringup")
    gateway.add_argument("file", metavar="FILE", help="the file to write, e.g. kr120_gateway.json; -: standard output")
    preview = command("preview", "let the ghost play the plan under review")
    preview.add_argument("--speed", type=_percent, default=1.0, metavar="PERCENT", help="of the plan's own speed [100]")
    add_approve(command("approve", "approve the plan under review: it starts"))
    reject = command("reject", "reject the plan under review")
    _add_verdict_options(reject)
    for name, text in TRIGGERS.items():
        command(name, text)
    arm = command("arm", "arm a bare PLC, and take the responsibility for what is not checked then")
    arm.add_argument("--responsible", default="", metavar="NAME", help="the person who is responsible; must be given")
    status = command("status", "say what link, gate and executor do")
    status.add_argument("--ready", action="store_true", help="end with 1 unless a plan could be approved now")
    command("rehearsal", "show what the simulated arm found of the newest plan; ends with 1 unless it passed")
    command("scene", "list what the arm must not touch")
    with contextlib.suppress(ExtensionAbsent):
        steps = import_extension("work.twin_arguments").add_steps
        steps(command("work", "work from a building model: its tasks, what comes next, what people say"), common)
    save = command("save-failure", "write the last plan that failed, else the hold of now, as a file to be replayed")
    save.add_argument("file", metavar="FILE", help="the file to write, e.g. failure.json; -: standard output")
    save.add_argument("--model", metavar="FILE", help="a URDF or IFC file that is refused, in place of what runs")
    watch = command("watch", "show states, joint errors and what was late until Ctrl-C")
    watch.add_argument("--once", action="store_true", help="print one picture and end")
    return root


def _add_plan(plan: argparse.ArgumentParser) -> None:
    goal = plan.add_mutually_exclusive_group(required=True)
    values, pose = "joint values, A1 first [deg; mm for a prismatic joint]", ("X", "Y", "Z", "A", "B", "C")
    goal.add_argument("--joints", type=finite, nargs="+", metavar="VALUE", help=values)
    goal.add_argument("--pose", type=finite, nargs=6, metavar=pose, help="of tool0: position [mm], KUKA's angles [deg]")
    goal.add_argument("--csv", metavar="FILE", help="joint waypoints in a file on the planner's machine")
    plan.add_argument("--line", action="store_true", help="with --pose: move the tool on a straight line")
    frame = "with --pose: link of the robot or tf frame of the pose [the robot's base]"
    plan.add_argument("--frame", default="", metavar="FRAME", help=frame)
    configuration = 'with --pose, without --line: e.g. "front up positive"'
    plan.add_argument("--configuration", default="", metavar="WORDS", help=configuration)
    plan.add_argument("--tool-speed", type=_positive, metavar="MM_S", help="with --line: speed of the tool [mm/s]")
    _add_pace(plan)


def _add_pace(command: argparse.ArgumentParser) -> None:
    speed = "fraction of the velocity limits [the planner's]"
    command.add_argument("--speed", type=_fraction, metavar="PERCENT", help=speed)
    command.add_argument("--duration", type=_positive, metavar="S", help="duration [as short as the speed allows]")


def _add_verdict_options(command: argparse.ArgumentParser) -> None:
    which = "id of the plan, or its beginning [the one under review]"
    command.add_argument("plan_id", nargs="?", default="", help=which)
    command.add_argument("--reviewer", default="", metavar="NAME", help="who decides [the user's name]")
    command.add_argument("--reason", default="", metavar="TEXT", help="kept with the verdict")


def add_approve(approve: argparse.ArgumentParser) -> None:
    """Add the options of an approval."""
    _add_verdict_options(approve)
    approve.add_argument("--yes", action="store_true", help="do not ask")
    approve.add_argument("--wait", action="store_true", help="wait until the motion has ended")
    override = "although its rehearsal is required, and missing or no pass; give --reason too"
    approve.add_argument("--override-rehearsal", action="store_true", help=override)


def check(options: argparse.Namespace) -> str:
    """Return the conflict of options of a parsed `plan` or `arm`, as a sentence; empty for none."""
    if options.command == "arm" and not options.responsible.strip():
        return "arm needs --responsible NAME: a person takes the responsibility for what is not checked with a bare PLC"
    if options.command != "plan":
        return ""
    for name in ("line", "frame", "configuration"):
        if getattr(options, name) and not options.pose:
            return f"--{name} belongs to --pose"
    if options.tool_speed and not options.line:
        return "--tool-speed belongs to --line"
    if options.configuration and options.line:
        return "--configuration does not go with --line: the tool goes on in the arm's present configuration"
    if options.duration and (options.line or options.csv):
        return f"--duration does not go with {'--line' if options.line else '--csv'}"
    return ""


def finite(text: str) -> float:
    """Return the number of an option; refuse nan and infinity."""
    if "," in text:
        raise argparse.ArgumentTypeError(
            f"{text.strip()!r} holds a comma: write decimals with a point, and separate numbers by spaces"
        )
    try:
        value = float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from error
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is no finite number")
    return value


def _positive(text: str) -> float:
    value = finite(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def _percent(text: str) -> float:
    return _positive(text) / 100.0


def _fraction(text: str) -> float:
    value = _percent(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is above 100 percent")
    return value
