"""Photographs every state of the console at four sizes, in two themes and two languages: `make screenshots ARGS=console_all`.

A scripted robot at a real broker and console, the page in chromium. Each picture is a file below `results/console_states/`, and
`contact_sheet.png` has them all beside each other, a row per state. For looking at: nothing is compared.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test/support"))

import numpy as np  # noqa: E402
from console_page import ConsolePage, launch  # noqa: E402
from console_site import ConsoleSite  # noqa: E402
from playwright.sync_api import Browser, expect, sync_playwright  # noqa: E402
from scripted_robot import ScriptedRobot  # noqa: E402

from construction_twin.core.records import document  # noqa: E402
from construction_twin.core.reports import HoldReport, LinkReport, TaskReport, WorkReport  # noqa: E402
from construction_twin.core.sentences import Quantity, Sentence  # noqa: E402
from construction_twin.core.units import NANOSECONDS  # noqa: E402
from construction_twin.views.hold_cause import hold_cause  # noqa: E402
from construction_twin.views.message_history import RESET, MessageHistory  # noqa: E402
from construction_twin.views.startup import Word  # noqa: E402
from construction_twin.views.status_line import ReportsNow, status_lines  # noqa: E402

#: A tablet on its side, a desk, a phone on its side and upright.
SIZES = ((1280, 800), (1920, 1080), (844, 390), (390, 844))
THEMES, LANGUAGES = ("light", "dark"), ("en", "de")
#: Width of a picture on the contact sheet [px].
THUMBNAIL = 260
#: Axis of the arm that stalls, and by how much it is off [rad].
STALLED, OFF = 2, 0.0132

_ARMED, _IN_SYNC, _IDLE = Word("ARMED", ""), Word("IN_SYNC", ""), Word("IDLE", "")
_DIFFERS = Sentence(
    "reason.gate.differs", joint="joint_a3", difference=Quantity(OFF, "rad"), threshold=Quantity(0.01, "rad")
)
_STOPPED = Sentence(
    "link.call_reset",
    reason=Sentence(
        "link.stopped", number="3", state="stopped", reason=Sentence("gateway.asked.account", account="bob")
    ),
)


@dataclass(frozen=True)
class State:
    """One state of the page.

    Attributes:
        account: Who is logged in; empty: nobody, which leaves the login.
        prepare: Brings robot and page into it.
    """

    name: str
    prepare: Callable[[ScriptedRobot, ConsolePage], object] = lambda robot, page: None
    account: str = "dora"


def _say(robot: ScriptedRobot, **changes: object) -> None:
    """Have the robot's status line say what these reports are about."""
    reports = ReportsNow(**{"link": _ARMED, "sync": _IN_SYNC, "execution": _IDLE} | changes)  # type: ignore[arg-type]
    robot.lines = document(status_lines(reports))
    robot.publish("screen", json.dumps(robot.lines).encode())


def _messages(robot: ScriptedRobot) -> None:
    numbers = iter(range(100))
    history = MessageHistory(lambda: f"m{next(numbers)}")
    now = time.time()
    stopped = status_lines(ReportsNow(link=Word("NEEDS_RESET", _STOPPED), sync=_IN_SYNC, execution=_IDLE))
    for at in (now - 900, now - 890):
        history.on_lines(stopped, at)
    history.acknowledge("m0", "ada", now - 880)
    history.on_lines(status_lines(ReportsNow(link=_ARMED, sync=_IN_SYNC, execution=_IDLE)), now - 870)
    history.on_act(RESET, now - 870, person="ada", lifts=_STOPPED)
    for at in (now - 20, now - 10):
        history.on_lines(status_lines(ReportsNow(link=_ARMED, sync=Word("HOLDING", ""), cause=_cause())), at)
    robot.publish("messages", history.text, retain=True)


def _cause() -> str:
    return hold_cause(HoldReport(_DIFFERS, time.time_ns() - 20 * NANOSECONDS))


def _held(robot: ScriptedRobot, page: ConsolePage) -> None:
    robot.arm_error[STALLED] = OFF
    robot.show_plan(source="re-plan after HOLDING")
    obstacle = Sentence("executor.start.sync", state="REPLANNING")
    _say(robot, sync=Word("REPLANNING", ""), cause=_cause(), plan="p", obstacle=obstacle)


def _stopped(robot: ScriptedRobot, page: ConsolePage) -> None:
    robot.link = replace(robot.link, text="NEEDS_RESET", reason=_STOPPED)
    _say(robot, link=Word("NEEDS_RESET", _STOPPED))


def _paused(robot: ScriptedRobot, page: ConsolePage) -> None:
    robot.show_plan(duration=60.0)
    robot.state = "PAUSED"
    _say(robot, execution=Word("PAUSED", ""))


def _playing(robot: ScriptedRobot, page: ConsolePage) -> None:
    robot.show_plan(duration=60.0)
    robot.play()
    _say(robot, execution=Word("PLAYING", ""))


def _work() -> WorkReport:
    question = Sentence("work.question.where", element="stud 3", known=Sentence("work.known.carried"))
    rows = (
        ("sole plate", "done"),
        ("stud 2", "done"),
        ("stud 3", "asks"),
        ("stud 4", "waiting"),
        ("header", "waiting"),
    )
    tasks = tuple(
        TaskReport(
            id=str(number),
            name=f"Place {name}",
            element=f"e{number}",
            element_name=name,
            state=state,
            reason="",
            after=(),
            question=question if state == "asks" else "",
            answers=("in_stock", "in_grip", "placed", "gone") if state == "asks" else (),
        )  # fmt: skip
        for number, (name, state) in enumerate(rows, 1)
    )
    return WorkReport(
        model="panel.ifc", model_hash="0", schedule="model", engaged=False, next="", reason="", tasks=tasks, notes=()
    )


