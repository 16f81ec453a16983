"""What is drawn, and that everybody can use it: the robot's pixels, the plan's geometry, two robots, a phone,
accessibility.
"""

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
PHONE = (390, 844)

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


def wait_uploaded(page: ConsolePage, vertices: list[float], tolerance: float) -> None:
    """Wait until exactly these vertices have gone to the graphics card, in one buffer."""
    page.wait_for(
        """({vertices, tolerance}) => window.uploaded.some((each) => each.length === vertices.length
            && each.every((value, k) => Math.abs(value - vertices[k]) < tolerance))""",
        {"vertices": vertices, "tolerance": tolerance},
    )


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
    wait_uploaded(seen, pieces(np.round(desk, 4)), _FINE)
    assert np.allclose(drawn["goal"]["tool"], robot.tool(plan.goal), atol=_FINE)
    # played back: the ghost stands where the desk's interpolation has it
    slider = seen.page.locator(".playback-slider")
    slider.evaluate("(it) => { it.value = it.max / 3; it.dispatchEvent(new Event('input', {bubbles: true})); }")
    time = float(slider.evaluate("(it) => it.value"))
    drawn = seen.wait_drawn("one", "it.plan.joints !== null")
    assert robot.trajectory is not None
    assert np.allclose(list(drawn["plan"]["joints"].values()), robot.trajectory.sample(time)[0], atol=1e-6)
    assert np.allclose(drawn["plan"]["tool"], robot.tool(robot.trajectory.sample(time)[0]), atol=_FINE)
    # and another plan replaces it
    other = robot.show_plan(goal=robot.twin + 0.3)
    desk = np.array([robot.tool(row) for row in other.trajectory["positions"]])
    wait_uploaded(seen, pieces(np.round(desk, 4)), _FINE)


def test_a_plan_that_was_played_to_its_end_in_the_picture_may_be_approved(seen, robot):
    plan = robot.show_plan(duration=1.5)
    seen.wait_drawn("one", "it.path !== null")
    expect(seen.approve_button).to_be_disabled()
    seen.play_to_end()
    drawn = seen.wait_drawn("one", f"Math.abs((it.plan.joints?.joint_a1 ?? 0) - {plan.goal[0]}) < 1e-6")
    assert np.allclose(drawn["plan"]["tool"], robot.tool(plan.goal), atol=_FINE)
    seen.hold_approve()
    expect(seen.notice).to_contain_text("accepted")
    assert robot.verdicts == [("ada", "approved", plan.id)]
    # nothing but the motion moves the arm on the screen
    seen.wait_drawn("one", f"Math.abs(it.twin.joints.joint_a1 - {plan.goal[0]}) < 1e-6")


def test_nothing_is_played_or_approved_in_a_picture_that_is_too_small(page_of, robot):
    page = page_of("ada", picture=True, size=PHONE)
    page.wait_drawn("one")
    # that an approval was accepted is news until the motion has ended: longer than a busy machine takes to look
    robot.show_plan(duration=4.0)
    play, time = page.page.locator(".playback-play"), page.page.locator(".playback-time")
    hint, waits = page.page.locator(".verdict-hint"), page.page.locator(".playback-waits")
    expect(hint).to_contain_text("Play the plan to its end")
    page.page.set_viewport_size({"width": 290, "height": PHONE[1]})
    expect(hint).to_contain_text("too small to judge a motion")
    play.click()
    expect(waits).to_be_visible()
    page.wait_frame()
    expect(time).to_contain_text("0.0 s of 4.0 s")
    page.page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
    expect(time).to_contain_text("4.0 s of 4.0 s")
    expect(page.approve_button).to_be_enabled()
    # what was played stays played, and is approved only where it can be seen
    page.page.set_viewport_size({"width": 290, "height": PHONE[1]})
    expect(page.approve_button).to_be_disabled()
    page.page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
    page.hold_approve()
    expect(page.notice).to_contain_text("accepted")


def test_graphics_that_the_browser_takes_away_show_nothing_until_they_are_given_back(page_of, robot):
    page = page_of("ada", picture=True, size=SMALL)
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
    page = page_of("ada")
    robot.show_plan(duration=0.5)
    page.page.locator(".playback-play").click()
    expect(page.page.locator(".playback-time")).to_contain_text("0.5 s of 0.5 s")
    expect(page.page.locator(".verdict-steps li").nth(1)).to_have_class("is-done")
    expect(page.approve_button).to_be_disabled()
    assert not robot.payloads("review")


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
        told = page.page.locator(".stop-results")
        expect(told).to_contain_text("Stop two: carried out")
        assert two.payloads("stop") and not one.payloads("stop")
        # one press for all, and an answer of each
        page.page.locator(".stop-all").click()
        expect(told).to_contain_text("Stop one: carried out")
        assert len(two.payloads("stop")) == 2 and one.payloads("stop")
        told.get_by_role("button").click()
        expect(told.locator(".stop-result:not(:empty)")).to_have_count(0)
        # alone it has the whole picture
        page.page.get_by_role("button", name="All robots").click()
        expect(page.page.locator(".overlay:visible")).to_have_count(1)
        assert not page.errors
        page.close()


