"""Takes the console's pictures of docs/images again, and a short recording: part of `make screenshots`; `ARGS=console` alone.

The real bringup with the mock arm and `console:=true`, the page in chromium: a goal is set and its plan asked for, looked at from a
tablet and a phone, played, approved by a press of a second, and the arm moves. The recording is what chromium draws for its screen;
ImageMagick puts it together.
"""

from __future__ import annotations

import base64
import math
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test/support"))

from console_page import ConsolePage, launch  # noqa: E402
from playwright.sync_api import Browser, expect, sync_playwright  # noqa: E402
from processes import listens, wait_until  # noqa: E402
from screenshots import IMAGES, READY, free_port, keep, system  # noqa: E402

ROBOT = "kr120"
TABLET, PHONE, RECORDED = (1280, 800), (390, 844), (1000, 700)
#: The goal of the pictures, by joint [deg]: what a person types beside the sliders.
GOAL = {"joint_a1": "-40", "joint_a2": "-70", "joint_a3": "75", "joint_a5": "45"}
GOAL_A1 = math.radians(float(GOAL["joint_a1"]))
#: Fraction of the limits that is asked for: slow enough to be watched.
SPEED = "0.25"
#: Of the recording: least time between two pictures [s], width [px] and number of colours that are kept; most bytes of a file.
STEP, WIDTH, COLOURS = 0.2, 600, 48
WEIGHT, WEIGHT_OF_RECORDING = 200_000, 1_500_000


def write(command: list[str], name: str, most: int) -> None:
    """Have ImageMagick write a file of docs/images; AssertionError when it is too heavy."""
    target = IMAGES / name
    subprocess.run([*command, f"PNG8:{target}" if target.suffix == ".png" else str(target)], check=True)
    size = target.stat().st_size
    assert size <= most, f"{target} has {size} bytes, at most {most} are wanted; it is kept as {keep(target)}"
    print(f"{target.relative_to(ROOT)}: {size // 1000} kB", flush=True)


def shoot(page: ConsolePage, folder: Path, name: str) -> None:
    """Take one picture, with a palette."""
    raw = folder / name
    page.wait_frame()
    page.page.screenshot(path=raw)
    write(["convert", str(raw), "-strip", "-dither", "None", "-colors", "255"], name, WEIGHT)


def open_page(browser: Browser, url: str, **more) -> ConsolePage:
    """Return a page in which the arm is drawn."""
    page = ConsolePage(browser, url, picture=True, **more).open()
    page.wait_drawn(ROBOT, "it.twin.joints !== null && it.arm.joints !== null", 1000 * READY)
    return page


def ask_for_plan(page: ConsolePage, folder: Path) -> None:
    """Set the goal, take a picture of that, and ask for the plan."""
    plan = page.tab("plan")
    plan.locator(".plan-begin").click(timeout=1000 * READY)
    for joint, value in GOAL.items():
        field = plan.locator(".plan-joint", has_text=joint).locator("input[type=text]")
        field.fill(value)
        field.press("Enter")
    page.wait_drawn(ROBOT, f"it.goal.joints !== null && Math.abs(it.goal.joints.joint_a1 - {GOAL_A1}) < 1e-3")
    shoot(page, folder, "console_goal.png")
    plan.get_by_label("Speed").select_option(SPEED)
    plan.locator(".plan-ask").click()
    expect(plan.locator(".plan-answer")).to_contain_text("There is a plan", timeout=1000 * READY)


@dataclass(frozen=True)
class Frame:
    """A picture of the recording, and when it was drawn [s]."""

    file: Path
    at: float


