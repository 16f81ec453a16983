"""The network is cut for 30 s: browser and console are on two machines (network namespaces), and no packet tells of the cut."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from console_page import CHROMIUM, ConsolePage, launch
from console_site import ConsoleSite
from namespaces import CELL_PC, ROS_PC, Namespaces, why_no_namespaces
from playwright.sync_api import expect
from processes import wait_until

#: How long the network is cut [s].
CUT = 30.0
#: Nobody has this address: what is sent there is lost, and nobody is told.
_NOWHERE = "02:00:00:00:00:99"


@pytest.fixture
def spaces() -> Iterator[Namespaces]:
    if why := why_no_namespaces():
        pytest.skip(why)
    with Namespaces() as made:
        yield made


def cut(spaces: Namespaces) -> None:
    for space, other in ((spaces.ros, CELL_PC), (spaces.cell, ROS_PC)):
        spaces.inside(space, "ip", "neigh", "replace", other, "lladdr", _NOWHERE, "dev", "line", "nud", "permanent")


def mend(spaces: Namespaces) -> None:
    for space, other in ((spaces.ros, CELL_PC), (spaces.cell, ROS_PC)):
        spaces.inside(space, "ip", "neigh", "delete", other, "dev", "line")


def test_a_network_that_is_cut_for_half_a_minute_is_told_at_once_and_nothing_is_sent_later(
    tmp_path, playwright, spaces
):
    program = tmp_path / "chromium"
    program.write_text(f'#!/bin/sh\nexec {" ".join(Namespaces.prefix(spaces.cell))} {CHROMIUM} "$@"\n')
    program.chmod(0o755)
    with spaces.entered():
        site = ConsoleSite(tmp_path, listen=ROS_PC, hosts=(ROS_PC,), host=ROS_PC).start()
        robot = site.robot().start()
    browser = launch(playwright, program)
    try:
        page = ConsolePage(browser, site.url).open()
        page.login("ada", site.password("ada"))
        robot.show_plan()
        page.look()
        page.press_approve()
        cut(spaces)
        since = time.monotonic()
        expect(page.lost).to_contain_text("NOT CONNECTED")
        page.page.mouse.up()
        page.intervene("stop")
        expect(page.stop_result).to_contain_text("did NOT go out")
        assert page.page.locator(".verdict-approve:enabled").count() == 0
        heard = len(robot.heard)
        wait_until(lambda: time.monotonic() - since > CUT, CUT + 30.0, "the end of the cut")
        mend(spaces)
        expect(page.lost).to_be_hidden(timeout=60_000)
        expect(page.page.locator(".verdict")).to_be_visible()
        # what was looked at before the cut does not count
        expect(page.approve_button).to_be_disabled()
        assert len(robot.heard) == heard and not robot.verdicts
        page.look()
        page.hold_approve()
        expect(page.notice).to_contain_text("accepted")
        assert len(robot.verdicts) == 1
        assert not page.errors
    finally:
        browser.close()
        robot.stop()
        site.stop()
