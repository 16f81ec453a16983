"""The command `twin`, whose options `views.arguments` reads. A step imports what it alone needs: `twin stop` loads no planner."""

from __future__ import annotations

import argparse
import contextlib
import getpass
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rospy

from construction_twin.core.errors import (
    ConfigurationError,
    ConstructionTwinError,
    RequestRefused,
    SilenceError,
    command_message,
)
from construction_twin.core.extensions import import_extension
from construction_twin.core.files import write_atomically
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution, Rehearsal, Scene
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import BY_ACTION, Plan
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.messages.services import Outcome, pose_fields
from construction_twin.ros.shared.master import TO_DO, await_master, expect_publisher, publishing_nodes
from construction_twin.ros.shared.params import robot_from_parameters
from construction_twin.ros.shared.robot_client import OperatorClient, RobotListener
from construction_twin.views.arguments import TRIGGERS, Exit
from construction_twin.views.goals import joint_goal, pose_goal
from construction_twin.views.texts import caller_line, plan_lines, scene_lines, status_lines, watch_lines

if TYPE_CHECKING:
    from construction_twin.review.rehearsal_report import RehearsalReport

#: States of the executor in which no plan is under way.
_AT_REST = (Execution.WAITING, Execution.IDLE)
#: How long to wait for a latched message that may not exist [s].
LATCHED = 2.0
#: Between two pictures of `twin watch` [s].
WATCH_PERIOD = 0.25


