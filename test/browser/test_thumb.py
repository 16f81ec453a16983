"""A person with a thumb and a phone: from the login to an approved plan by touch alone, and what a touch must not do."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from console_page import ConsolePage
from console_site import PERSON
from playwright.sync_api import expect
from processes import wait_until
from thumb import LARGE, Thumb

SENTENCES = json.loads((Path(__file__).parents[2] / "src/construction_twin/core/sentences.json").read_text())
UPRIGHT, SIDEWAYS = (390, 844), (844, 390)
PATIENCE_S = 60.0
#: A person's time from the login to an approved plan, without the plan's own playing time [s].
LONGEST = 15.0


def words(language: str, key: str, **values: str) -> str:
    return SENTENCES[key][language].format(**values)


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
    expect(console.notice).to_contain_text(
        words(language, "verdict.accepted", verdict=words(language, "verdict.word.approved"), reason="").strip()
    )
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
    expect(console.approve_button).to_have_class("verdict-approve is-pressing")
    # to the sentence at the top, with the finger still down
    thumb.slide((x, y), (x, 120))
    expect(console.notice).to_contain_text("released before the second was over")
    expect(console.notice).to_be_in_viewport()
    # nor when it comes back
    thumb.slide((x, 120), (x, y))
    expect(console.approve_button).to_have_class("verdict-approve")
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
    assert not robot.payloads("speed") and not robot.payloads("review")
    # and who means the slider is heard: a finger that goes along it
    at = panel.locator(".speed-slider").bounding_box()
    assert at is not None
    panel.locator(".speed-slider").scroll_into_view_if_needed()
    x, y = thumb.down(panel.locator(".speed-slider"), "the slider")
    thumb.slide((x, y), (x + at["width"] / 5, y))
    thumb.up()
    expect(panel.locator(".speed-result")).to_contain_text("done")
    assert robot.payloads("speed")
