"""The console's page in Debian's chromium: what a person sees and presses, by names that a person knows."""

from __future__ import annotations

import os
import re
from pathlib import Path

from playwright.sync_api import Browser, Error, Locator, Page, Playwright, Request, expect

CHROMIUM = Path("/usr/bin/chromium")
#: Software WebGL; no sandbox where root runs it, because chromium refuses that.
ARGUMENTS = ["--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-component-update"]
# /dev/shm of a container is too small for pictures
ARGUMENTS += ["--disable-dev-shm-usage"]
#: Longest wait for what a page shall show [ms].
PATIENCE = 60_000

expect.set_options(timeout=PATIENCE)

#: Notes what goes to the graphics card: the only place where the drawn geometry can be seen from outside.
_SPY = """
(() => {
  const kept = [];
  window.uploaded = kept;
  const make = WebGL2RenderingContext.prototype.bufferData;
  WebGL2RenderingContext.prototype.bufferData = function (target, data, ...rest) {
    if (data instanceof Float32Array && data.length <= 6000) kept.push(Array.from(data));
    while (kept.length > 400) kept.shift();
    return make.call(this, target, data, ...rest);
  };
})();
"""
#: A browser without WebGL: software that draws takes the processor away from what is tested.
_BLIND = """
HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {
  apply: (make, canvas, [kind, ...rest]) => (kind.startsWith("webgl") ? null : Reflect.apply(make, canvas, [kind, ...rest])),
});
"""


def launch(playwright: Playwright, program: Path = CHROMIUM) -> Browser:
    """Return a browser without a window."""
    arguments = ARGUMENTS + (["--no-sandbox"] if os.geteuid() == 0 else [])
    return playwright.chromium.launch(executable_path=program, args=arguments)