def test_a_goal_is_set_by_a_slider_and_the_planner_is_asked_for_the_way(page_of, robot):
    """From the panel to the plan and back: ghost, request, path."""
    page = page_of("pia", picture=True, size=SMALL)
    begin = page.wait_drawn("one")["twin"]["tool"]
    page.tab("plan").locator(".plan-begin").click()
    page.page.locator("#plan .plan-joint input[type=text]").first.fill("30")
    page.page.locator("#plan .plan-joint input[type=text]").first.press("Enter")
    end = np.array(page.wait_drawn("one", "it.goal.joints !== null && it.goal.joints.joint_a1 > 0.5")["goal"]["tool"])
    page.page.locator("#plan .plan-ask").click()
    expect(page.page.locator("#plan .plan-answer")).to_contain_text("There is a plan")
    (request,) = robot.payloads("plan_request/pia")
    assert np.allclose(robot.tool(list(request["joints"].values())), end, atol=1e-3)
    assert robot.plan is not None and robot.state == "IDLE"
    drawn = page.wait_drawn("one", "it.path !== null")
    assert np.allclose(drawn["path"][0], begin, atol=1e-3) and np.allclose(drawn["path"][-1], end, atol=1e-3)


def box(name: str, size: list[float], position: list[float]) -> dict:
    """Return an object of a scene."""
    return {
        "name": name, "shape": "box", "size": size, "mesh": "", "position": position, "orientation": [0, 0, 0, 1], "padding": 0,
        "link": "", "touch": [],
    }  # fmt: skip


FLOOR = box("floor", [20.0, 20.0, 1.0], [0.0, 0.0, -0.5])
TABLE = box("table", [0.8, 0.8, 0.8], [1.2, -1.2, 0.4])


def test_the_legend_has_what_is_drawn_in_its_colours(seen, robot):
    def legend() -> dict[str, str]:
        return seen.page.evaluate("""() => {
            const colour = (entry) => getComputedStyle(entry.querySelector(".swatch")).getPropertyValue("--drawn");
            const entries = [...document.querySelectorAll(".legend li")];
            return Object.fromEntries(entries.map((entry) => [entry.className, colour(entry)]));
        }""")

    # what an earlier picture showed may still be going
    for kind, count in (("both", 1), ("path", 0), ("arm", 0)):
        expect(seen.page.locator(f".legend-{kind}")).to_have_count(count)
    assert legend()["legend-both"] == "#ff660d"
    robot.show_plan()
    robot.arm_error = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    drawn = seen.wait_drawn(
        "one", "it.path !== null && Math.abs(it.arm.joints.joint_a1 - it.twin.joints.joint_a1) > 0.04"
    )
    expect(seen.page.locator(".legend-path")).to_have_count(1)
    expect(seen.page.locator(".legend-arm")).to_have_count(1)
    assert legend()["legend-arm"] == f"#{drawn['armColour']:06x}" and legend()["legend-goal"] == "#0e9aa7"
    # the closest point is the plan's, with its distance in words and in the picture
    expect(seen.page.locator(".legend-closest")).to_contain_text("213 mm after 1.0 s (link_4 - table)")
    assert "213 mm" in seen.drawn("one")["words"]
    robot.arm_error = np.zeros(6)


def coloured(picture: np.ndarray, colour: int) -> int:
    """Return how many pixels have a colour to within what smooth edges change."""
    wanted = np.array([colour >> 16, colour >> 8 & 255, colour & 255])
    return int((np.abs(picture - wanted).max(axis=2) <= 6).sum())


def test_in_a_small_picture_everything_has_its_place(page_of, robot):
    width, height = 300, 180
    page = page_of("ada", picture=True, size=(1280, 800))
    robot.show_plan()
    page.wait_drawn("one", "it.path !== null")
    page.page.evaluate(
        """([width, height]) => {
            const {style} = document.querySelector("#picture");
            const sizes = {width, height, "min-height": 0};
            for (const [name, value] of Object.entries(sizes)) style.setProperty(name, `${value}px`);
        }""",
        [width, height],
    )
    page.wait_for("(width) => Math.abs(document.querySelector('.stage').clientWidth - width) < 4", width)
    page.wait_frame()
    boxes = page.page.evaluate("""() => {
        const of = (element) => {
            const {left, top, right, bottom} = element.getBoundingClientRect();
            return [left, top, right, bottom];
        };
        const all = [...document.querySelectorAll(".tool, .legend, .label, .overlay-name")];
        const parts = all.filter((each) => each.checkVisibility()).map((each) => [each.className, ...of(each)]);
        return {stage: of(document.querySelector(".stage")), parts};
    }""")
    left, top, right, bottom = boxes["stage"]
    parts = [(name, np.array(place)) for name, *place in boxes["parts"]]
    assert sum(name.startswith("tool ") for name, _ in parts) >= 2
    for number, (name, one) in enumerate(parts):
        assert one[0] >= left and one[1] >= top and one[2] <= right + 0.5 and one[3] <= bottom + 0.5, name
        if name.startswith("tool "):
            assert min(one[2:] - one[:2]) >= 44, name
        for other_name, other in parts[number + 1 :]:
            assert (one[2:] <= other[:2] + 1).any() or (other[2:] <= one[:2] + 1).any(), (name, other_name)