class Command:
    """One call of the command line: a method for each command, and what several need."""

    def __init__(self, options: argparse.Namespace):
        self._options = options
        self._namespace = "/" + options.robot.strip("/")
        self._client = OperatorClient(self._namespace, options.timeout, f"twin ({account_name()})")

    def run(self) -> Exit:
        """Carry out the command; errors are those of `OperatorClient`."""
        name = self._options.command
        if name in TRIGGERS:
            return _print_outcome(self._client.trigger(name))
        return getattr(self, f"_{name.replace('-', '_')}")()

    def _plan(self) -> Exit:
        options = self._options
        goal: dict[str, Any]
        if options.csv is not None:
            kind, goal = "csv", {"path": str(Path(options.csv).absolute())}
        elif options.joints is not None:
            kind, goal = "joints", {"joints": joint_goal(options.joints, self._robot())}
        else:
            kind, goal = "line" if options.line else "pose", pose_fields(pose_goal(options.pose, options.frame))
            speed = (options.tool_speed or 0.0) / 1e3
            goal |= {"frame": options.frame, "configuration": options.configuration, "speed": speed}
        return self._plan_to(kind, **goal)

    def _home(self) -> Exit:
        return self._plan_to("joints", joints=self._robot().home)

    def _plan_to(self, kind: str, **goal: Any) -> Exit:
        options = self._options
        asked = GoalRequest(kind, duration=options.duration or 0.0, speed_scale=options.speed or 0.0, **goal)
        return _print_outcome(self._client.plan(asked))

    def _back(self) -> Exit:
        return _print_outcome(self._client.plan(GoalRequest("way_back")))

    def _show(self) -> Exit:
        listener = self._listener()
        self._print_plan(self._under_review(listener), listener)
        return Exit.DONE

    def _export(self) -> Exit:
        options = self._options
        listener = self._listener()
        listener.wait(lambda: listener.newest("plan") is not None, min(LATCHED, options.timeout))
        newest = listener.newest("plan")
        if newest is None:
            raise RequestRefused("no plan was made since the planner started; plan one, then export it")
        plan = listener.plan(newest.id)
        if plan is None:
            raise RequestRefused(listener.refused)
        format_plan = import_extension("planners.waypoint_file").format_plan
        if write_or_print(options.file, format_plan(plan, self._robot().linear, options.deg)):
            print(f"plan {plan.id}: {len(plan.trajectory.times)} waypoints in {options.file}")
        return Exit.DONE

    def _gateway(self) -> Exit:
        from construction_twin.ros.nodes.rsi_gateway import config_from_parameters

        config = config_from_parameters(f"{self._namespace}/")
        layout, make = config.layout, config.make
        if write_or_print(self._options.file, config.to_json()):
            tool = f"tool {config.tool.name}, {', '.join(make.tool_channels(layout))}" if config.tool else "no tool"
            unfilled = (
                f"; not filled, so they stay as they are: {', '.join(layout.not_filled)}" if layout.not_filled else ""
            )
            print(
                f"{self._options.file}: configuration {config.hash[:12]} of {config.robot}, {config.decimals} decimals; "
                f"{make.terms.protocol} on UDP port {layout.port}, {layout.summary}; {tool}{unfilled}"
            )
        return Exit.DONE

    def _preview(self) -> Exit:
        return _print_outcome(self._client.preview(self._options.speed))

    def _work(self) -> Exit:
        """Do one step of the work from a building model; approving is as for every plan, once the plan is that of a task."""
        work = import_extension("work.commands.twin_work").WorkCommand(self._options, account_name(), self._client)
        if self._options.step != "approve":
            return work.run()
        return self._approve(*work.plan_under_review())

    def _approve(self, expected: str = "", with_names: Callable[[str], str] = str) -> Exit:
        """Approve the plan under review, if it is `expected`; `with_names` puts names in place of ids in what is printed."""
        options = self._options
        listener = self._listener()
        plan = self._under_review(listener)
        if expected and plan.id != expected:
            raise RequestRefused(
                f"plan {plan.id} is under review, not {expected} of the task: twin show, twin work list"
            )
        self._print_plan(plan, listener, with_names)
        shown_hash = self._print_rehearsal(plan) if options.override_rehearsal else None
        if not options.yes and not _confirmed():
            print("not approved; the plan still waits", file=sys.stderr)
            return Exit.NOT_CONFIRMED
        self._review(plan, "approved", shown_hash)
        return self._wait(listener, plan) if options.wait else Exit.DONE

    def _reject(self) -> Exit:
        return self._review(self._under_review(self._listener()), "rejected")

    def _arm(self) -> Exit:
        return _print_outcome(self._client.arm(self._options.responsible))

    def _status(self) -> Exit:
        listener = self._listener()
        listener.wait(lambda: listener.newest("sync") and listener.newest("execution"), self._options.timeout)
        self._await_latched(listener)
        snapshot = listener.snapshot()
        if snapshot.link is snapshot.sync is snapshot.execution is None:
            raise SilenceError(self._namespace, "no node reports", "start bringup, or give another --robot")
        print("\n".join(status_lines(snapshot)))
        if not self._options.ready:
            return Exit.DONE
        lacking = snapshot.not_ready()
        print("ready" if not lacking else f"not ready: {'; '.join(lacking)}")
        return Exit.REFUSED if lacking else Exit.DONE

    def _watch(self) -> Exit:
        options, listener = self._options, self._listener()
        if not listener.wait(lambda: listener.newest("sync") or listener.newest("link"), options.timeout):
            nothing = f"no report (waited {options.timeout:g} s)"
            raise SilenceError("sync and link", nothing, "start bringup, or give --robot")
        self._await_latched(listener)
        while not rospy.is_shutdown():
            # on a terminal the last picture is wiped out
            print("\033[H\033[J" * sys.stdout.isatty() + "\n".join(watch_lines(listener.snapshot())), flush=True)
            if options.once:
                break
            time.sleep(WATCH_PERIOD)
        return Exit.DONE

    def _scene(self) -> Exit:
        silent = "the scene node does not publish", "see why it is down"
        print("\n".join(scene_lines(scene_from_msg(self._client.latched("scene", Scene, *silent)))))
        return Exit.DONE

    def _save_failure(self) -> Exit:
        from construction_twin.ros.commands.save_failure import running_failure

        listener = self._listener()
        listener.wait(lambda: listener.newest("sync"), self._options.timeout)
        self._await_latched(listener)
        return _write_failure(self._options.file, running_failure(self._namespace, listener.snapshot(), self._client))

    def _rehearsal(self) -> Exit:
        """Show what the rehearsal of the newest plan has found; the exit code is 0 if it passed."""
        to_do = "have a motion planned, or see on /diagnostics why there is no rehearsal"
        message = self._client.latched("rehearsal", Rehearsal, "no plan was rehearsed yet", to_do)
        return Exit.DONE if _print_report(message).state == "passed" else Exit.REFUSED

    # -- what several of them need

    def _robot(self) -> RobotModel:
        return robot_from_parameters(f"{self._namespace}/")

    def _listener(self) -> RobotListener:
        return RobotListener(self._namespace, self._robot())

    def _under_review(self, listener: RobotListener) -> Plan:
        """Return the plan under review; RequestRefused for none, or another one than named."""
        expect_publisher(f"{self._namespace}/execution")
        if not listener.wait(lambda: listener.newest("execution") is not None, self._options.timeout):
            topic = f"{self._namespace}/execution"
            raise SilenceError(topic, "the executor does not report", "start bringup, or see why the node is down")
        listener.wait(lambda: listener.publishers("plan") > 0, self._options.timeout)
        self._await_latched(listener)
        plan = listener.under_review()
        if plan is None:
            raise RequestRefused(listener.refused or "no plan waits for approval; plan one, then review it")
        wanted = getattr(self._options, "plan_id", "")
        if not plan.id.startswith(wanted):
            raise RequestRefused(f"plan {wanted} is not under review; {plan.id} is")
        return plan

    def _await_latched(self, listener: RobotListener) -> None:
        """Wait for latched messages of connected publishers: a connection may take seconds."""
        patience = min(LATCHED, self._options.timeout)
        for name in ("link", "plan", "review"):
            if name == "review" and listener.newest("plan") is None:
                return
            if publishing_nodes(f"{self._namespace}/{name}"):
                listener.wait(partial(listener.publishers, name), self._options.timeout)
                listener.wait(partial(listener.newest, name), patience / 2 if name == "review" else patience)

    def _print_plan(self, plan: Plan, listener: RobotListener, with_names: Callable[[str], str] = str) -> None:
        from construction_twin.kinematics.chain import Chain
        from construction_twin.robot.frames import pendant_text

        robot = self._robot()
        tool = pendant_text(Chain(robot).frame(plan.trajectory.positions[-1]))
        lines = plan_lines(plan, robot.linear, listener.changes(plan.id), tool)
        if plan.source.startswith(f"{BY_ACTION} "):
            lines.append(self._caller_line(plan, listener))
        print("\n".join(map(with_names, lines)))

    def _caller_line(self, plan: Plan, listener: RobotListener) -> str:
        def caller_received() -> bool:
            newest = listener.newest("plan_caller")
            return newest is not None and newest.plan_id == plan.id

        if not listener.wait(caller_received, min(LATCHED, self._options.timeout)):
            return caller_line(plan.source.removeprefix(f"{BY_ACTION} "), None)
        caller = listener.newest("plan_caller")
        return caller_line(caller.client, caller.connected)

    def _print_rehearsal(self, plan: Plan) -> str:
        """Print what the rehearsal of a plan has found; return the result's hash, "" where there is none."""
        message = None
        with contextlib.suppress(rospy.ROSException):  # nothing is latched: no plan was rehearsed yet
            patience = min(LATCHED, self._options.timeout)
            message = rospy.wait_for_message(f"{self._namespace}/rehearsal", Rehearsal, patience)
        if message is None or (message.plan_id, message.plan_hash) != (plan.id, plan.hash):
            print(f"plan {plan.id} was not rehearsed yet, and it must be")
            return ""
        return _print_report(message).hash

    def _review(self, plan: Plan, verdict: str, shown_hash: str | None = None) -> Exit:
        """Give a verdict; `shown_hash`: an approval in spite of the rehearsal whose result has this hash, "" for none."""
        given = plan.id, plan.hash, verdict, self._options.reviewer or account_name(), self._options.reason
        request = ReviewRequest(*given, override_rehearsal=shown_hash is not None, rehearsal_hash=shown_hash or "")
        return _print_outcome(self._client.review(request))

    def _wait(self, listener: RobotListener, plan: Plan) -> Exit:
        reported = []

        def over() -> bool:
            report = listener.newest("execution")
            if report.plan_id == plan.id:
                reported.append(report.plan_id)
                return report.state in _AT_REST and bool(report.outcome)
            # after this plan the executor reports another one or none (a new session, another executor), or it is gone
            return bool(reported) or not listener.publishers("execution")

        listener.wait(over, None)
        report = listener.newest("execution")
        outcome = report.outcome if report.plan_id == plan.id else "dropped"
        print(f"{outcome or 'dropped'}: {report.reason}")
        return Exit.DONE if outcome == "finished" else Exit.NOT_FINISHED


