"""A camera's picture beside the twin, through the console: who sees it, how old it is, and that it is never frozen."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from console_page import ConsolePage
from console_site import ConsoleSite
from mjpeg_camera import MjpegCamera, jpeg
from playwright.sync_api import expect

SMALL, PHONE = (1000, 800), (390, 844)


@pytest.fixture(scope="module")
def camera() -> Iterator[MjpegCamera]:
    with MjpegCamera(period=0.1) as made:
        yield made


@pytest.fixture(scope="module")
def _started_site(tmp_path_factory, camera) -> Iterator[ConsoleSite]:
    made = ConsoleSite(tmp_path_factory.mktemp("console"), cameras=(f"front={camera.url}@one",)).start()
    yield made
    made.stop()


@pytest.fixture
def announced(robot) -> Iterator[None]:
    """The robot's programs say that the camera is there."""
    robot.publish("camera/front", json.dumps({"name": "front"}).encode(), retain=True)
    yield
    robot.publish("camera/front", b"", retain=True)


def shade(page: ConsolePage) -> int:
    """Return the grey in the middle of the camera's picture, -1 where there is none."""
    return page.page.evaluate("""() => {
        const canvas = document.querySelector(".camera-picture");
        if (canvas.width < 2) return -1;
        return canvas.getContext("2d").getImageData(canvas.width / 2, canvas.height / 2, 1, 1).data[0];
    }""")


def wait_for_shade(page: ConsolePage, wanted: int) -> None:
    page.wait_for(
        """(wanted) => {
        const {width, height} = document.querySelector(".camera-picture");
        if (width < 2) return false;
        const middle = document.querySelector(".camera-picture").getContext("2d").getImageData(width / 2, height / 2, 1, 1);
        return Math.abs(middle.data[0] - wanted) < 6;
    }""",
        wanted,
    )


def test_a_camera_is_seen_beside_the_twin_with_its_age_and_never_frozen(page_of, camera, announced):
    page = page_of("viewer-vic", picture=True, size=SMALL)
    page.wait_drawn("one", "it.twin.joints !== null")
    camera.picture = jpeg(60, 240)
    page.page.get_by_role("button", name="Camera front").click()
    wait_for_shade(page, 60)
    camera.picture = jpeg(220, 240)
    wait_for_shade(page, 220)
    expect(page.page.locator(".camera-age")).to_contain_text("0.")
    # the twin is drawn beside it
    stage = page.page.locator(".stage").bounding_box()
    beside = page.page.locator(".camera").bounding_box()
    assert stage is not None and beside is not None
    assert stage["width"] > 200 and stage["x"] + stage["width"] <= beside["x"] + 1
    camera.frozen = True
    cover = page.page.locator(".camera-cover")
    expect(cover).to_be_visible()
    expect(cover).to_contain_text("The camera front sends no pictures")
    assert shade(page) == -1
    camera.frozen = False
    wait_for_shade(page, 220)
    expect(cover).to_be_hidden()
    # closed, nobody reads it any more
    page.page.get_by_role("button", name="Camera front").click()
    expect(page.page.locator(".camera")).to_be_hidden()


def test_on_a_phone_the_camera_stands_below_the_twin_in_german(page_of, camera, announced):
    page = page_of("reviewer-ada", picture=True, size=PHONE, query="?language=de")
    page.wait_drawn("one", "it.twin.joints !== null")
    page.page.get_by_role("button", name="Kamera front").click()
    wait_for_shade(page, 220)
    expect(page.page.locator(".camera-age")).to_contain_text("s alt")
    assert page.page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]


def test_whom_the_broker_does_not_let_read_the_topic_the_console_shows_nothing(browser, site, camera, announced):
    """A viewer of the other robot: the page knows of no camera, and the console gives none when it is asked all the same."""
    before = camera.connections
    page = ConsolePage(browser, site.url).open()
    page.login("two-viewer-vic", site.password("two-viewer-vic"))
    page.page.wait_for_timeout(500)
    expect(page.page.locator(".camera-bar")).to_be_hidden()
    answer = page.page.evaluate("fetch('private/camera/one/front').then(({status}) => status)")
    assert answer == 403 and camera.connections == before
    page.close()
