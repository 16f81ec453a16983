"""A thumb on a page, for tests: real touches by the browser's own input, on what a person sees, and the time that they take.

A thumb in a glove needs `REACH` to find and touch a place; a hold takes as long as the page wants it to. How fast this machine is
stands in neither.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from playwright.sync_api import Locator, Page, expect

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
