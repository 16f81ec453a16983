"""Work from a building model beside its picture: the tasks in view, an element leads to its task and a task to its element."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest
from console_page import ConsolePage
from playwright.sync_api import Locator, expect
from scripted_robot import ScriptedRobot

from construction_twin.extensions.work.loaded_model import ElementFacts, glb
from construction_twin.kinematics.chain import Pose

#: Of `view` [s]: software draws each.
SLOW = 0.2
HASH = "5e" * 32
COUNT = 14
WIDE, NARROW = (1280, 800), (390, 844)
#: The colour of the element that is worked on, as web/src/picture/colours.js has it.
PICKED = 0xFF4FD8
_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box(size: float) -> np.ndarray:
    """Return the triangles of a cube around the origin."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
    return np.array([corners[list(three)] for a, b, c, d in _FACES for three in ((a, b, c), (a, c, d))])


def building() -> bytes:
    """Return a ring of cubes on the floor around the arm, and a task's element each."""
    elements = {}
    for number in range(COUNT):
        angle = 2 * np.pi * number / COUNT
        place = np.array([1.7 * np.cos(angle), 1.7 * np.sin(angle), 0.2])
        facts = ElementFacts(f"Beam {number + 1}", (), Pose(place, np.eye(3)), box(0.35))
        elements[f"beam-{number + 1}"] = facts
    return glb(elements, HASH)


def tasks() -> bytes:
    rows = [
        {"id": str(k), "name": f"Place stud {k} of the wall along axis B", "element": f"beam-{k}", "element_name": f"Beam {k}",
         "state": state, "reason": "", "after": [], "question": "Is it in the grip?" if state == "asks" else ""}
        for k, state in enumerate(("done", "ready", "asks", *["waiting"] * (COUNT - 3)), 1)
    ]  # fmt: skip
    return json.dumps(
        {"v": 1, "robot": "one", "model": "wall", "model_hash": HASH, "schedule": "agreed", "next": "1", "engaged": False,
         "reason": "", "notes": [], "tasks": rows}
    ).encode()  # fmt: skip


@pytest.fixture
def robot(site) -> Iterator[ScriptedRobot]:
    """Robot `one`, with a building model and its tasks."""
    file = site.private / "one" / "building.glb"
    file.write_bytes(building())
    with site.robot(period=SLOW) as started:
        started.publish("work/tasks", tasks(), retain=True)
        yield started
        started.publish("work/tasks", b"", retain=True)
    file.unlink()


def colour_of(drawn: dict, element: str) -> int:
    return dict(drawn["elements"])[element]


def tap(page: ConsolePage, element: str) -> None:
    """Tap an element where the picture has it."""
    stage = page.page.locator(".overlay").first.bounding_box()
    assert stage is not None
    x, y = page.drawn("one")["places"][element]
    page.page.mouse.click(stage["x"] + x * stage["width"], stage["y"] + y * stage["height"])


def task(page: ConsolePage, number: int) -> Locator:
    return page.page.locator(".task").nth(number - 1)


def expect_reachable(page: ConsolePage, each: Locator) -> None:
    """Expect that somebody can see an element and press it: in view and under nothing else."""
    expect(each).to_be_in_viewport(ratio=0.99)
    assert each.evaluate("""(it) => { const {x, y, width, height} = it.getBoundingClientRect();
        return it.contains(document.elementFromPoint(x + width / 2, y + height / 2)); }""")


def in_view(place: list[float]) -> bool:
    return all(0 < value < 1 for value in place)


