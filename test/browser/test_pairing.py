"""A paired tablet: from the code to logged in, the PIN after a reload and after a minute out of sight, and Stop all the while."""

from __future__ import annotations

import re

import pytest
from console_page import ConsolePage
from console_site import PERSON
from playwright.sync_api import Locator, Page, expect

PIN, WRONG = "482139", "482138"
#: A phone, and a finger.
PHONE = {"size": (390, 844), "has_touch": True, "is_mobile": True}


class Tablet:
    """A page with a finger on it."""

    def __init__(self, page: ConsolePage):
        self.console, self.page = page, page.page

    @property
    def pad(self) -> Locator:
        return self.page.locator(".pin")

    @property
    def told(self) -> Locator:
        return self.page.locator(".pin-told")

    def type(self, pin: str) -> None:
        """Tap digits and OK."""
        for digit in pin:
            self.pad.get_by_role("button", name=digit, exact=True).tap()
        self.pad.locator(".pin-ok").tap()

    def stops(self) -> None:
        """Tap Stop, and see it carried out."""
        self.page.locator(".stop-stop").first.tap()
        expect(self.console.stop_result).to_contain_text("Stop: carried out")


def expect_locked(tablet: Tablet) -> None:
    expect(tablet.pad).to_be_visible()
    expect(tablet.page.locator(".account")).to_contain_text(f"{PERSON}-device")
    expect(tablet.page.locator("#verdict")).to_be_hidden()
    expect(tablet.console.lost).to_be_hidden()


def expect_open(tablet: Tablet) -> None:
    expect(tablet.page.locator(".account")).to_have_text(re.compile(rf"\b{PERSON}$"))
    expect(tablet.pad).to_be_hidden()
    expect(tablet.page.locator("body.is-locked")).to_have_count(0)


@pytest.fixture
def paired(page_of, site, robot) -> Tablet:
    """A phone that was paired and logged in by touch."""
    tablet = Tablet(page_of(query=site.invite(), **PHONE))
    # the token is in no address that somebody sees or that is kept
    assert tablet.page.url == site.url
    expect(tablet.pad).to_be_visible()
    tablet.type(PIN)
    expect(tablet.pad).to_contain_text("once more")
    tablet.type(PIN)
    expect_open(tablet)
    return tablet


def reload(tablet: Tablet) -> None:
    tablet.page.reload()
    expect_locked(tablet)


def hide(page: Page, hidden: bool) -> None:
    """As when another app comes to the front, or the screen goes off."""
    page.evaluate(
        """(hidden) => {
          Object.defineProperty(document, "visibilityState", {configurable: true, get: () => (hidden ? "hidden" : "visible")});
          document.dispatchEvent(new Event("visibilitychange"));
        }""",
        hidden,
    )


def test_a_tablet_is_paired_by_touch_and_asks_for_the_pin_after_a_reload_while_stop_works(paired, site, robot):
    said = site.log.read_text()
    assert f"logged in as '{PERSON}'" in said and PIN not in said
    robot.show_plan()
    expect(paired.page.locator("#verdict")).to_be_visible()
    reload(paired)
    paired.stops()
    assert [topic for topic, _ in robot.heard if topic.startswith("stop/")] == [f"stop/{PERSON}-device"]
    paired.type(PIN)
    expect_open(paired)
    expect(paired.page.locator("#verdict")).to_be_visible()
    # what a script of the page could read is not there
    assert "console_device" not in paired.page.evaluate("document.cookie + JSON.stringify(localStorage)")


def test_the_pad_is_for_gloves_and_stands_over_neither_stop_nor_picture(paired):
    reload(paired)
    for key in paired.pad.locator("button:visible").all():
        box = key.bounding_box()
        assert box is not None and box["height"] >= 64 and box["width"] >= 64, box
    for other in ("#stop", "#picture"):
        overlap = paired.page.evaluate(
            """(other) => {
              const [pad, rest] = [".pin", other].map((name) => document.querySelector(name).getBoundingClientRect());
              return document.querySelector(".pin").contains(document.elementFromPoint(
                rest.x + rest.width / 2, Math.min(rest.y + rest.height / 2, innerHeight - 1)));
            }""",
            other,
        )
        assert overlap is False, other
    stop = paired.page.locator(".stop-stop").first
    stop.tap(trial=True)
    # what is asked is there without scrolling
    expect(paired.pad.locator("h2")).to_be_in_viewport()
    expect(paired.pad.locator(".pin-ok")).to_be_in_viewport()


