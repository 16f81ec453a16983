"""What the tests of the console's page share: one browser, one site; a page per person. They run with .ws/browser's Python."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from console_page import ConsolePage, launch
from console_site import ConsoleSite
from playwright.sync_api import Browser, Playwright, sync_playwright
from scripted_robot import ScriptedRobot


@pytest.fixture(scope="session")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="session")
def browser(playwright) -> Iterator[Browser]:
    started = launch(playwright)
    yield started
    started.close()


@pytest.fixture(scope="session")
def _started_site(tmp_path_factory) -> Iterator[ConsoleSite]:
    made = ConsoleSite(tmp_path_factory.mktemp("console")).start()
    yield made
    made.stop()


@pytest.fixture
def site(_started_site) -> ConsoleSite:
    """A site whose broker and console run."""
    return _started_site


@pytest.fixture
def robot(site) -> Iterator[ScriptedRobot]:
    """Robot `one`, with nothing under review."""
    with site.robot() as started:
        yield started
        started.take_plan_away()


@pytest.fixture(scope="module")
def _picture_page(browser, _started_site) -> Iterator[ConsolePage]:
    """A reviewer's page with a picture, which software draws: small, and with one robot's meshes loaded once."""
    page = ConsolePage(browser, _started_site.url, size=(900, 700), picture=True).open()
    page.login("ada", _started_site.password("ada"))
    yield page
    errors = list(page.errors)
    page.close()
    assert not errors


@pytest.fixture
def seen(_picture_page, robot) -> ConsolePage:
    """A reviewer's page, in whose picture the robot is drawn at home and no plan is."""
    at_home = f"Math.abs(it.twin.joints?.joint_a1 - {robot.twin[0]}) < 1e-6"
    _picture_page.wait_drawn("one", f"{at_home} && it.path === null && it.goal.joints === null")
    return _picture_page


@pytest.fixture
def page_of(browser, site) -> Iterator[Callable[..., ConsolePage]]:
    """Returns a page that is logged in as a person, e.g. `ada`; fails if it has had an exception by the end."""
    opened: list[ConsolePage] = []

    def open_page(person: str = "", query: str = "", **more) -> ConsolePage:
        page = ConsolePage(browser, site.url, **more).open(query)
        opened.append(page)
        if person:
            page.login(person, site.password(person))
        return page

    yield open_page
    errors = [error for page in opened for error in page.errors]
    for page in opened:
        page.close()
    assert not errors
