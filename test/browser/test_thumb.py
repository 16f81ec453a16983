"""A person with a thumb and a phone: from the login to an approved plan by touch alone, and what a touch must not do."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from console_page import ConsolePage
from console_site import PERSON
from playwright.sync_api import Locator, Page, expect
from processes import wait_until

UPRIGHT, SIDEWAYS = (390, 844), (844, 390)
PATIENCE_S = 60.0
#: A person's time from the login to an approved plan, without the plan's own playing time [s].
LONGEST = 15.0

#: A gloved thumb goes to a place and touches it [s].
REACH = 0.8
#: The page's rule for what is held [s].
HOLD = 1.0
#: Least side of a target [px], and of stop, pause and approve.
LEAST, LARGE = 44, 64
#: Resolves once an element has stood still for some frames.
_AT_REST = """(it) => new Promise((resolve) => {
  let [last, still] = [NaN, 0];
  const look = () => {
    const {top} = it.getBoundingClientRect();
    still = top === last ? still + 1 : 0;
    last = top;
    if (still > 5) resolve();
    else requestAnimationFrame(look);
  };
  look();
})"""


@dataclass(frozen=True, slots=True)
class Touch:
    """One touch.

    Attributes:
        what: Of what, in words.
        seconds: What a person needs for it.
    """

    what: str
    seconds: float


@dataclass
class Thumb:
    """One finger on one page.

    Attributes:
        touches: What it did so far.
    """

    page: Page
    touches: list[Touch] = field(default_factory=list)

    def __post_init__(self):
        self._input = self.page.context.new_cdp_session(self.page)

    @property
    def seconds(self) -> float:
        """What a person needs for all of it [s]."""
        return sum(touch.seconds for touch in self.touches)

    def tap(self, target: Locator, what: str, least: int = LEAST) -> None:
        """Tap a target once it can be used."""
        expect(target).to_be_enabled()
        self.page.touchscreen.tap(*self.place(target, what, least))
        self.touches.append(Touch(what, REACH))

    def down(self, target: Locator, what: str, least: int = LEAST) -> tuple[float, float]:
        """Put the finger on a target once it can be used, leave it there, and return where."""
        expect(target).to_be_enabled()
        place = self.place(target, what, least)
        self._send("touchStart", place)
        self.touches.append(Touch(what, REACH))
        return place

    def hold(self, target: Locator, what: str, until: Locator, least: int = LARGE) -> None:
        """Hold a target until the page says what became of it."""
        self.down(target, what, least)
        expect(until).to_be_visible()
        self.up()
        self.touches[-1] = Touch(what, REACH + HOLD)

    def slide(self, begin: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        """Move the finger that is down."""
        for k in range(1, steps + 1):
            self._send("touchMove", tuple(a + (b - a) * k / steps for a, b in zip(begin, end)))

    def up(self, **more: float) -> None:
        self._input.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": [], **more})

    def swipe(self, target: Locator, way: float) -> None:
        """Scroll by `way` pixels up, as a thumb does that begins on a target and rests before it is lifted."""
        x, y = self.place(target, "a swipe", 0)
        steps, begin = 10, time.time() - 1.0
        self._send("touchStart", (x, y), timestamp=begin)
        for k in range(1, steps + 1):
            self._send("touchMove", (x, y - way * k / steps), timestamp=begin + 0.02 * k)
        self.up(timestamp=begin + 0.9)
        target.evaluate(_AT_REST)
        self.touches.append(Touch("a swipe", REACH))

    def place(self, target: Locator, what: str, least: int) -> tuple[float, float]:
        """Return the middle of a target, which must be large enough, in view, and under nothing else."""
        expect(target).to_be_in_viewport(ratio=0.99)
        box = target.bounding_box()
        assert box is not None, what
        assert min(box["width"], box["height"]) >= least, f"{what}: {box}, and not {least} px"
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        hit = "(it, [x, y]) => { const at = document.elementFromPoint(x, y); return it === at || it.contains(at); }"
        assert target.evaluate(hit, [x, y]), f"{what} is covered at {x}, {y}"
        return x, y

    def _send(self, kind: str, place: tuple[float, ...], **more: float) -> None:
        x, y = place
        self._input.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}], **more})


@pytest.fixture
def phone_of(page_of, site, robot) -> Callable[..., ConsolePage]:
    """Returns a phone on which `PERSON` has logged in, in a size and language, and is logged in."""

    def open_phone(size: tuple[int, int], language: str = "en", picture: bool = True) -> ConsolePage:
        phone = page_of(query=f"?language={language}", size=size, picture=picture, has_touch=True, is_mobile=True)
        return phone.login(PERSON, site.password(PERSON))

    return open_phone


def open_checks(thumb: Thumb) -> None:
    """Bring the checks into view and open them: without a picture they are what a person looks at."""
    thumb.swipe(thumb.page.locator(".playback-play"), 100)
    thumb.tap(thumb.page.locator(".verdict-checks summary"), "checks")


@pytest.mark.parametrize(("size", "language"), ((UPRIGHT, "de"), (SIDEWAYS, "en")), ids=("upright", "sideways"))
def test_from_the_login_to_an_approved_plan_a_thumb_needs_less_than_fifteen_seconds(phone_of, robot, size, language):
    console = phone_of(size, language)
    page = console.page
    plan = robot.show_plan(duration=2.0)
    thumb = Thumb(page)
    console.wait_drawn("one")
    # what the second of "shown" and the plan's playing take is the plan's own time: it plays for longer than that
    thumb.tap(page.locator(".playback-play"), "play")
    while not robot.verdicts:
        thumb.hold(console.approve_button, "approve", console.notice)
        if not console.is_disturbed():
            break
    expect(console.notice).to_contain_text("Freigabe angenommen." if language == "de" else "Approval accepted.")
    expect(console.notice).to_be_in_viewport()
    wait_until(lambda: robot.verdicts, PATIENCE_S, "the verdict")
    assert robot.verdicts == [(PERSON, "approved", plan.id)]
    print(f"{size[0]}x{size[1]} {language}: {thumb.seconds:.1f} s, {len(thumb.touches)} touches")
    for touch in thumb.touches:
        print(f"  {touch.seconds:.1f} s {touch.what}")
    assert thumb.seconds < LONGEST


def test_a_finger_that_slides_off_approves_nothing(phone_of, robot):
    console = phone_of(UPRIGHT, picture=False)
    thumb = Thumb(console.page)
    robot.show_plan()
    open_checks(thumb)
    x, y = thumb.down(console.approve_button, "approve", LARGE)
    expect(console.approve_button).to_have_class("hold verdict-approve is-pressing")
    # to the sentence at the top, with the finger still down
    thumb.slide((x, y), (x, 120))
    expect(console.notice).to_contain_text("released before the second was over")
    expect(console.notice).to_be_in_viewport()
    # nor when it comes back
    thumb.slide((x, 120), (x, y))
    expect(console.approve_button).to_have_class("hold verdict-approve")
    thumb.up()
    assert not robot.payloads("review") and robot.plan is not None


def test_a_thumb_that_scrolls_presses_nothing(page_of, site, robot):
    console = page_of(size=UPRIGHT, has_touch=True, is_mobile=True)
    console.login("dora", site.password("dora"))
    page, thumb = console.page, Thumb(console.page)
    robot.show_plan()
    panel = page.locator("#verdict")
    expect(panel.locator(".verdict")).to_be_visible()

    def swipe_over(name: str) -> None:
        """Bring what has a name to the middle of what can be seen of the panel, and scroll with the thumb on it."""
        target = panel.locator(name).first
        # half of what stands above the approve button, which covers the rest
        panel.evaluate(
            """(it, name) => {
              const above = it.querySelector(".verdict-act").offsetHeight;
              const top = it.querySelector(name).getBoundingClientRect().top - it.getBoundingClientRect().top;
              it.scrollTop += top - (it.clientHeight - above) / 3;
            }""",
            name,
        )
        before, most = panel.evaluate("(it) => [it.scrollTop, it.scrollHeight - it.clientHeight]")
        thumb.swipe(target, 60 if before < most - 60 else -60)
        wait_until(lambda: panel.evaluate("(it) => it.scrollTop") != before, PATIENCE_S, f"scrolling over {name}")

    for name in (".playback-play", ".playback-slider", ".verdict-checks summary", ".speed-slider", ".speed-step"):
        swipe_over(name)
    expect(panel.locator(".playback-play")).to_have_text("Play")
    expect(panel.locator(".verdict-checks[open]")).to_have_count(0)
    expect(panel.locator(".speed-slider")).to_have_value("100")
    expect(panel.locator(".speed-result")).to_have_text("")
    assert not robot.payloads("lower_speed") and not robot.payloads("review")
    # and who means the slider is heard: a finger that goes along it
    at = panel.locator(".speed-slider").bounding_box()
    assert at is not None
    panel.locator(".speed-slider").scroll_into_view_if_needed()
    x, y = thumb.down(panel.locator(".speed-slider"), "the slider")
    thumb.slide((x, y), (x + at["width"] / 5, y))
    thumb.up()
    expect(panel.locator(".speed-result")).to_contain_text("carried out")
    assert robot.payloads("lower_speed")
