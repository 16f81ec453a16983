"""Approving, rejecting and stopping from the page: what a person presses, what the broker decides, what becomes of it."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect
from processes import wait_until

from construction_twin.review.rehearsal_report import FAILED, AxisLoad, RehearsalReport

#: Longest wait for what a robot shall have done [s]; the machine may be busy with other tests.
PATIENCE_S = 60.0


def test_an_approved_plan_moves_the_arm_and_the_record_has_the_account(page_of, robot):
    page = page_of("ada")
    plan, begin = robot.show_plan(), robot.twin.copy()
    expect(page.approve_button).to_be_disabled()
    page.look()
    page.hold_approve()
    expect(page.notice).to_contain_text("accepted")
    wait_until(lambda: robot.state == "IDLE" and abs(robot.twin - begin).max() > 0.5, PATIENCE_S, "the motion")
    assert robot.verdicts == [("ada", "approved", plan.id)]
    (said,) = robot.payloads("review/ada")
    assert (said["plan_id"], said["plan_hash"], said["verdict"]) == (plan.id, plan.hash, "approved")


def test_a_press_that_is_too_short_or_too_early_approves_nothing(page_of, robot):
    page = page_of("ada")
    robot.show_plan()
    # not looked at yet
    expect(page.approve_button).to_be_disabled()
    page.look()
    # a tap
    page.approve_button.click()
    expect(page.notice).to_contain_text("released before the second was over")
    # a finger that slides away lets go too
    page.press_approve()
    page.page.mouse.move(0, 0)
    expect(page.notice).to_contain_text("released before the second was over")
    page.page.mouse.up()
    assert not robot.payloads("review")


def test_a_rejection_comes_with_its_reason(page_of, robot):
    page = page_of("ada")
    plan = robot.show_plan()
    expect(page.page.locator(".verdict-reject")).to_be_disabled()
    page.reject("the table stands elsewhere")
    expect(page.notice).to_contain_text("accepted")
    (said,) = robot.payloads("review/")
    assert (said["verdict"], said["plan_hash"]) == ("rejected", plan.hash)
    assert "the table stands elsewhere" in said["reason"]
    assert robot.state == "IDLE"


def test_a_plan_that_is_not_what_its_hash_says_cannot_be_approved(page_of, robot):
    page = page_of("ada")
    plan = robot.show_plan()
    expect(page.page.locator(".verdict")).to_be_visible()
    # one number of one waypoint is another, as a broken or a wicked program would send it
    forged = plan.to_json(200).replace(b'"positions":[[0.0', b'"positions":[[0.001', 1)
    assert forged != plan.to_json(200)
    robot.publish("plan", forged, retain=True)
    expect(page.page.locator(".verdict-unfit")).to_contain_text("not the one that its hash names")
    expect(page.approve_button).to_be_hidden()


def test_a_stop_in_the_middle_of_a_motion_stops_it_and_says_by_whom(page_of, robot):
    page = page_of("ada")
    robot.show_plan(duration=60.0)
    page.look()
    page.hold_approve()
    wait_until(lambda: robot.state == "PLAYING", PATIENCE_S, "the motion")
    page.intervene("pause")
    expect(page.stop_result).to_contain_text("Pause: carried out")
    assert robot.state == "PAUSED"
    page.intervene("resume")
    expect(page.stop_result).to_contain_text("Resume: carried out")
    page.intervene("stop")
    expect(page.stop_result).to_contain_text("Stop: carried out")
    assert robot.state == "IDLE"
    assert [topic for topic, _ in robot.heard if topic.startswith("stop")] == ["stop/ada"]
    expect(page.page.locator(".stop-not-emergency")).to_contain_text("not an emergency stop")


def test_what_lay_on_its_way_starts_nothing_and_who_looks_again_can_ask_anew(page_of, robot):
    page = page_of("ada", "?language=de")
    plan = robot.show_plan(duration=60.0)
    robot.delay = 6.0
    page.look()
    page.hold_approve()
    expect(page.notice).to_contain_text("Freigabe gilt NICHT: Was diese Seite gezeigt hatte, war schon veraltet")
    assert robot.state == "IDLE" and robot.verdicts == [] and robot.plan is plan
    expect(page.approve_button).to_be_disabled()
    robot.delay = 0.0
    page.look()
    page.hold_approve()
    wait_until(lambda: robot.state == "PLAYING", PATIENCE_S, "the motion")
    # a stop and a pause are never too old
    robot.delay = 3600.0
    page.intervene("pause")
    wait_until(lambda: robot.state == "PAUSED", PATIENCE_S, "the pause")
    page.intervene("resume")
    expect(page.stop_result).to_contain_text("Weiter gilt NICHT: Was diese Seite gezeigt hatte, war schon veraltet")
    assert robot.state == "PAUSED"
    robot.delay = 0.0
    page.intervene("resume")
    wait_until(lambda: robot.state == "PLAYING", PATIENCE_S, "the motion")
    robot.delay = 3600.0
    page.intervene("stop")
    wait_until(lambda: robot.state == "IDLE", PATIENCE_S, "the stop")
    # a wish for a plan, by whom may ask for one
    planner = page_of("pia", "?language=de").tab("plan")
    planner.locator(".plan-begin").click()
    planner.locator(".plan-ask").click()
    expect(planner.locator(".plan-answer")).to_contain_text("Die Anfrage kam zu spät an")
    robot.delay = 0.0
    planner.locator(".plan-ask").click()
    wait_until(lambda: robot.plan is not None, PATIENCE_S, "a plan")


def _overloaded(robot, plan) -> None:
    """Let the rehearsal of the plan under review fail, as where one is required."""
    report = RehearsalReport(
        state=FAILED, scene=plan.scene, axes=(AxisLoad("joint_a2", 4200.0, 0.5, 900.0, 0.5, 3000.0, True),),
        reasons=("the flange carries 240.0 kg; the arm is rated for 120.0 kg",), engine="MuJoCo 4.0.1", hash="f00d",
    )  # fmt: skip
    robot.show_rehearsal(report, f"plan {plan.id} has failed its rehearsal: {report.reasons[0]}")


def test_who_has_the_right_approves_in_spite_of_the_rehearsal_with_a_reason(page_of, robot, site):
    plan = robot.show_plan()
    _overloaded(robot, plan)
    # who may not approve may not in spite of it either
    other = page_of("pia", "?language=de")
    other.tab("verdict")
    expect(other.page.locator(".verdict-hint")).to_contain_text("Wer es kann: ada, bob, dora, pat.")
    expect(other.page.locator(".override-approve")).to_be_hidden()
    expect(other.approve_button).to_be_disabled()
    page = page_of(query="?language=de")
    page.login("dora", site.password("dora"))
    panel = page.tab("verdict")
    panel.locator(".verdict-checks summary").click()
    button = panel.locator(".override-approve")
    expect(panel.locator(".override-hint")).to_contain_text("Sagen Sie, warum")
    expect(button).to_be_disabled()
    estimate = "eine Grenze oder eine Masse ist nur geschätzt"
    panel.locator(".override select").select_option(estimate)
    panel.locator(".override input").fill("the file of the drives says so")
    # a tap is no press
    button.click()
    expect(page.notice).to_contain_text("vor Ablauf der Sekunde losgelassen")
    assert not robot.payloads("override_rehearsal")
    page.hold(button)
    expect(page.notice).to_contain_text("dora")
    assert robot.verdicts == [("dora", "approved", plan.id)]
    (said,) = robot.payloads("override_rehearsal/dora")
    assert said["reason"] == f"{estimate}: the file of the drives says so"
    assert said["rehearsal_hash"] == "f00d"
    assert not robot.payloads("review")
    expect(button).to_be_hidden()


@pytest.mark.parametrize(
    ("person", "may_act"),
    (
        ("vic", False),
        ("pia", True),
    ),
)
def test_each_account_may_do_what_the_broker_lets_it_do_and_is_told_the_rest(page_of, robot, person, may_act):
    page = page_of(person)
    robot.show_plan()
    if may_act:
        page.intervene("stop")
        expect(page.stop_result).to_contain_text("carried out")
    else:
        expect(page.page.locator(".stop-stop")).to_be_hidden()
        expect(page.page.locator(".stop-who")).to_contain_text(
            "This account cannot stop. Who can: ada, bob, dora, pat, pia."
        )
    page.page.locator(".verdict-checks summary").click()
    expect(page.page.locator(".verdict-hint")).to_contain_text(
        "This account may not approve. Who can: ada, bob, dora, pat."
    )
    expect(page.approve_button).to_be_disabled()
    plan = page.tab("plan")
    if may_act:
        plan.locator(".plan-begin").click()
        plan.locator(".plan-ask").click()
        expect(plan.locator(".plan-answer")).to_contain_text("There is a plan")
    else:
        expect(plan.locator(".plan-told")).to_have_text(
            "This account may not ask for plans. Who can: ada, bob, dora, pat, pia."
        )
        expect(plan.locator(".plan-begin")).to_be_hidden()
    assert bool(robot.payloads("stop")) == bool(robot.payloads("plan_request")) == may_act
    assert not robot.payloads("review")
    # nothing is tried to find out a right


def test_of_two_tablets_that_approve_at_once_one_wins_and_the_other_is_told(page_of, robot):
    ada, bob = page_of("ada"), page_of("bob")
    # again, with another plan, where this machine was too busy for two presses of a second at once
    for _ in range(5):
        robot.verdicts.clear()
        plan = robot.show_plan()
        for page in (ada, bob):
            page.look()
        ada.press_approve()
        bob.press_approve()
        for page in (ada, bob):
            expect(page.notice).to_be_visible()
        if not any(page.is_disturbed() for page in (ada, bob)):
            break
        for page in (ada, bob):
            page.page.mouse.up()
        wait_until(lambda: robot.state == "IDLE", PATIENCE_S, "the end of the motion")
    wait_until(lambda: robot.verdicts, PATIENCE_S, "a verdict")
    ((winner, verdict, plan_id),) = robot.verdicts
    assert (verdict, plan_id) == ("approved", plan.id)
    first, second = (ada, bob) if winner.endswith("ada") else (bob, ada)
    expect(first.notice).to_contain_text("Approval accepted")
    expect(second.notice).to_contain_text(re.compile(f"{winner} was first|NOT approved|Not approved|NOT accepted"))
    for page in (ada, bob):
        page.page.mouse.up()
    assert len(robot.verdicts) == 1


def test_another_plan_that_comes_while_the_button_is_held_is_not_approved_with_it(page_of, robot):
    page = page_of("ada")
    robot.show_plan()
    page.look()
    page.press_approve()
    second = robot.show_plan(goal=robot.twin + 0.2, source="another one")
    expect(page.page.locator(".verdict-title")).to_contain_text("another one")
    # the new one has to be looked at by itself, with the finger still down
    expect(page.approve_button).to_be_disabled()
    expect(page.notice).to_contain_text("Not approved")
    page.page.mouse.up()
    assert not robot.payloads("review")
    page.look()
    page.hold_approve()
    expect(page.notice).to_contain_text("accepted")
    assert [plan_id for _, _, plan_id in robot.verdicts] == [second.id]


def test_what_a_plan_says_is_shown_as_text_and_never_as_markup(page_of, robot):
    page = page_of("ada")
    robot.show_plan(source='<img src=x onerror="document.title=1"><b id=evil>bold</b>')
    expect(page.page.locator(".verdict-title")).to_contain_text("<b id=evil>bold</b>")
    assert page.page.locator("#evil").count() == 0
    expect(page.page).to_have_title("(1) Plan waits - construction_twin console")
