"""The speed slider in Chromium: lowering goes out while it is dragged, raising is held, targets are large enough for a finger."""

from __future__ import annotations

import json

from playwright.sync_api import Page, expect
from processes import wait_until

#: Longest wait for what a robot shall have done [s]; the machine may be busy with other tests.
PATIENCE_S = 60.0


def page_of_dora(page_of, site) -> Page:
    """Return the page of a person who has every right."""
    return page_of().login("dora", site.password("dora")).page


def limits(robot) -> list[tuple[float, bool]]:
    """Return what was asked for in order, and whether to raise it."""
    asked = [(topic, json.loads(payload)) for topic, payload in list(robot.heard) if topic.endswith("_speed/dora")]
    return [(said["limit"], topic.startswith("raise")) for topic, said in asked]


def drag(page: Page, *percents: int) -> None:
    """Drag the handle with the mouse from where it is."""
    slider = page.locator(".speed-slider")
    box = slider.bounding_box()
    assert box is not None

    def at(percent: float) -> tuple[float, float]:
        # the handle is about 16 px wide
        return box["x"] + 8 + (box["width"] - 16) * (percent - 5) / 95, box["y"] + box["height"] / 2

    page.mouse.move(*at(int(slider.input_value())))
    page.mouse.down()
    for percent in percents:
        page.mouse.move(*at(percent), steps=5)
    page.mouse.up()


def test_lowering_goes_out_at_once_and_raising_is_held(page_of, site, robot):
    page = page_of_dora(page_of, site)
    expect(page.locator(".speed-now")).to_contain_text("Speed limit in force: 100 %")
    drag(page, 60, 40)
    wait_until(lambda: robot.speed_limits.people.limit == 0.4, PATIENCE_S, "the lower limit")
    assert all(not moment for _, moment in limits(robot))
    expect(page.locator(".speed-now")).to_contain_text("dora has limited the speed to 40%")
    expect(page.locator(".speed-result")).to_contain_text("carried out")
    count = len(limits(robot))
    drag(page, 80)
    confirm = page.locator(".speed-raise")
    expect(confirm).to_contain_text("raise to 80 %")
    # a tap
    confirm.click()
    page.wait_for_timeout(1200)
    assert len(limits(robot)) == count
    box = confirm.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    wait_until(lambda: robot.speed_limits.people.limit == 0.8, PATIENCE_S, "the higher limit")
    page.mouse.up()
    assert limits(robot)[-1] == (0.8, True)
    expect(confirm).to_be_hidden()
    expect(page.locator(".speed-who")).to_contain_text("80 %, set by dora")


def test_every_target_is_large_enough_and_nothing_is_cut_off(page_of, site, robot):
    size = (390, 844)
    page = page_of_dora(page_of, site)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.locator(".speed-step").first.click()
    wait_until(lambda: robot.speed_limits.people.limit < 1.0, PATIENCE_S, "a step down")
    # as the robot says it: a step up from what is only on its way is another thing
    expect(page.locator(".speed-now")).to_contain_text("95 %")
    page.locator(".speed-step").last.click()
    expect(page.locator(".speed-raise")).to_be_visible()
    for target in (*page.locator(".speed-step").all(), page.locator(".speed-slider"), page.locator(".speed-raise")):
        box = target.bounding_box()
        assert box["height"] >= 44 and box["width"] >= 44
        assert box["x"] >= 0 and box["x"] + box["width"] <= size[0]
