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


def may_scroll(page: Page) -> int:
    return page.locator("#verdict").evaluate("(it) => it.scrollHeight - it.clientHeight")


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
    console.wait_drawn("one")
    # what the second of "shown" and the plan's playing take is the plan's own time: it plays for longer than that
    thumb.tap(page.locator(".playback-play"), "play")
    while not robot.verdicts:
        thumb.hold(console.approve_button, "approve", console.notice)
        if not console.is_disturbed():
            break
    expect(console.notice).to_contain_text(words(language, "verdict.accepted", verdict=words(language, "verdict.word.approved"), reason="").strip())
    expect(console.notice).to_be_in_viewport()
    wait_until(lambda: robot.verdicts, PATIENCE_S, "the verdict")
    assert robot.verdicts == [(PERSON, "approved", plan.id)]
    print(f"{size[0]}x{size[1]} {language}: {thumb.seconds:.1f} s, {len(thumb.touches)} touches")
    for touch in thumb.touches:
        print(f"  {touch.seconds:.1f} s {touch.what}")
    assert thumb.seconds < LONGEST