def connect(options: argparse.Namespace) -> None:
    """Register as a node; SilenceError unless a master with a robot of this name answers."""
    await_master(options.timeout)
    rospy.init_node("twin", anonymous=True, disable_signals=True)
    namespace = "/" + options.robot.strip("/")
    if not rospy.has_param(f"{namespace}/robot/name"):
        suffix = "/robot/name"
        names = sorted(name.removesuffix(suffix) for name in rospy.get_param_names() if name.endswith(suffix))
        known = f"known here: {', '.join(names)}; give --robot" if names else TO_DO
        raise SilenceError(namespace, "there is no robot of this name", known)


def run(options: argparse.Namespace) -> int:
    """Do what a command line says; return an exit code of `views.arguments.Exit`."""
    try:
        if getattr(options, "model", None):
            from construction_twin.replay import model_failure

            return _write_failure(options.file, model_failure(Path(options.model)))
        connect(options)
        return Command(options).run()
    except SilenceError as error:
        return _print_error(error, Exit.SILENT)
    except (KeyboardInterrupt, BrokenPipeError):  # the second: who reads has ended, as `| head` does
        return Exit.INTERRUPTED
    except (ConfigurationError, OSError) as error:
        return _print_error(error, Exit.USAGE)
    except ConstructionTwinError as error:
        return _print_error(error, Exit.REFUSED)