def test_axe_finds_nothing_serious_light_or_dark(page_of, robot):
    page = page_of("ada", size=PHONE, color_scheme="light")
    robot.show_plan()
    robot.publish("work/tasks", json.dumps(TASKS).encode(), retain=True)
    try:
        expect(page.page.locator(".verdict")).to_be_visible()
        page.page.locator(".verdict-checks summary").click()
        for scheme in ("light", "dark"):
            page.page.emulate_media(color_scheme=scheme)
            for area in ("verdict", "tasks", "motion", "plan", "messages"):
                page.tab(area)
                assert not serious(page), area
    finally:
        robot.publish("work/tasks", b"", retain=True)


def show_scene(robot, *objects: dict) -> None:
    document = {"hash": f"{len(objects):064d}", "frame": "base_link", "padding": 0.01, "objects": objects}
    robot.publish("scene", json.dumps(document).encode(), retain=True)


def test_axe_finds_nothing_serious_in_the_picture_light_or_dark(seen, robot):
    show_scene(robot, FLOOR, TABLE)
    robot.show_plan()
    seen.wait_drawn("one", "it.path !== null && it.objects.includes('table')")
    for scheme in ("light", "dark"):
        seen.page.emulate_media(color_scheme=scheme)
        assert not serious(seen)
    seen.page.emulate_media(color_scheme="light")
    show_scene(robot)


@pytest.mark.parametrize("scheme", ("light", "dark"))
def test_axe_finds_nothing_serious_in_the_login(page_of, scheme):
    page = page_of(color_scheme=scheme)
    expect(page.page.locator(".login")).to_be_visible()
    assert not serious(page)


#: A tablet, a phone on its side and upright.
SCREENS = ((1280, 800), (844, 390), (390, 844))


@pytest.mark.parametrize("size", SCREENS, ids=lambda size: f"{size[0]}x{size[1]}")
def test_sentence_picture_verdict_and_stop_are_in_view_together(page_of, robot, size):
    # the longer words
    page = page_of("ada", "?language=de", size=size, picture=True)
    page.wait_drawn("one")
    robot.show_plan()
    expect(page.page.locator(".verdict")).to_be_visible()
    assert page.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == list(
        size
    )
    # the approve button says why it is not to be pressed yet: the picture is large enough, and the sentence is whole
    expect(page.page.locator(".verdict-hint")).to_contain_text("Spielen Sie")
    boxes = {}
    for name, place in (
        ("picture", ".stage"), ("sentence", ".status-worst"), ("approve", ".verdict-approve"), ("play", ".playback-play"),
        ("stop", ".stop-stop"), ("pause", ".stop-pause"), ("bar", "#stop"),
    ):  # fmt: skip
        found = page.page.locator(place).first
        expect(found).to_be_in_viewport(ratio=0.99)
        box = boxes[name] = found.bounding_box()
        middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        # in view, and under nothing else
        inside = "([x, y, place]) => document.elementFromPoint(x, y).closest(place) !== null"
        assert page.page.evaluate(inside, [*middle, place]), name
    assert boxes["picture"]["width"] >= 300 and boxes["picture"]["height"] >= 180
    assert all(min(boxes[name]["width"], boxes[name]["height"]) >= 64 for name in ("stop", "pause", "approve"))
    assert boxes["bar"]["height"] <= 0.2 * size[1]
    small = page.page.evaluate(
        """() => [...document.querySelectorAll("button, summary, select, input, a")]
          .filter((each) => each.getClientRects().length && !each.closest(".legend"))
          .map((each) => [each.className, each.getBoundingClientRect()])
          .filter(([, {width, height}]) => Math.min(width, height) < 43.5).map(([name]) => name)"""
    )
    assert small == []


def test_nothing_moves_when_the_sentence_grows(page_of, robot):
    page = page_of("ada", size=PHONE)
    robot.show_plan()
    expect(page.page.locator(".verdict")).to_be_visible()
    places = """() => ['.stop-stop', '.verdict-approve', '#picture']
      .map((each) => document.querySelector(each).getBoundingClientRect().top)"""
    expect(page.page.locator(".status-worst .status-sentence")).to_be_visible()
    before = page.page.evaluate(places)
    page.page.evaluate(
        """() => { const box = document.querySelector('.status-sentence'); box.textContent = box.textContent.repeat(6); }"""
    )
    assert page.page.evaluate(places) == before
