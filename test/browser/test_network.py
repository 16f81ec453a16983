"""The network is cut for 30 s: browser and console are on two machines (network namespaces), and no packet tells of the cut."""

from __future__ import annotations

import ctypes
import os
import secrets
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from console_page import CHROMIUM, ConsolePage, launch
from console_site import ConsoleSite
from playwright.sync_api import expect
from processes import wait_until

#: How long the network is cut [s].
CUT = 30.0
#: Nobody has this address: what is sent there is lost, and nobody is told.
_NOWHERE = "02:00:00:00:00:99"
#: Addresses of the two ends: the ROS PC and the cell PC. Nobody but the two namespaces sees them.
ROS_PC, CELL_PC = "10.197.0.1", "10.197.0.2"
_CLONE_NEWNET = 0x40000000


class Namespaces:
    """Two namespaces, `ros` and `cell`, joined by a veth pair; gone when the ``with`` block ends. Needs root."""

    def __init__(self):
        name = secrets.token_hex(3)
        self.ros, self.cell = f"ctr{name}", f"ctc{name}"

    def __enter__(self) -> Namespaces:
        for space in (self.ros, self.cell):
            run("ip", "netns", "add", space)
            self.inside(space, "ip", "link", "set", "lo", "up")
        self.inside(self.ros, "ip", "link", "add", "line", "type", "veth", "peer", "name", "line", "netns", self.cell)
        for space, address in ((self.ros, ROS_PC), (self.cell, CELL_PC)):
            self.inside(space, "ip", "address", "add", f"{address}/24", "dev", "line")
            # no address of its own that comes seconds later: a browser gives up what it was loading then
            self.inside(space, "ip", "link", "set", "line", "addrgenmode", "none")
            self.inside(space, "ip", "link", "set", "line", "up")
        return self

    def __exit__(self, *_) -> None:
        for space in (self.ros, self.cell):
            subprocess.run(["ip", "netns", "delete", space], capture_output=True)

    @contextmanager
    def entered(self):
        """Let this thread, and what it starts, live on the ROS PC."""
        setns = ctypes.CDLL(None, use_errno=True).setns
        with open("/proc/thread-self/ns/net") as before, open(f"/run/netns/{self.ros}") as inside:
            if setns(inside.fileno(), _CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")
            try:
                yield
            finally:
                setns(before.fileno(), _CLONE_NEWNET)

    @staticmethod
    def prefix(space: str) -> tuple[str, ...]:
        """Return the words that run a program inside."""
        return ("ip", "netns", "exec", space)

    def inside(self, space: str, *command: str) -> None:
        run(*self.prefix(space), *command)


def run(*command: str) -> None:
    """Run a program; CalledProcessError, with what it said, when it fails."""
    subprocess.run(command, check=True, capture_output=True, text=True)


def why_no_namespaces() -> str:
    """Return why namespaces cannot be made here; "" when they can."""
    if os.name != "posix" or os.geteuid() != 0:
        return "network namespaces need root"
    try:
        with Namespaces():
            return ""
    except FileNotFoundError as error:
        return f"{error.filename} is not installed"
    except subprocess.CalledProcessError as error:
        return f"`{' '.join(error.cmd)}`: {(error.stderr or '').strip() or error}"


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