@pytest.mark.parametrize("size", (WIDE, NARROW), ids=lambda size: f"{size[0]}x{size[1]}")
def test_an_element_leads_to_its_task_and_a_task_to_its_element(page_of, robot, size):
    page = page_of("ada", size=size, picture=True)
    page.wait_drawn("one", f"it.elements.length === {COUNT}")
    panel, verdict = page.page.locator("#tasks"), page.page.locator("#verdict")
    if size is WIDE:
        expect(page.page.locator(".tab-tasks")).to_be_hidden()
        expect_reachable(page, task(page, 1))
    else:
        expect(panel).to_be_hidden()
    expect(verdict).to_be_visible()
    # from the picture to the list: the last one, which nobody sees without scrolling where there is little room
    page.wait_frame()
    tap(page, f"beam-{COUNT}")
    expect(task(page, COUNT)).to_have_attribute("aria-pressed", "true")
    expect_reachable(page, task(page, COUNT))
    expect(panel.locator(".tasks-detail")).to_contain_text(f"Beam {COUNT}")
    if size is WIDE:
        expect(verdict).to_be_visible()
    else:
        expect(page.page.locator(".tab-tasks")).to_have_attribute("aria-selected", "true")
        expect(verdict).to_be_hidden()
    drawn = page.drawn("one")
    assert colour_of(drawn, f"beam-{COUNT}") == PICKED and colour_of(drawn, "beam-1") != PICKED
    # from the list to the picture, which shows something else
    page.page.locator(".tool-tool").click()
    drawn = page.wait_drawn("one", "it.camera.chosen === 'tool'")
    far = next(k for k in range(1, COUNT + 1) if not in_view(drawn["places"][f"beam-{k}"]))
    task(page, far).click()
    drawn = page.wait_drawn("one", f"it.words.includes('Beam {far}')")
    assert in_view(drawn["places"][f"beam-{far}"])
    assert colour_of(drawn, f"beam-{far}") == PICKED and colour_of(drawn, f"beam-{COUNT}") != PICKED
    # what is in view already is marked where it is
    camera = drawn["camera"]
    others = (k for k in range(1, COUNT + 1) if k not in (far, COUNT))
    near = next(k for k in others if all(0.25 < value < 0.75 for value in drawn["places"][f"beam-{k}"]))
    task(page, near).click()
    drawn = page.wait_drawn("one", f"it.words.includes('Beam {near}')")
    assert drawn["camera"] == camera and colour_of(drawn, f"beam-{near}") == PICKED


@pytest.mark.parametrize("size", (WIDE, NARROW), ids=lambda size: f"{size[0]}x{size[1]}")
def test_the_tasks_scroll_in_one_place_and_the_page_not_at_all(page_of, robot, size):
    page = page_of("ada", "?language=de", size=size)
    page.tab("tasks")
    expect(page.page.locator(".task")).to_have_count(COUNT)
    task(page, 3).click()
    found = page.page.evaluate("""() => {
        const scrolls = (it) => /auto|scroll/.test(getComputedStyle(it).overflowY);
        const inside = [...document.querySelectorAll("#tasks *")].filter(scrolls).map((it) => it.className);
        const {scrollWidth, scrollHeight} = document.documentElement;
        // the panel cuts off what is wider than it
        const {right} = document.querySelector("#tasks").getBoundingClientRect();
        const isCut = (it) => it.getBoundingClientRect().right > right;
        const cut = [...document.querySelectorAll("#tasks *")].filter(isCut).map((it) => it.className);
        return {inside, page: [scrollWidth, scrollHeight], cut};
    }""")
    assert found == {"inside": [], "page": list(size), "cut": []}


def test_a_tab_that_gets_a_place_of_its_own_leaves_the_others_theirs(page_of, robot):
    """A tablet that is turned: what stood in the tabs' place before the tasks stands there again."""
    page = page_of("ada", size=(800, 1280))
    page.tab("motion")
    page.tab("tasks")
    expect(page.page.locator("#motion")).to_be_hidden()
    page.page.set_viewport_size({"width": 1280, "height": 800})
    for name in ("tasks", "motion"):
        expect(page.page.locator(f"#{name}")).to_be_visible()
    expect(page.page.locator(".tab-motion")).to_have_attribute("aria-selected", "true")
    page.page.set_viewport_size({"width": 1920, "height": 1080})
    for name in ("tasks", "motion", "verdict"):
        expect(page.page.locator(f"#{name}")).to_be_visible()


def test_the_menu_closes_on_a_press_outside_and_on_escape(page_of, robot):
    page = page_of("ada", size=NARROW)
    opener, items = page.page.locator(".menu > summary"), page.page.locator(".menu-items")
    for close in (
        lambda: page.page.locator("#status").click(position={"x": 5, "y": 5}),
        lambda: page.page.locator(".stage").dispatch_event("pointerdown"),
        lambda: page.page.keyboard.press("Escape"),
        opener.click,
    ):
        opener.click()
        expect(items).to_be_visible()
        # a press inside is none outside
        items.click(position={"x": 4, "y": 4})
        expect(items).to_be_visible()
        close()
        expect(items).to_be_hidden()
    # the keyboard goes on where it was
    opener.focus()
    page.page.keyboard.press("Enter")
    expect(items).to_be_visible()
    page.page.keyboard.press("Tab")
    page.page.keyboard.press("Escape")
    expect(items).to_be_hidden()
    expect(opener).to_be_focused()
    # and what is chosen in it is still done
    opener.click()
    items.locator("button").first.click()
    expect(page.page.locator("html")).to_have_attribute("lang", "de")