def _print_error(error: Exception, code: Exit) -> Exit:
    print(f"twin: {command_message(error)}", file=sys.stderr)
    return code


def _write_failure(file: str, failure: str) -> Exit:
    if write_or_print(file, failure):
        print(f"{file}: python3 -m construction_twin.replay says what happens now")
    return Exit.DONE


def write_or_print(file: str, text: str) -> bool:
    """Write a text into a file, whole, or print it, for "-"; return whether it was written."""
    if file == "-":
        print(text, end="")
        return False
    try:
        write_atomically(Path(file).absolute(), text)
    except OSError as error:
        raise ConfigurationError(file, error.strerror or str(error), "a file that can be written") from error
    return True


def _print_report(message: Any) -> RehearsalReport:
    """Print what a rehearsal has found, and return it; ConstructionTwinError where its hash is not its own."""
    from construction_twin.evaluation.tables import table_console
    from construction_twin.review.rehearsal_report import RehearsalReport, is_consistent
    from construction_twin.ros.messages.records import from_msg
    from construction_twin.views.rehearsal_table import rehearsal_table

    report = from_msg(RehearsalReport, message)
    if not is_consistent(report):
        raise ConstructionTwinError(f"the rehearsal of plan {report.plan_id!r} is not what its hash says")
    table_console().print(rehearsal_table(report))
    return report


def _print_outcome(outcome: Outcome) -> Exit:
    print(outcome.message)
    return Exit.DONE


def account_name() -> str:
    """Return the user's login name, or the number of an account without a name (in a container)."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"


def _confirmed() -> bool:
    """Ask at the terminal, False if there is none."""
    if not sys.stdin.isatty():
        print("twin: there is no terminal to ask on; look at the plan, then give --yes", file=sys.stderr)
        return False
    try:
        return input("approve, and so start it? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False  # Ctrl-D
