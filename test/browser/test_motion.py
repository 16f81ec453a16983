"""Where the arm is and how far the plan has come, with real views: progress, joints, tool, mode; goals and waypoints as numbers."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

UPRIGHT, PHONE = (800, 1280), (390, 844)


def test_while_a_plan_is_played_its_name_progress_rest_and_speed_are_shown(page_of, robot):
    page = page_of("ada")
    progress = page.page.locator(".progress")
    expect(progress).to_be_hidden()
    robot.show_plan(duration=40.0, source="Pia's wall")
    page.look()
    page.hold_approve()
    expect(progress.locator(".progress-name")).to_have_text("Plan by Pia's wall")
    expect(progress.locator(".progress-left")).to_have_text(re.compile(r"0:[0-3]\d left"))
    expect(progress.locator(".progress-speed")).to_have_text("speed 100 %, limit 100 %")
    bar = page.page.get_by_role("progressbar", name="Plan by Pia's wall")
    first = int(bar.get_attribute("aria-valuenow") or 0)
    page.wait_for("(first) => document.querySelector('.progress-bar').getAttribute('aria-valuenow') > first", first)
    page.intervene("pause")
    expect(progress.locator(".progress-left")).to_have_text(re.compile("stands, 0:.. of the plan left"))
    page.intervene("stop")
    expect(progress).to_be_hidden()


def test_joints_and_tool_are_where_the_robot_has_them_and_a_difference_is_told(page_of, robot):
    page = page_of("vic")
    page.tab("motion")
    robot.twin = np.array([0.4, -1.2, 1.1, 0.5, 0.9, -0.7])
    rows = page.page.locator(".motion-row:not(.motion-head)")
    expect(rows).to_have_count(6)
    for k, value in enumerate(robot.twin):
        expect(rows.nth(k).locator(".motion-twin")).to_have_text(f"{math.degrees(value):.2f}°")
        # the limits of the URDF
        expect(rows.nth(k).locator(".motion-end").first).to_have_text(f"{math.degrees(robot.robot.lower[k]):.0f}")
    for name, value in zip("XYZ", robot.tool(robot.twin)):
        field = page.page.locator(".motion-tool dl > div").filter(has=page.page.get_by_text(name, exact=True))
        expect(field.locator("dd")).to_have_text(f"{1000 * value:.1f} mm")
    # the mark stands in the limits where the value does
    low, high = robot.robot.lower[0], robot.robot.upper[0]
    part = 100 * (robot.twin[0] - low) / (high - low)
    at = rows.first.locator(".motion-at-twin").evaluate("(it) => Number(it.style.getPropertyValue('--at'))")
    assert abs(at - part) < 0.1
    expect(rows.nth(1)).not_to_have_class(re.compile("is-over"))
    robot.arm_error = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    expect(rows.nth(1)).to_have_class(re.compile("is-over"))
    expect(rows.nth(1).locator(".motion-difference")).to_have_text("2.86° over 1.15°")
    expect(rows.nth(0)).not_to_have_class(re.compile("is-over"))


@pytest.mark.parametrize("size", [UPRIGHT, PHONE], ids=["upright", "phone"])
def test_where_the_servos_should_have_the_arm_stands_beside_twin_and_arm(page_of, robot, size):
    page = page_of("vic")
    page.page.set_viewport_size({"width": size[0], "height": size[1]})
    page.tab("motion")
    robot.twin, robot.arm_error = np.array([0.4, -1.2, 1.1, 0.5, 0.9, -0.7]), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    row = page.page.locator(".motion-row:not(.motion-head)").first
    expect(row.locator(".motion-twin")).to_have_text(f"{math.degrees(0.4):.2f}°")
    expect(page.page.locator(".motion-key .motion-expected-name")).to_be_hidden()
    expect(row.locator(".motion-expected")).to_be_hidden()
    robot.expected_error = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    expect(page.page.locator(".motion-key .motion-expected-name")).to_be_visible()
    expect(row.locator(".motion-expected")).to_have_text(f"{math.degrees(0.5):.2f}°")
    low, high = robot.robot.lower[0], robot.robot.upper[0]
    at = row.locator(".motion-at-expected").evaluate("(it) => Number(it.style.getPropertyValue('--at'))")
    assert abs(at - 100 * (0.5 - low) / (high - low)) < 0.1
    # its number stands where there is room, and nothing stands over anything
    cells = row.locator("> :not(.motion-range):visible")
    assert ("motion-expected" in cells.evaluate_all("(them) => them.map((it) => it.className)")) is (size is UPRIGHT)
    boxes = [cell.bounding_box() for cell in cells.all()]
    assert all(left["x"] + left["width"] <= right["x"] for left, right in itertools.pairwise(boxes))
    assert not Axe().run(page.page, context=".motion").response["violations"]


def test_mode_and_override_are_what_the_controller_sends_or_not_sent(page_of, robot):
    page = page_of("vic", "?language=de")
    facts = page.tab("motion").locator(".motion-facts dd")
    expect(facts.nth(0)).to_have_text("nicht gesendet")
    expect(facts.nth(1)).to_have_text("nicht gesendet")
    told = {"controller_mode": "T1", "controller_override_percent": "30"}
    robot.link = replace(robot.link, gateway_counters={**robot.link.gateway_counters, **told})
    expect(facts.nth(0)).to_have_text("T1")
    expect(facts.nth(1)).to_have_text("30 %")


def test_a_goal_of_the_tool_is_typed_and_asked_for(page_of, robot):
    page = page_of("pia")
    page.tab("plan").locator(".plan-begin").click()
    page.page.locator(".plan-tool summary").click()
    fields = page.page.locator(".plan-tool-fields input")
    begin = [f"{1000 * value:.1f}" for value in robot.tool(robot.twin)]
    assert [field.input_value() for field in fields.all()][:3] == begin
    height = float(begin[2]) - 150.0
    page.page.get_by_label("Z [mm]").fill(f"{height:.1f}".replace(".", ","))
    page.page.get_by_role("button", name="Ask for a motion of the tool to there").click()
    expect(page.page.locator("#plan .plan-answer")).to_contain_text("this robot of a test plans no pose")
    (request,) = robot.payloads("plan_request/pia")
    assert request["kind"] == "pose" and np.allclose(request["position"], [*robot.tool(robot.twin)[:2], height / 1000])
    assert robot.state == "IDLE"


def test_everybody_can_use_them_and_nothing_is_wider_than_the_screen(page_of, robot):
    page = page_of("pia", size=PHONE, color_scheme="light")
    robot.arm_error = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    robot.show_plan()
    axes = {"plan": ".plan-tool", "motion": "#motion", "verdict": ".waypoints"}
    for name, area in axes.items():
        panel = page.tab(name)
        if name == "plan":
            panel.locator(".plan-begin").click()
        if name != "motion":
            page.page.locator(f"{area} summary").click()
        else:
            expect(page.page.locator(".motion-row.is-over")).to_be_visible()
        for scheme in ("light", "dark"):
            page.page.emulate_media(color_scheme=scheme)
            found = Axe().run(page.page, context=area).response["violations"]
            assert not found, [(each["id"], [node["target"] for node in each["nodes"]]) for each in found]
        for each in page.page.locator(f"{area} :is(summary, input, button)").all():
            box = each.bounding_box()
            assert box is not None and box["height"] >= 44
        assert page.page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
