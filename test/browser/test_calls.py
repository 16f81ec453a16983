"""The page calls: what a person hears, feels and sees when something waits; and that it can be installed."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator

import pytest
from axe_playwright_python.sync_playwright import Axe
from console_page import ConsolePage
from console_site import ConsoleSite
from playwright.sync_api import expect

PHONE = (390, 844)
#: Notes what a person would hear, feel and see outside of the page.
_SPY = """
window.noted = {tones: 0, beats: 0, badges: [], locks: 0};
const make = AudioContext.prototype.createOscillator;
AudioContext.prototype.createOscillator = function () { window.noted.tones += 1; return make.call(this); };
navigator.vibrate = () => { window.noted.beats += 1; return true; };
navigator.setAppBadge = async (count) => { window.noted.badges.push(count); };
navigator.clearAppBadge = async () => { window.noted.badges.push(0); };
const ask = navigator.wakeLock.request.bind(navigator.wakeLock);
navigator.wakeLock.request = async (kind) => {
  window.lock = await ask(kind);
  window.noted.locks += 1;
  return window.lock;
};
"""


def noted(page: ConsolePage) -> dict:
    return page.page.evaluate("window.noted")


@pytest.fixture
def device_of(browser, site: ConsoleSite) -> Iterator[Callable[..., ConsolePage]]:
    """Returns a page on a device whose sound, vibration, badge and wake lock are noted, logged in as a person."""
    opened: list[ConsolePage] = []

    def open_page(person: str, query: str = "", **more) -> ConsolePage:
        page = ConsolePage(browser, site.url, **more)
        page.context.add_init_script(_SPY)
        opened.append(page.open(query))
        return page.login(person, site.password(person))

    yield open_page
    errors = [error for page in opened for error in page.errors]
    for page in opened:
        page.close()
    assert not errors


def test_a_plan_that_waits_is_heard_felt_and_seen_and_the_screen_stays_on(device_of, robot):
    page = device_of("ada")
    icon = page.page.locator('link[rel="icon"]')
    expect(page.page).to_have_title("construction_twin console")
    # typing the password was the touch that a browser wants
    expect(page.page.locator(".calls-line")).to_be_hidden()
    robot.show_plan()
    expect(page.page).to_have_title("(1) Plan waits - construction_twin console")
    expect(icon).to_have_attribute("href", "icon_call.svg")
    page.wait_for("() => window.noted.tones === 2 && window.noted.beats === 1 && window.noted.badges.at(-1) === 1")
    page.wait_for("() => window.noted.locks === 1 && !window.lock.released")
    page.reject("not now")
    expect(page.page).to_have_title("construction_twin console")
    expect(icon).to_have_attribute("href", "icon.svg")
    page.wait_for("() => window.noted.badges.at(-1) === 0 && window.lock.released")


def test_calls_can_be_turned_off_by_everybody(device_of, robot):
    page = device_of("ada", size=PHONE, color_scheme="light")
    bell = page.page.locator(".calls-open")
    for scheme in ("light", "dark"):
        page.page.emulate_media(color_scheme=scheme)
        assert not Axe().run(page.page, context=".header").response["violations"]
    box = bell.bounding_box()
    assert box is not None and min(box["width"], box["height"]) >= 44
    bell.click()
    expect(bell).to_have_text("Calls off")
    robot.show_plan()
    expect(page.page).to_have_title("(1) Plan waits - construction_twin console")
    assert (noted(page)["tones"], noted(page)["locks"]) == (0, 0)
    bell.click()
    page.wait_for("() => window.noted.tones === 2 && window.noted.locks === 1")


def test_it_can_be_installed_and_nothing_keeps_an_old_page(browser, site):
    page = ConsolePage(browser, site.url).open()
    # chromium's own word: the manifest is read under the page's policy, and nothing of it is wrong
    session = page.context.new_cdp_session(page.page)
    found = session.send("Page.getAppManifest")
    assert found["errors"] == [] and found["url"] == f"{site.url}manifest.webmanifest"
    manifest = json.loads(found["data"])
    assert (manifest["display"], manifest["start_url"]) == ("standalone", "./")
    assert {icon["sizes"] for icon in manifest["icons"]} >= {"192x192", "512x512"}
    kinds = page.page.evaluate(
        """async (names) => Promise.all(names.map(async (name) => {
            const answer = await fetch(name);
            const image = new Image();
            image.src = name;
            if (!name.endsWith("webmanifest")) await image.decode();
            return [name, answer.status, answer.headers.get("Content-Type"), image.naturalWidth];
        }))""",
        ["manifest.webmanifest", *(icon["src"] for icon in manifest["icons"]), "icon_180.png"],
    )
    assert {status for _, status, _, _ in kinds} == {200}
    assert kinds[0][2].startswith("application/manifest+json")
    widths = {name: width for name, _, _, width in kinds}
    assert (widths["icon_180.png"], widths["icon_192.png"], widths["icon_512.png"]) == (180, 192, 512)
    assert page.page.evaluate("async () => (await navigator.serviceWorker.getRegistrations()).length") == 0
    assert not page.errors
    page.close()
