"""A recorded run in the picture: played as it was recorded, said to be none of the present, and gone when the present asks."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator

import numpy as np
import pytest
from console_page import ConsolePage
from evaluation_samples import BASE, run
from playwright.sync_api import expect

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.recording import RecordedVerdict, StateChange
from construction_twin.evaluation.replay import FILE, replay_of
from construction_twin.evaluation.summary import evaluate, summarise

SMALL, PHONE = (1000, 800), (390, 844)
NAME, BROKEN = "20260101_run", "20260102_broken"
_FINE = 2e-5


def at(seconds: float) -> int:
    return BASE + round(seconds * NANOSECONDS)


@pytest.fixture(scope="module")
def recording():
    """A reach of four seconds whose arm was off, so that the gate held, between two seconds of rest."""
    changes = (
        StateChange(at(0.1), "gate", "IN_SYNC", ""),
        StateChange(at(1.0), "execution", "PLAYING", ""),
        StateChange(at(3.5), "gate", "HOLDING", "joint_a1 is 0.02 rad off"),
    )
    verdicts = (RecordedVerdict(at(0.9), "p1", True, "ada", ""),)
    made = run(duration=4.0, error=np.array([0.0, 0.0, 0.003, 0.0, 0.0, 0.0]), mock={"config": {}})
    return dataclasses.replace(made, robot="/one", changes=changes, verdicts=verdicts)


@pytest.fixture
def results(site, recording) -> Iterator[None]:
    """The console's folder holds a run that can be played, and one whose file is none."""
    evaluation = evaluate(recording)
    good = json.dumps(replay_of(evaluation, summarise(evaluation)))
    for number, (name, text) in enumerate(((NAME, good), (BROKEN, good[:-200])), 1):
        folder = site.results / name
        folder.mkdir(exist_ok=True)
        (folder / "report.html").write_text(f"<!doctype html><title>{name}</title><h1>Report of {name}</h1>")
        os.utime(folder / "report.html", (1_790_000_000 + number,) * 2)
        (folder / FILE).write_text(text)
    yield
    for name in (NAME, BROKEN):
        (site.results / name / FILE).unlink()
        (site.results / name / "report.html").unlink()


def begin(page: ConsolePage, name: str = NAME) -> None:
    """Open the list of runs and press the button of one."""
    page.tab("runs")
    page.page.get_by_role("button", name=f"Show the run {name} in the picture").click()


def seek(page: ConsolePage, seconds: float) -> None:
    slider = page.page.locator(".replay-slider")
    slider.evaluate(
        "(it, value) => { it.value = value; it.dispatchEvent(new Event('input', {bubbles: true})); }", str(seconds)
    )


def test_a_recorded_run_is_replayed_in_the_picture_with_its_errors_marks_and_report(page_of, robot, results, recording):
    page = page_of("reviewer-ada", picture=True, size=SMALL)
    page.wait_drawn("one", "it.twin.joints !== null")
    begin(page)
    notice = page.page.locator(".replay-notice")
    expect(notice).to_contain_text("RECORDING, NOT THE PRESENT")
    expect(notice).to_contain_text(NAME)
    # what is drawn is the recording, to its own rounding
    seek(page, 3.0)
    drawn = page.wait_drawn("one", "it.replay !== null && Math.abs(it.replay - 3.0) < 1e-6")
    row = recording.twin.positions[750].copy()
    # the sample's second joint is beyond the arm's range, at which a model stops
    row[1] = np.radians(-5.0)
    assert np.allclose(list(drawn["twin"]["joints"].values()), row, atol=_FINE)
    assert np.allclose(drawn["twin"]["tool"], robot.tool(row), atol=1e-4)
    assert drawn["arm"]["joints"] is not None and drawn["goal"]["joints"] is None
    # the arm lags behind: joint_a6 moves the most
    expect(page.page.locator(".replay-clock")).to_contain_text("Largest error: joint_a6")
    seek(page, 3.6)
    expect(page.page.locator(".replay-mark")).to_contain_text("HOLDING (joint_a1 is 0.02 rad off)")
    page.page.get_by_role("button", name="Mark before").click()
    page.page.get_by_role("button", name="Mark before").click()
    page.page.get_by_role("button", name="Mark before").click()
    expect(page.page.locator(".replay-mark")).to_contain_text("approved by ada")
    largest = summarise(evaluate(recording))["tables"]["by_command"]["joint_a6"]["max_rad"]
    expect(page.page.locator(".replay-report")).to_contain_text(f"{largest:.2e}".replace("e-0", "e-"))
    # it plays by itself
    page.page.locator(".replay-speed").select_option("4")
    page.page.locator(".replay-play").click()
    page.wait_drawn("one", "it.replay > 3.4")
    # and the report opens in a tab of its own, in its sandbox
    with page.context.expect_page() as opened:
        page.page.get_by_role("link", name="Whole report").click()
    expect(opened.value.get_by_role("heading")).to_have_text(f"Report of {NAME}")
    page.page.get_by_role("button", name="Back to the present").click()
    drawn = page.wait_drawn("one", f"it.replay === null && Math.abs(it.twin.joints.joint_a1 - {robot.twin[0]}) < 1e-6")
    expect(notice).to_be_hidden()


