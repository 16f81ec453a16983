"""What is drawn, and that everybody can use it: the robot's pixels, the plan's geometry, two robots, a phone, accessibility."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from console_page import ConsolePage
from console_site import OpenSite
from matplotlib.image import imread
from playwright.sync_api import expect
from scripted_robot import ScriptedRobot

#: A small picture: software draws it.
SMALL = (900, 700)
#: Positions that went through 4 bytes and through degrees and back [rad], [m].
_FINE = 1e-5
#: Of `view` [s]: each is drawn, and software takes long for a frame.
SLOW = 0.2
SERIOUS = ("serious", "critical")
TABLET, PHONE = (1280, 800), (390, 844)

#: Work from a building model, with a task of each kind of state.
TASKS = {
    "v": 1, "robot": "one", "model": "wall", "model_hash": "0" * 64, "schedule": "agreed", "next": "2", "engaged": False,
    "reason": "", "notes": ["the third element is not in the model"],
    "tasks": [
        {"id": str(number), "name": f"Place {number}", "element": f"beam-{number}", "work": "place", "state": state,
         "question": "Is it in the grip?" if state == "asks" else "", "reason": "", "after": []}
        for number, state in enumerate(("done", "ready", "carried", "waiting", "asks", "held", "skipped"), 1)
    ],
}  # fmt: skip


@pytest.fixture
def robot(site) -> Iterator[ScriptedRobot]:
    """Robot `one`, with nothing under review."""
    with site.robot(period=SLOW) as started:
        yield started
        started.take_plan_away()


def pixels(page: ConsolePage) -> np.ndarray:
    """Return the canvas as a person sees it, red, green, blue from 0 to 255."""
    shot = page.page.locator("#picture canvas").screenshot()
    return np.rint(255 * imread(io.BytesIO(shot))[:, :, :3]).astype(int)


def orange(picture: np.ndarray) -> np.ndarray:
    """Return where the picture has the colour of the arm, seen through the green of the measured one: hardly any blue."""
    red, green, blue = (picture[:, :, k] for k in range(3))
    return (red > 100) & (red > green) & (green > blue) & (red > 2 * blue)


def serious(page: ConsolePage) -> list[str]:
    """Return what axe calls serious or critical, with the first elements that it is about."""
    found = Axe().run(page.page).response["violations"]
    return [f"{each['id']}: {each['help']}: {[node['target'] for node in each['nodes']][:4]}" for each in found
            if each["impact"] in SERIOUS]  # fmt: skip


def pieces(path: np.ndarray) -> list[float]:
    """Return a path as it goes to the graphics card: begin and end of each piece, one after the other."""
    return np.hstack((path[:-1], path[1:])).ravel().tolist()


def test_the_robot_is_really_drawn_and_moves_on_the_screen(seen, robot):
    seen.wait_frame()
    before = pixels(seen)
    assert orange(before).mean() > 0.01
    robot.twin = robot.twin + np.array([0.8, 0.3, -0.4, 0.0, 0.0, 0.0])
    seen.wait_drawn("one", f"Math.abs(it.twin.joints.joint_a1 - {robot.twin[0]}) < 1e-6")
    seen.wait_frame()
    after = pixels(seen)
    assert orange(after).mean() > 0.01
    # and it has left where it was
    assert (orange(before) & ~orange(after)).sum() > 0.2 * orange(before).sum()


def test_the_arm_stands_on_the_screen_where_the_forward_kinematics_has_it(seen, robot):
    robot.twin = np.array([0.4, -1.2, 1.1, 0.5, 0.9, -0.7])
    robot.arm_error = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    drawn = seen.wait_drawn("one", "Math.abs(it.arm.joints.joint_a1 - 0.45) < 1e-6")
    assert np.allclose(drawn["twin"]["tool"], robot.tool(robot.twin), atol=_FINE)
    assert np.allclose(drawn["arm"]["tool"], robot.tool(robot.twin + robot.arm_error), atol=_FINE)
    in_hold = drawn["armColour"]
    robot.arm_error = np.zeros(6)
    seen.wait_drawn("one", f"it.armColour !== {in_hold}")


def test_the_plan_that_is_shown_is_the_plan_on_the_desk(seen, robot):
    """Geometry against geometry: the published path, what the kinematics of the desk says, and what went to the graphics card."""
    plan = robot.show_plan()
    drawn = seen.wait_drawn("one", "it.path !== null && it.goal.joints !== null")
    desk = np.array([robot.tool(row) for row in plan.trajectory["positions"]])
    assert np.allclose(drawn["path"], desk, atol=1e-4)
    seen.wait_uploaded(pieces(np.round(desk, 4)), _FINE)
    assert np.allclose(drawn["goal"]["tool"], robot.tool(plan.goal), atol=_FINE)
    # played back: the ghost stands where the desk's interpolation has it
    slider = seen.page.locator("#verdict .playback-slider")
    slider.evaluate("(it) => { it.value = it.max / 3; it.dispatchEvent(new Event('input', {bubbles: true})); }")
    time = float(slider.evaluate("(it) => it.value"))
    drawn = seen.wait_drawn("one", "it.plan.joints !== null")
    assert robot.trajectory is not None
    assert np.allclose(list(drawn["plan"]["joints"].values()), robot.trajectory.sample(time)[0], atol=1e-6)
    assert np.allclose(drawn["plan"]["tool"], robot.tool(robot.trajectory.sample(time)[0]), atol=_FINE)
    # and another plan replaces it
    other = robot.show_plan(goal=robot.twin + 0.3)
    desk = np.array([robot.tool(row) for row in other.trajectory["positions"]])
    seen.wait_uploaded(pieces(np.round(desk, 4)), _FINE)


def test_a_plan_that_was_played_to_its_end_in_the_picture_may_be_approved(seen, robot):
    plan = robot.show_plan(duration=1.5)
    seen.wait_drawn("one", "it.path !== null")
    expect(seen.approve_button).to_be_disabled()
    seen.play_to_end()
    drawn = seen.wait_drawn("one", f"Math.abs((it.plan.joints?.joint_a1 ?? 0) - {plan.goal[0]}) < 1e-6")
    assert np.allclose(drawn["plan"]["tool"], robot.tool(plan.goal), atol=_FINE)
    seen.hold_approve()
    expect(seen.notice).to_contain_text("accepted")
    assert robot.verdicts == [("one-reviewer-ada", "approved", plan.id)]
    # nothing but the motion moves the arm on the screen
    seen.wait_drawn("one", f"Math.abs(it.twin.joints.joint_a1 - {plan.goal[0]}) < 1e-6")


def test_on_a_phone_a_playback_waits_until_the_picture_is_in_view_and_what_was_played_stays(page_of, robot):
    page = page_of("reviewer-ada", picture=True, size=PHONE)
    page.wait_drawn("one")
    robot.show_plan(duration=0.5)
    play, time = page.page.locator(".playback-play"), page.page.locator(".playback-time")
    hint, waits = page.page.locator(".verdict-hint"), page.page.locator(".playback-waits")
    picture = page.page.locator("#picture")
    expect(hint).to_contain_text("Play the plan to its end")
    page.page.evaluate("window.scrollTo(0, document.documentElement.scrollHeight)")
    expect(picture).not_to_be_in_viewport()
    expect(hint).to_contain_text("not in view: scroll to it")
    # the button without the scrolling that a click does
    play.dispatch_event("click")
    expect(waits).to_be_visible()
    page.wait_frame()
    expect(time).to_contain_text("0.0 s of 0.5 s")
    picture.scroll_into_view_if_needed()
    expect(time).to_contain_text("0.5 s of 0.5 s")
    expect(page.approve_button).to_be_enabled()
    page.hold_approve()
    expect(page.notice).to_contain_text("accepted")


def test_graphics_that_the_browser_takes_away_show_nothing_until_they_are_given_back(page_of, robot):
    page = page_of("reviewer-ada", picture=True, size=SMALL)
    page.wait_drawn("one")
    robot.show_plan(duration=0.5)
    hint, note = page.page.locator(".verdict-hint"), page.page.locator(".picture-note")
    expect(hint).to_contain_text("Play the plan to its end")
    page.page.evaluate("""() => {
        window.graphics = document.querySelector("#picture canvas").getContext("webgl2").getExtension("WEBGL_lose_context");
        window.graphics.loseContext();
    }""")
    expect(hint).to_contain_text("draws nothing at the moment")
    expect(note).to_contain_text("taken the graphics away")
    page.page.locator(".playback-play").click()
    expect(page.page.locator(".playback-waits")).to_be_visible()
    page.page.evaluate("window.graphics.restoreContext()")
    expect(page.page.locator(".playback-time")).to_contain_text("0.5 s of 0.5 s")
    expect(page.approve_button).to_be_enabled()
    page.wait_frame()
    assert orange(pixels(page)).mean() > 0.01


def test_a_plan_that_was_played_where_no_picture_is_was_not_looked_at(page_of, robot):
    page = page_of("reviewer-ada")
    robot.show_plan(duration=0.5)
    page.page.locator(".playback-play").click()
    expect(page.page.locator(".playback-time")).to_contain_text("0.5 s of 0.5 s")
    expect(page.page.locator(".verdict-steps li").nth(1)).to_have_class("is-done")
    expect(page.approve_button).to_be_disabled()
    assert not robot.payloads("review")


def test_of_a_plan_that_is_not_what_its_hash_says_nothing_is_drawn(seen, robot):
    plan = robot.show_plan()
    seen.wait_drawn("one", "it.path !== null")
    robot.publish("plan", plan.to_json(200).replace(plan.hash.encode(), b"0" * 64), retain=True)
    drawn = seen.wait_drawn("one", "it.path === null")
    assert drawn["goal"]["joints"] is None and drawn["plan"]["joints"] is None


def test_two_robots_are_shown_at_once_and_each_is_its_own(tmp_path, browser):
    with OpenSite(tmp_path) as site, site.robot("one", SLOW) as one, site.robot("two", SLOW) as two:
        two.twin = two.twin + np.array([-0.7, 0.2, 0.3, 0.0, 0.5, 0.0])
        page = ConsolePage(browser, site.url, picture=True, size=(1280, 700)).open()
        buttons = page.page.locator(".robots button")
        expect(buttons).to_have_text(["one", "two"])
        for robot in (one, two):
            drawn = page.wait_drawn(robot.name, f"Math.abs(it.twin.joints?.joint_a1 - {robot.twin[0]}) < 1e-6")
            assert np.allclose(drawn["twin"]["tool"], robot.tool(robot.twin), atol=_FINE)
        page.wait_frame()
        coloured = orange(pixels(page))
        middle = coloured.shape[1] // 2
        for half in (coloured[:, :middle], coloured[:, middle:]):
            assert half.mean() > 0.005
        # what is said and pressed is about the robot that it names
        two.show_plan(source="the second robot")
        assert page.drawn("one")["path"] is None
        page.wait_drawn("two", "it.path !== null")
        buttons.nth(1).click()
        expect(page.page.locator(".verdict-title")).to_contain_text("the second robot")
        page.page.get_by_label("Stop two").click()
        expect(page.page.get_by_role("group", name="two").locator(".stop-result")).to_contain_text("Stop: carried out")
        assert two.payloads("stop") and not one.payloads("stop")
        # alone it has the whole picture
        page.page.get_by_role("button", name="All robots").click()
        expect(page.page.locator(".overlay:visible")).to_have_count(1)
        assert not page.errors
        page.close()


def test_the_tool_is_dragged_to_a_goal_and_the_planner_is_asked_for_the_way(page_of, robot):
    """From the picture to the plan and back: handle, questions for joint values, ghost, request, path."""
    page = page_of("planner-pia", picture=True, size=SMALL)
    page.wait_drawn("one")
    page.page.locator(".plan-begin").click()
    begin = np.array(page.wait_drawn("one", "it.handle !== null")["handle"]["position"])
    assert np.allclose(begin, robot.tool(robot.twin), atol=_FINE)
    page.page.locator("#picture").scroll_into_view_if_needed()
    # what has not been drawn yet cannot be taken
    page.wait_frame()
    page.drag_tool("one", 1.5)
    expect(page.page.locator(".plan-reach")).to_contain_text("The arm gets there and touches nothing.")
    expect(page.page.locator("#plan .plan-ask")).to_be_enabled()
    drawn = page.wait_drawn("one")
    end = np.array(drawn["handle"]["position"])
    # at home the tool's z axis points down
    assert np.linalg.norm(end - begin) > 0.1 and np.allclose(end[:2], begin[:2], atol=1e-3)
    assert np.allclose(drawn["goal"]["tool"], end, atol=1e-3)
    questions = [asked for asked in robot.payloads("ik/one-planner-pia") if "seed" in asked]
    assert np.allclose(questions[-1]["position"], end, atol=_FINE)
    page.page.locator("#plan .plan-ask").click()
    expect(page.page.locator("#plan .plan-answer")).to_contain_text("There is a plan")
    (request,) = robot.payloads("plan_request/one-planner-pia")
    assert np.allclose(robot.tool(list(request["joints"].values())), end, atol=1e-3)
    assert robot.plan is not None and robot.state == "IDLE"
    drawn = page.wait_drawn("one", "it.path !== null")
    assert np.allclose(drawn["path"][0], begin, atol=1e-3) and np.allclose(drawn["path"][-1], end, atol=1e-3)


@pytest.mark.parametrize("size", (TABLET, PHONE), ids=("tablet", "phone"))
def test_axe_finds_nothing_serious_light_or_dark(page_of, robot, size):
    page = page_of("reviewer-ada", size=size, color_scheme="light")
    robot.show_plan()
    robot.publish("work/tasks", json.dumps(TASKS).encode(), retain=True)
    try:
        expect(page.page.locator(".verdict")).to_be_visible()
        page.page.locator(".verdict-checks summary").click()
        for area in ("plots", "runs"):
            page.page.locator(f"#{area} > summary").click()
        for area in ("tasks", "plots", "runs", "plan"):
            expect(page.page.locator(f"#{area} > .inside")).to_be_visible()
        assert not serious(page)
        page.page.emulate_media(color_scheme="dark")
        assert not serious(page)
    finally:
        robot.publish("work/tasks", b"", retain=True)


@pytest.mark.parametrize("scheme", ("light", "dark"))
def test_axe_finds_nothing_serious_in_the_login(page_of, scheme):
    page = page_of(color_scheme=scheme)
    expect(page.page.locator(".login")).to_be_visible()
    assert not serious(page)


@pytest.mark.parametrize("size", (TABLET, PHONE), ids=("tablet", "phone"))
def test_stop_can_be_pressed_without_scrolling_and_nothing_is_wider_than_the_screen(page_of, robot, size):
    page = page_of("reviewer-ada", size=size)
    robot.show_plan()
    expect(page.page.locator(".verdict")).to_be_visible()
    page.page.locator("#plots > summary").click()
    stop = page.page.locator(".stop-stop").first
    height = page.page.evaluate("document.documentElement.scrollHeight")
    assert height > size[1]
    for top in np.linspace(0, height - size[1], 5):
        page.page.evaluate("(top) => window.scrollTo(0, top)", top)
        expect(stop).to_be_in_viewport(ratio=1)
        box = stop.bounding_box()
        assert box is not None and min(box["width"], box["height"]) >= 44
        # in view, and under nothing else
        middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        assert page.page.evaluate("([x, y]) => document.elementFromPoint(x, y).className", middle) == "stop-stop"
    assert page.page.evaluate("document.documentElement.scrollWidth") <= size[0]


def test_the_page_speaks_german(page_of, robot):
    page = page_of("reviewer-ada", query="?language=de")
    expect(page.page.locator("html")).to_have_attribute("lang", "de")
    robot.show_plan()
    expect(page.approve_button).to_contain_text("Freigeben")
