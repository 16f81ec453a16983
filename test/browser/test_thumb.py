"""A person with a thumb and a phone: from the PIN to an approved plan by touch alone, and what a touch must not do."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from console_page import ConsolePage
from console_site import PERSON
from playwright.sync_api import Page, expect
from processes import wait_until
from thumb import LARGE, Thumb

PIN = "482139"
SENTENCES = json.loads((Path(__file__).parents[2] / "src/construction_twin/core/sentences.json").read_text())
UPRIGHT, SIDEWAYS = (390, 844), (844, 390)
PATIENCE_S = 60.0
#: A person's time from the PIN to an approved plan, without the plan's own playing time [s].
LONGEST = 15.0


def words(language: str, key: str, **values: str) -> str:
    return SENTENCES[key][language].format(**values)


def type_pin(thumb: Thumb) -> None:
    pad = thumb.page.locator(".pin")
    for digit in PIN:
        thumb.tap(pad.get_by_role("button", name=digit, exact=True), f"digit {digit}")
    thumb.tap(pad.locator(".pin-ok"), "OK")


@pytest.fixture
def phone_of(page_of, site, robot) -> Callable[..., ConsolePage]:
    """Returns a phone that was paired by touch, in a size and language, and is logged in."""

    def pair(size: tuple[int, int], language: str = "en", picture: bool = True) -> ConsolePage:
        query = f"?language={language}{site.invite()}"
        console = page_of(query=query, size=size, picture=picture, has_touch=True, is_mobile=True)
        thumb = Thumb(console.page)
        type_pin(thumb)
        expect(console.page.locator(".pin")).to_contain_text(words(language, "pin.hint.again"))
        type_pin(thumb)
        expect_open(console.page)
        return console

    return pair


def expect_open(page: Page) -> None:
    expect(page.locator(".pin")).to_be_hidden()
    expect(page.locator("body.is-locked")).to_have_count(0)


def play_to_the_end(console: ConsolePage, thumb: Thumb) -> None:
    console.wait_drawn("one")
    thumb.tap(console.page.locator(".playback-play"), "play")
    expect(console.approve_button).to_be_enabled()


@pytest.mark.parametrize("language", ("en", "de"))
@pytest.mark.parametrize("size", (UPRIGHT, SIDEWAYS), ids=("upright", "sideways"))
def test_from_the_pin_to_an_approved_plan_a_thumb_needs_less_than_fifteen_seconds(phone_of, robot, size, language):
    console = phone_of(size, language)
    page = console.page
    plan = robot.show_plan(duration=2.0)
    page.reload()
    expect(page.locator(".pin")).to_contain_text(words(language, "pin.title", account=PERSON))
    thumb = Thumb(page)
    type_pin(thumb)
    expect_open(page)
    # what the second of "shown" and the plan's playing take is the plan's own time: it plays for longer than that
    play_to_the_end(console, thumb)
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
    console = phone_of(UPRIGHT)
    thumb = Thumb(console.page)
    robot.show_plan()
    play_to_the_end(console, thumb)
    x, y = thumb.down(console.approve_button, "approve", LARGE)
    expect(console.approve_button).to_have_class("verdict-approve is-pressing")
    # to the sentence at the top, with the finger still down
    thumb.slide((x, y), (x, 120))
    expect(console.notice).to_contain_text("released before the second was over")
    # nor when it comes back
    thumb.slide((x, 120), (x, y))
    expect(console.approve_button).to_have_class("verdict-approve")
    thumb.up()
    assert not robot.payloads("review") and robot.plan is not None


def test_a_hold_of_less_than_a_second_approves_nothing(phone_of, robot):
    console = phone_of(UPRIGHT)
    page, thumb = console.page, Thumb(console.page)
    robot.show_plan()
    play_to_the_end(console, thumb)
    page.evaluate(
        """() => {
          window.presses = [];
          addEventListener("pointerdown", () => window.presses.push({down: performance.now()}), true);
          addEventListener("pointerup", () => { window.presses.at(-1).up = performance.now(); }, true);
        }"""
    )
    place = thumb.down(console.approve_button, "approve", LARGE)
    thumb.up()
    press = page.evaluate("window.presses.at(-1)")
    # on a machine that was busy meanwhile it was a hold, which says nothing here
    if press["up"] - press["down"] >= 1000.0:
        pytest.skip(f"the touch at {place} took {press['up'] - press['down']:.0f} ms")
    expect(console.notice).to_contain_text("released before the second was over")
    assert not robot.payloads("review") and robot.plan is not None


def test_a_thumb_that_scrolls_presses_nothing(page_of, site, robot):
    console = page_of(size=UPRIGHT, has_touch=True, is_mobile=True)
    console.login("dora", site.password("dora"))
    page, thumb = console.page, Thumb(console.page)
    robot.show_plan()
    panel = page.locator("#verdict")
    expect(panel.locator(".verdict")).to_be_visible()
    for name in (".playback-play", ".verdict-checks summary"):
        # in the middle of what is left above the approve button
        panel.evaluate(
            """(it, name) => {
              it.scrollTop = 0;
              const height = it.clientHeight - it.querySelector(".verdict-act").offsetHeight;
              it.scrollTop = it.querySelector(name).getBoundingClientRect().top - it.getBoundingClientRect().top - height / 3;
            }""",
            name,
        )
        before = panel.evaluate("(it) => it.scrollTop")
        thumb.swipe(panel.locator(name).first, 60)
        wait_until(lambda: panel.evaluate("(it) => it.scrollTop") > before, PATIENCE_S, f"scrolling over {name}")  # noqa: B023
    assert page.locator(".verdict-checks").get_attribute("open") is None
    expect(page.locator(".playback-play")).to_have_text("Play")
    assert not robot.payloads("review")