def test_a_plan_that_waits_ends_a_replay_at_once_and_only_the_present_is_approved(page_of, robot, results):
    page = page_of("reviewer-ada", picture=True, size=SMALL)
    page.wait_drawn("one", "it.twin.joints !== null")
    begin(page)
    page.wait_drawn("one", "it.replay !== null")
    stop = page.page.get_by_label("Stop one")
    expect(stop).to_be_visible()
    plan = robot.show_plan(duration=0.5)
    page.wait_drawn("one", "it.replay === null && it.path !== null")
    expect(page.page.locator(".replay-told")).to_contain_text("a plan waits for its review")
    expect(page.page.locator(".replay-notice")).to_be_hidden()
    # and while it waits no recording comes back
    begin(page)
    expect(page.page.locator(".replay-told")).to_contain_text("a plan waits for its review")
    assert page.drawn("one")["replay"] is None
    page.play_to_end()
    page.hold_approve()
    assert robot.verdicts == [("one-reviewer-ada", "approved", plan.id)]


def test_a_hold_ends_a_replay_and_stop_goes_out_from_one(page_of, robot, results):
    page = page_of("reviewer-ada", picture=True, size=SMALL)
    page.wait_drawn("one", "it.twin.joints !== null")
    begin(page)
    page.wait_drawn("one", "it.replay !== null")
    page.page.get_by_label("Stop one").click()
    expect(page.stop_result).to_contain_text("Stop: carried out")
    robot.arm_error = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    page.wait_drawn(
        "one", "it.replay === null && Math.abs(it.arm.joints.joint_a1 - it.twin.joints.joint_a1 - 0.05) < 1e-6"
    )
    expect(page.page.locator(".replay-told")).to_contain_text("the arm holds")
    # looked at again while it holds, the notice says so
    begin(page)
    expect(page.page.locator(".replay-notice-now")).to_contain_text("NOW: the arm holds")
    robot.arm_error = np.zeros(6)


def test_a_broken_file_is_refused_in_german_and_a_phone_says_that_it_is_a_recording(page_of, robot, results):
    page = page_of("viewer-vic", picture=True, size=PHONE, query="?language=de")
    page.wait_drawn("one", "it.twin.joints !== null")
    page.tab("runs")
    page.page.get_by_role("button", name=f"Den Lauf {BROKEN} im Bild zeigen").click()
    expect(page.page.locator(".replay-told")).to_contain_text("beschädigt oder keine Aufzeichnung")
    assert page.drawn("one")["replay"] is None
    page.page.get_by_role("button", name=f"Den Lauf {NAME} im Bild zeigen").click()
    expect(page.page.locator(".replay-notice")).to_contain_text("AUFZEICHNUNG, NICHT DER JETZIGE STAND")
    # nothing stands beside the screen
    assert page.page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]


def test_without_a_login_no_recording_is_given(page_of, results, site):
    page = page_of()
    answer = page.page.evaluate(f"fetch('private/runs/{NAME}/replay.json').then(({{status}}) => status)")
    assert answer == 403