def test_a_minute_out_of_sight_asks_for_the_pin_and_less_does_not(page_of, site, robot):
    tablet = Tablet(page_of(**PHONE))
    tablet.page.clock.install()
    tablet.page.goto("about:blank")
    tablet.page.goto(site.url + site.invite())
    tablet.type(PIN)
    tablet.type(PIN)
    expect_open(tablet)
    hide(tablet.page, True)
    tablet.page.clock.fast_forward(59_000)
    hide(tablet.page, False)
    expect_open(tablet)
    hide(tablet.page, True)
    tablet.page.clock.fast_forward(61_000)
    hide(tablet.page, False)
    expect_locked(tablet)
    tablet.stops()
    tablet.type(PIN)
    expect_open(tablet)


def test_a_wrong_pin_is_told_with_what_is_left_and_after_five_the_device_sees_and_stops(paired, site, robot):
    reload(paired)
    for left in (4, 3, 2, 1):
        paired.type(WRONG)
        expect(paired.told).to_contain_text(f"Tries left: {left}")
        # told while it is locked and connected, as before
        expect_locked(paired)
    paired.type("48213")
    expect(paired.told).to_contain_text("did not count")
    paired.type(WRONG)
    expect(paired.told).to_contain_text("Tries left: 0")
    expect(paired.pad.locator(".pin-pad")).to_be_hidden()
    paired.stops()
    # the password is the other way
    paired.pad.get_by_role("button", name="Log in with a password").tap()
    form = paired.page.locator(".pin-form form")
    form.locator("input[name=account]").fill(PERSON)
    form.locator("input[name=password]").fill("guess")
    form.locator("button[type=submit]").tap()
    expect(form.locator(".wrong")).to_contain_text("refuses this account or its password")
    paired.stops()
    form.locator("input[name=password]").fill(site.password(PERSON))
    form.locator("button[type=submit]").tap()
    expect_open(paired)
    reload(paired)


def test_who_leaves_is_asked_for_the_pin(paired):
    paired.page.locator(".menu > summary").tap()
    paired.page.get_by_role("button", name="Log out").tap()
    expect_locked(paired)
    paired.type(PIN)
    expect_open(paired)


def test_a_code_works_once_and_a_pin_that_is_guessed_first_is_refused(page_of, site, robot):
    code = site.invite()
    tablet = Tablet(page_of(query=code, **PHONE))
    tablet.type("123456")
    expect(tablet.told).to_contain_text("a row of digits")
    tablet.type(PIN)
    tablet.type(WRONG)
    expect(tablet.told).to_contain_text("not the same")
    tablet.type(PIN)
    tablet.type(PIN)
    expect_open(tablet)
    other = Tablet(page_of(query=code, **PHONE))
    other.type(PIN)
    other.type(PIN)
    note = other.page.locator(".login .note")
    expect(note).to_contain_text("used already")
    expect(other.page.locator(".login input[name=account]")).to_be_visible()


def test_a_device_that_is_revoked_is_out_within_seconds_and_says_so(paired, site):
    site.pairings.revoke(PERSON)
    expect(paired.page.locator(".login .note")).to_contain_text("not paired any more")
    paired.page.reload()
    expect(paired.page.locator(".login input[name=account]")).to_be_visible()
    expect(paired.pad).to_be_hidden()


def test_a_console_that_is_restarted_knows_its_devices(paired, site):
    site.stop_console()
    expect(paired.console.lost).to_contain_text("NOT CONNECTED")
    site.start_console()
    # who had given the PIN need not do so again for that
    expect(paired.console.lost).to_be_hidden()
    expect_open(paired)
    reload(paired)
    paired.type(PIN)
    expect_open(paired)
