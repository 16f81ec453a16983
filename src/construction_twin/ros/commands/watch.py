"""The terminal view of one robot, kept up to date: joint errors against their thresholds, rates, latency, counters, states."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import rospy
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from construction_twin.core.errors import SilenceError
from construction_twin.core.reports import SyncReport
from construction_twin.core.sentences import Sentence
from construction_twin.ros.shared.robot_listener import RobotListener
from construction_twin.views.hold_cause import hold_cause
from construction_twin.views.snapshot import Snapshot
from construction_twin.views.texts import because, joint_value, under_review, work_lines

#: Cells of a bar; a full bar is an error at its threshold.
BAR = 24
#: States shown in green and in red; the others are transitions, shown in yellow.
_GOOD = {"ARMED", "IN_SYNC", "IDLE", "PLAYING", "MIRROR"}
_BAD = {"DISCONNECTED", "GATEWAY_OFFLINE", "NO_CONTROLLER", "MISMATCH", "NEEDS_RESET", "STALE", "STOPPED", "FAULT"}
#: Counters of the gateway that mean something was late or lost, with the words for them.
COUNTERS = {
    "late_replies": "late replies",
    "commands_late": "late commands",
    "commands_lost": "lost commands",
    "cycles_without_command": "cycles without command",
    "states_lost": "lost states",
}


def render(snapshot: Snapshot) -> Group:
    """Return the picture of a snapshot, about 80 columns wide."""
    return Group(
        _states(snapshot),
        Panel(_joints(snapshot), title="|physical - twin| against its threshold", title_align="left", box=box.ROUNDED),
        Panel(_figures(snapshot), title="rates, latency, late counts", title_align="left", box=box.ROUNDED),
        _nodes(snapshot),
    )


def _states(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_row("robot", Text(snapshot.robot, style="bold"))
    if "sync" not in snapshot.silent and (cause := hold_cause(snapshot.hold)):
        table.add_row("holds", Text(cause, style="bold red"))
    for name in ("link", "sync", "execution"):
        facts = getattr(snapshot, name)
        if facts is None:
            table.add_row(name, Text(Sentence("startup.no_report"), style="dim"))
        elif name in snapshot.silent:
            silent = Sentence("view.watch.silent", seconds=snapshot.silent[name], state=facts.text)
            table.add_row(name, Text(silent, style="bold red"))
        else:
            table.add_row(name, _state(facts.text, facts.reason))
    execution = snapshot.execution
    progress = None if execution is None else execution.progress(snapshot.now)
    if execution is not None and progress is not None:
        cells = round(progress * BAR)
        far = Sentence("view.watch.progress", percent=_percent(progress), seconds=execution.duration)
        table.add_row("progress", Text(f"{'█' * cells}{'░' * (BAR - cells)} {far}"))
    for line in work_lines(execution):
        name, _, text = line.partition(" ")
        table.add_row(name, Text(text.strip(), style="red" if name == "engaged" else ""))
    if execution is not None and execution.speed_limit < 1.0:
        allowed, now = _percent(execution.speed_limit), _percent(execution.rate)
        limit = Sentence("view.watch.speed", allowed=allowed, now=now)
        table.add_row("speed", Text(limit, style="yellow"))
    table.add_row("review", Text(under_review(snapshot.plan)))
    return table


def _state(word: str, reason: str) -> Text:
    style = "green" if word in _GOOD else "red" if word in _BAD else "yellow"
    return Text.assemble((word, f"bold {style}"), because(reason))


def _joints(snapshot: Snapshot) -> Table | Text:
    sync = snapshot.sync
    if (
        sync is None
        or "sync" in snapshot.silent
        or len(sync.error) != len(snapshot.joints)
        or len(sync.threshold) != len(snapshot.joints)
    ):
        return Text(Sentence("view.watch.nothing"), style="dim")
    table = Table.grid(padding=(0, 2))
    rows = zip(snapshot.joints, snapshot.linear, sync.error, sync.threshold)
    for joint, linear, error, threshold in rows:
        table.add_row(joint, bar(error, threshold), _errors(error, threshold, linear))
    return table


def _errors(error: float, threshold: float, linear: bool) -> str:
    return f"{joint_value(error, linear, 4)} of {joint_value(threshold, linear, 4)}"


def bar(error: float, threshold: float) -> Text:
    """Return a bar that is full when the error is at its threshold; red beyond it, question marks when it is no number."""
    fraction = error / threshold if threshold > 0.0 else math.inf
    if not math.isfinite(error) or math.isnan(threshold):
        return Text("?" * BAR, style="red")
    cells = BAR if fraction >= 1.0 else math.floor(fraction * BAR)
    style = "red" if fraction > 1.0 else "yellow" if fraction > 0.5 else "green"
    return Text.assemble(("█" * cells, style), ("░" * (BAR - cells), "dim"))


def _figures(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 2))
    rates = "  ".join(f"{name} {_number(rate, '.1f')} Hz" for name, rate in snapshot.rates.items())
    table.add_row("rates", rates or Sentence("view.not_measured"))
    table.add_row("latency", _latency(snapshot.sync))
    link = snapshot.link
    table.add_row("late, lost", Sentence("view.watch.no_link") if link is None else _counts(link.gateway_counters))
    if link is not None:
        refused = sum(int(v) for k, v in link.gateway_counters.items() if k.startswith("refused_") and v.isdigit())
        line = f"gateway {refused}  bridge {link.commands_refused} commands, {link.states_refused} states"
        table.add_row("refused", line)
        jitter, delay = (link.gateway_counters.get(f"playout_{name}_ms", "") or "?" for name in ("jitter", "delay"))
        table.add_row("playout", f"gateway {link.gateway_state or '?'}, jitter {jitter} ms, delay {delay} ms")
    if snapshot.sync is not None:
        table.add_row(
            "gate", Sentence("view.watch.gate", count=snapshot.sync.violations, policy=snapshot.sync.policy or "?")
        )
    return table


def _latency(sync: SyncReport | None) -> str:
    if sync is None:
        return Sentence("view.not_measured")
    trip, lag = (None if math.isnan(value) else value * 1e3 for value in (sync.round_trip, sync.servo_lag))
    return f"round trip {_number(trip, '.1f')} ms  servo lag {_number(lag, '.1f')} ms"


def _counts(counters: Mapping[str, str]) -> str:
    # the gateway lists a counter from its first use on
    return "  ".join(f"{text} {counters.get(name, '0')}" for name, text in COUNTERS.items())


def _percent(fraction: float) -> str:
    return f"{fraction:.0%}".removesuffix("%")


def _number(value: float | None, form: str) -> str:
    return "?" if value is None else format(value, form)


def _nodes(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 2))
    troubled = [node for node in snapshot.nodes if node.level > 0]
    good = len(snapshot.nodes) - len(troubled)
    table.add_row("nodes", Text(Sentence("view.watch.nodes", good=good, all=len(snapshot.nodes))))
    for node in troubled:
        table.add_row("", Text(f"{node.name}: {node.sentence}", style="yellow" if node.level == 1 else "red"))
    return table


#: Time over which a single picture counts the rates [s].
COUNTING = 1.0


def watch(listener: RobotListener, rate: float, once: bool, timeout: float) -> None:
    """Show a robot until the process is interrupted, or once.

    Args:
        rate: Pictures per second.
        once: Print one picture and return.
        timeout: How long to wait for a first report [s].

    Raises:
        SilenceError: If no robot reports.
    """
    if not listener.wait(lambda: listener.newest("sync") or listener.newest("link"), timeout):
        nothing = Sentence("view.silent.nothing", seconds=timeout)
        raise SilenceError("sync and link", nothing, Sentence("view.to_do.give_robot"))
    console = Console(highlight=False)
    listener.snapshot()  # begins to count
    if once:
        time.sleep(COUNTING)
        console.print(render(listener.snapshot()))
        return
    with Live(console=console, auto_refresh=False, screen=console.is_terminal) as live:
        while not rospy.is_shutdown():
            time.sleep(1.0 / rate)
            live.update(render(listener.snapshot()), refresh=True)