def _asks(robot: ScriptedRobot, page: ConsolePage) -> None:
    work = _work()
    robot.publish("work/tasks", json.dumps(document(work)).encode(), retain=True)
    _say(robot, work=work)
    page.tab("tasks")


def _review(robot: ScriptedRobot, page: ConsolePage) -> None:
    robot.show_plan(source="MQTT account dora")
    _say(robot, plan="p")


def _looked_at(robot: ScriptedRobot, page: ConsolePage) -> None:
    _review(robot, page)
    page.page.locator(".verdict-checks summary").click()


def _goal(robot: ScriptedRobot, page: ConsolePage) -> None:
    page.tab("plan").locator(".plan-begin").click()


def _old(robot: ScriptedRobot, page: ConsolePage) -> None:
    robot.silent = True
    expect(page.page.locator(".old")).to_be_visible()


STATES = (
    State("login", account=""),
    State("idle", lambda robot, page: _say(robot)),
    State("goal", _goal),
    State("review", _review),
    State("looked_at", _looked_at),
    State("playing", _playing),
    State("paused", _paused),
    State("held", _held),
    State("stopped", _stopped),
    State("asks", _asks),
    State("motion", lambda robot, page: page.tab("motion")),
    State("messages", lambda robot, page: page.tab("messages")),
    State("old", _old),
    State("viewer", _review, account="vic"),
)


def _home(robot: ScriptedRobot) -> None:
    robot.silent = False
    robot.state = "IDLE"
    robot.twin = np.array(robot.robot.home, dtype=float)
    robot.arm_error[:] = 0.0
    robot.link = LinkReport("ARMED", "", "ARMED", {"late_replies": "0"}, gateway_kind="rsi")
    robot.take_plan_away()
    robot.publish("work/tasks", b"", retain=True)
    _say(robot)


def _photograph(browser: Browser, site: ConsoleSite, robot: ScriptedRobot, folder: Path, states: list[State]) -> None:
    for size in SIZES:
        for theme in THEMES:
            for language in LANGUAGES:
                for account in dict.fromkeys(state.account for state in states):
                    # the state before left the robot as it was, silent perhaps
                    _home(robot)
                    page = ConsolePage(browser, site.url, size=size, picture=True)
                    try:
                        page.open(f"?language={language}&theme={theme}")
                        if account:
                            page.login(account, site.password(account))
                            page.wait_drawn(robot.name)
                        for state in (each for each in states if each.account == account):
                            _home(robot)
                            if account:
                                page.tab("verdict")
                            state.prepare(robot, page)
                            # what was said last is on the screen: the next view, and the next status line
                            page.page.wait_for_timeout(900)
                            name = f"{state.name}_{size[0]}x{size[1]}_{theme}_{language}.png"
                            page.page.screenshot(path=folder / name)
                        print(f"{size[0]}x{size[1]} {theme} {language} {account or 'nobody'}", flush=True)
                    finally:
                        page.close()


def _contact_sheet(browser: Browser, folder: Path, states: list[State]) -> Path:
    """Write the sheet, and return its file: a row per state, a column per size, theme and language."""
    columns = [(size, theme, language) for size in SIZES for theme in THEMES for language in LANGUAGES]
    cells = []
    for state in states:
        images = [
            f'<td><img width="{THUMBNAIL}" src="{state.name}_{width}x{height}_{theme}_{language}.png"></td>'
            for (width, height), theme, language in columns
        ]
        cells.append(f"<tr><th>{state.name}</th>{''.join(images)}</tr>")
    style = "body{font:14px sans-serif;background:#ccc}td,th{vertical-align:top;padding:4px}"
    sheet = folder / "contact_sheet.html"
    sheet.write_text(f"<!doctype html><meta charset=utf-8><style>{style}</style><table>{''.join(cells)}</table>")
    page = browser.new_page(viewport={"width": len(columns) * (THUMBNAIL + 8) + 120, "height": 900})
    page.goto(sheet.as_uri())
    page.screenshot(path=folder / "contact_sheet.png", full_page=True)
    page.close()
    return folder / "contact_sheet.png"


def main() -> int:
    """Take the pictures; return the exit code."""
    parser = argparse.ArgumentParser(description="Photograph every state of the console.")
    parser.add_argument("states", nargs="*", metavar="STATE", help=f"only these: {', '.join(s.name for s in STATES)}")
    parser.add_argument("--output", type=Path, default=ROOT / "results/console_states")
    arguments = parser.parse_args()
    if unknown := set(arguments.states) - {state.name for state in STATES}:
        parser.error(f"no such state: {', '.join(sorted(unknown))}")
    states = [state for state in STATES if not arguments.states or state.name in arguments.states]
    shutil.rmtree(arguments.output, ignore_errors=True)
    arguments.output.mkdir(parents=True)
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = launch(playwright)
        site = ConsoleSite(Path(folder)).start()
        try:
            with site.robot() as robot:
                _messages(robot)
                _photograph(browser, site, robot, arguments.output, states)
            print(_contact_sheet(browser, arguments.output, states))
        finally:
            site.stop()
            browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