class ConsolePage:
    """One page in a context of its own, as on a tablet of its own.

    Args:
        size: [px]
        picture: The browser has WebGL.

    Attributes:
        errors: Exceptions of the page that nothing caught, and what its policy has blocked.
    """

    def __init__(
        self, browser: Browser, url: str, size: tuple[int, int] = (1280, 800), picture: bool = False, **context
    ):
        # the site's own CA is not this machine's
        self.context = browser.new_context(
            ignore_https_errors=True, viewport={"width": size[0], "height": size[1]}, locale="en-GB", **context
        )
        self.context.add_init_script(_SPY if picture else _BLIND)
        self.page: Page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE)
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._on_line)
        self._url = url

    def _on_line(self, message) -> None:
        if message.type == "error" and "Content Security Policy" in message.text:
            self.errors.append(message.text)

    def open(self, query: str = "") -> ConsolePage:
        """Open the page with all that it consists of."""
        for repeats_left in range(3, -1, -1):
            failed: list[str] = []

            def note(request: Request, failed: list[str] = failed) -> None:
                failed.append(request.failure or "")

            self.page.on("requestfailed", note)
            try:
                self.page.goto(self._url + query, wait_until="load")
            except Error as error:
                failed.append(error.message)
                if "ERR_NETWORK_CHANGED" not in error.message or not repeats_left:
                    raise
            finally:
                self.page.remove_listener("requestfailed", note)
            # an interface of this machine got an address: chromium gives up what it was loading
            if not any("ERR_NETWORK_CHANGED" in each for each in failed):
                break
        return self

    def login(self, account: str, password: str) -> ConsolePage:
        """Log in and wait until the page is connected."""
        self.try_login(account, password)
        expect(self.page.locator(".login")).to_be_hidden()
        expect(self.page.locator(".account")).to_contain_text(account)
        return self

    def try_login(self, account: str, password: str) -> None:
        """Type an account and a password, and press the button."""
        form = self.page.locator(".login form")
        form.locator("input[name=account]").fill(account)
        form.locator("input[name=password]").fill(password)
        form.locator("button[type=submit]").click()

    def wait_for(self, function: str, argument=None, timeout: float = PATIENCE):
        """Return the first true value of a function of the page."""
        return self.page.wait_for_function(function, arg=argument, timeout=timeout).json_value()

    def drawn(self, robot: str) -> dict:
        """Return what the picture says that it draws of a robot."""
        return self.page.evaluate("(robot) => document.querySelector('canvas').inspect(robot)", robot)

    def wait_drawn(self, robot: str, condition: str = "true", timeout: float = PATIENCE) -> dict:
        """Return what is drawn of a robot, once its model is there and `condition`, a JavaScript expression of `it`, is true."""
        self.wait_for(
            f"(robot) => {{ const it = document.querySelector('canvas')?.inspect?.(robot); return it?.ready && ({condition}) }}",
            robot, timeout,
        )  # fmt: skip
        return self.drawn(robot)

    def wait_frame(self) -> None:
        """Wait until the picture has been drawn once more."""
        frames = self.page.evaluate("document.querySelector('canvas').frames")
        self.wait_for("(frames) => document.querySelector('canvas').frames > frames", frames)

    def tab(self, name: str) -> Locator:
        """Open the panel of a name (`plan`, `tasks`, ...) and return it; on a wide screen some are always open, and have no tab."""
        panel = self.page.locator(f"#{name}")
        expect(panel.or_(self.page.locator(f".tab-{name}")).filter(visible=True).first).to_be_visible()
        if self.page.locator(f".tab-{name}").is_visible():
            self.page.locator(f".tab-{name}").click()
        expect(panel).to_be_visible()
        return panel

    @property
    def lost(self) -> Locator:
        """The line that says that there is no connection."""
        return self.page.locator(".lost")

    # -- verdict, stop

    @property
    def approve_button(self) -> Locator:
        """The button that is held to approve."""
        return self.page.locator(".verdict-approve")

    @property
    def notice(self) -> Locator:
        """What became of a verdict."""
        return self.page.locator(".verdict-notice")

    def look(self) -> None:
        """Open the plan's checks, which counts as having looked, and wait until approving is possible."""
        self.tab("verdict").locator(".verdict-checks summary").click()
        expect(self.approve_button).to_be_enabled()

    def play_to_end(self) -> None:
        """Play the plan, which counts as having looked; again where the connection was lost meanwhile: then it does not count."""
        self.tab("verdict")
        for _ in range(5):
            self.page.locator(".playback-play").click()
            self.wait_for("() => (({value, max}) => value === max)(document.querySelector('.playback-slider'))")
            if self.page.locator(".verdict-steps li:first-child.is-done").is_visible():
                break
        expect(self.approve_button).to_be_enabled()

    def press_approve(self) -> None:
        """Put the finger on the button and leave it there."""
        self.press(self.approve_button)

    def press(self, button: Locator) -> None:
        """Put the finger on a button and leave it there."""
        button.scroll_into_view_if_needed()
        button.hover()
        self.page.mouse.down()

    def hold_approve(self) -> None:
        """Hold the button that approves, as `hold`."""
        self.hold(self.approve_button)

    def hold(self, button: Locator) -> None:
        """Hold a button until the page has sent the verdict; again where this machine was too busy for a press of a second."""
        for _ in range(5):
            expect(button).to_be_enabled()
            self.press(button)
            expect(self.notice.and_(self.page.locator(":not(.is-void)"))).to_be_visible()
            self.page.mouse.up()
            if not self.is_disturbed():
                return

    def is_disturbed(self) -> bool:
        """Return whether a press did not count because the machine was too busy, and not for what the person did."""
        return bool(re.search("stood still|not heard while", self.notice.inner_text()))

    def reject(self, words: str) -> None:
        self.page.locator(".verdict-rejection input").fill(words)
        self.page.locator(".verdict-reject").click()

    def intervene(self, verb: str) -> None:
        """Press stop, pause or resume of the first robot."""
        self.page.locator(f".stop-{verb}").first.click()

    @property
    def stop_result(self) -> Locator:
        """What became of a stop, pause or resume."""
        return self.page.locator(".stop-result").first

    def close(self) -> None:
        self.context.close()