class Recording:
    """Keeps what chromium draws of a page."""

    def __init__(self, page: ConsolePage, folder: Path):
        self._frames: list[Frame] = []
        self._page, self._folder = page.page, folder
        self._session = page.context.new_cdp_session(page.page)
        self._session.on("Page.screencastFrame", self._on_frame)
        self._session.send("Page.startScreencast", {"format": "png"})

    def _on_frame(self, event: dict) -> None:
        at = event["metadata"]["timestamp"]
        if not self._frames or at - self._frames[-1].at >= STEP:
            file = self._folder / f"frame{len(self._frames):04d}.png"
            file.write_bytes(base64.b64decode(event["data"]))
            self._frames.append(Frame(file, at))
        self._session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Record until a condition is true."""

        def come_true() -> bool:
            # playwright hands pictures over only while it is asked for something
            self._page.wait_for_timeout(1000 * STEP)
            return condition()

        wait_until(come_true, READY, what)

    def write(self, name: str) -> None:
        """End, and write an animation that is as fast as what happened; its last picture stays for two seconds."""
        self._session.send("Page.stopScreencast")
        times = [frame.at for frame in self._frames]
        shown = [after - before for before, after in zip(times, times[1:])] + [2.0]
        pieces = [
            word
            for each, time in zip(self._frames, shown)
            for word in ("-delay", str(round(100 * time)), str(each.file))
        ]
        command = ["convert", "-loop", "0", *pieces, "-resize", f"{WIDTH}x", "-dither", "None", "-colors", str(COLOURS)]
        write([*command, "-layers", "Optimize"], name, WEIGHT_OF_RECORDING)
        print(f"{len(times)} pictures in {times[-1] - times[0]:.0f} s", flush=True)


def record(page: ConsolePage, folder: Path) -> None:
    """Record how a plan is played, approved and carried out."""
    status = page.page.locator("#status")
    # a broker without accounts knows nobody's name
    page.page.locator(".verdict-name input").fill("ada")
    recording = Recording(page, folder)
    page.page.locator(".playback-play").click()
    recording.until(page.approve_button.is_enabled, "the plan played to its end")
    # again where this machine was too busy for a press of a second
    for _ in range(10):
        page.press_approve()
        recording.until(lambda: page.notice.is_visible() and "Sending" not in page.notice.inner_text(), "the approval")
        page.page.mouse.up()
        if not page.is_disturbed():
            break
    expect(page.notice).to_contain_text("accepted")
    recording.until(lambda: "moves" in status.inner_text() or "playing" in status.inner_text(), "the motion")
    recording.until(
        lambda: abs(page.drawn(ROBOT)["arm"]["joints"]["joint_a1"] - GOAL_A1) < 0.003, "the end of the motion"
    )
    recording.write("console.gif")


def main() -> int:
    """Take all of them; return the exit code."""
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder, port = Path(name), free_port(socket.SOCK_STREAM)
        shipped = (ROOT / "config/console.yaml").read_text()
        (folder / "console.yaml").write_text(shipped.replace("port: 8480", f"port: {port}"))
        start = ("bringup.launch", f"console:={folder / 'console.yaml'}")
        with system(start, folder):
            browser = launch(playwright)
            try:
                wait_until(lambda: listens(port), READY, "the console listening")
                url = f"http://127.0.0.1:{port}/"
                page = open_page(browser, url, size=TABLET, color_scheme="light")
                ask_for_plan(page, folder)
                page.wait_drawn(ROBOT, "it.path !== null")
                shoot(page, folder, "console.png")
                page.close()
                for file, size, scheme in (("console_dark.png", TABLET, "dark"), ("console_phone.png", PHONE, "light")):
                    page = open_page(browser, url, size=size, color_scheme=scheme, has_touch=size == PHONE)
                    page.wait_drawn(ROBOT, "it.path !== null")
                    shoot(page, folder, file)
                    page.close()
                page = open_page(browser, url, size=RECORDED, color_scheme="light")
                page.wait_drawn(ROBOT, "it.path !== null")
                record(page, folder)
                assert not page.errors, page.errors
            except AssertionError as error:
                log = (folder / "launch.log").read_text()
                print(f"{log[-4000:]}\nconsole_pictures: {error}", file=sys.stderr)
                return 1
            finally:
                browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
