"""Goals of other planners: what a client is told and what is asked of planner and executor, through every crossing of events."""

from __future__ import annotations

import math

import pytest
from executor_bench import ROBOT

from construction_twin.core.sentences import join_sentences
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.executor import ExecutorState
from construction_twin.extensions.planners.goal_states import TABLE, Action, GoalEvent, GoalState
from construction_twin.extensions.planners.joint_tolerances import Tolerances
from construction_twin.extensions.planners.tracking import Motion, Sample
from construction_twin.extensions.planners.trajectory_goals import (
    REPLACED,
    RETRY,
    STOPPED,
    UNKNOWN_REST,
    VERDICTS,
    WITHDRAWAL,
    Accept,
    Brake,
    End,
    Ending,
    GoalPlan,
    RequestPlan,
    ResultCode,
    Status,
    TrajectoryGoal,
    TrajectoryGoals,
    Withdraw,
)

CLOSE = Tolerances.default(ROBOT, 0.01, 0.005)
PLAN = GoalPlan("plan-1", "hash-1", 2.5)
REST = (0.0,) * 6
CANCELLED = "cancelled by its client"


def goal(name: str = "a", client: str = "/move_group", motion: str = "") -> TrajectoryGoal:
    return TrajectoryGoal(name, client, CLOSE, 2.0, motion or name)


def off_by(error: float) -> Sample:
    """A sample in which the second joint is off [rad]."""
    desired = Motion(ROBOT.home, REST)
    position = tuple(q + (error if index == 1 else 0.0) for index, q in enumerate(ROBOT.home))
    return Sample(1, desired, Motion(position, REST))


class Desk:
    """The goals with planner and executor played by the test; `now` is the time [ns]."""

    def __init__(self):
        self.goals = TrajectoryGoals(ROBOT, "/kr120/review_plan")
        self.now = NANOSECONDS
        self.goals.on_execution("", ExecutorState.IDLE, "", "agree", 0, self.now)

    @property
    def state(self) -> GoalState:
        return self.goals.state

    def effects(self, kind: type | None = None) -> list:
        return [effect for effect in self.goals.pop_effects() if kind is None or isinstance(effect, kind)]

    def end(self) -> End:
        ends = self.effects(End)
        assert len(ends) == 1
        return ends[0]

    def send(self, *goals: TrajectoryGoal) -> Desk:
        for each in goals:
            self.goals.on_goal(each, self.now)
        return self

    def planned(self, plan: GoalPlan = PLAN) -> Desk:
        self.goals.on_planned(plan, self.now)
        return self

    def executes(
        self, state: ExecutorState, outcome: str = "", reason: str = "as approved", plan: str = PLAN.id, start: int = 0
    ) -> Desk:
        self.goals.on_execution(plan, state, outcome, reason, start, self.now)
        return self

    def rejects(self, reviewer: str = "Anna", reason: str = "too close to the wall", plan: str = PLAN.id) -> Desk:
        self.goals.on_verdict(plan, False, reviewer, reason, self.now)
        return self

    def after(
        self, seconds: float, sample: Sample | None = None, at_rest: bool = False, settled: bool | None = None
    ) -> Desk:
        """Let time pass; where the twin rests, the arm's pose answers to a command since then, unless `settled` is given."""
        self.now += int(seconds * NANOSECONDS)
        self.goals.tick(self.now, sample, at_rest, at_rest if settled is None else settled)
        return self

    def under_review(self) -> Desk:
        self.send(goal()).planned().effects()
        return self

    def moving(self) -> Desk:
        self.under_review().executes(ExecutorState.PLAYING).effects()
        return self

    def cancel(self, name: str = "a") -> Desk:
        self.goals.on_cancel(name, self.now)
        return self


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_every_action_of_the_table_is_carried_out():
    assert {row.action for row in TABLE} == set(Action)
    assert {row.event for row in TABLE} == set(GoalEvent) and {row.state for row in TABLE} == set(GoalState)


class TestToTheGoal:
    def test_a_goal_is_planned_reviewed_executed_and_succeeds(self, desk):
        assert desk.send(goal()).effects() == [RequestPlan(goal())]
        (accepted,) = desk.planned().effects()
        assert accepted == Accept(
            "a", "plan plan-1 of 2.500 s waits for approval; a person gives or refuses it by /kr120/review_plan"
        )
        desk.goals.on_verdict(PLAN.id, True, "Anna", "", desk.now)
        assert desk.effects() == [Status("a", "plan plan-1 was approved by Anna")]
        desk.executes(ExecutorState.PLAYING, reason="approved by Anna")
        assert desk.effects() == [Status("a", "PLAYING: approved by Anna")]
        assert desk.after(2.5, off_by(0.5)).effects() == []
        desk.executes(ExecutorState.IDLE, "finished", "goal reached").after(0.02, off_by(0.5))
        assert desk.state is GoalState.SETTLING and desk.effects() == []
        # the last setpoint is sent, and the twin has not shown yet that it is there
        assert desk.after(0.02, off_by(0.0)).effects() == []
        end = desk.after(0.02, off_by(0.009), at_rest=True).end()
        assert (end.goal_id, end.ending, end.code) == ("a", Ending.SUCCEEDED, ResultCode.SUCCESSFUL)
        assert desk.state is GoalState.FREE and desk.goals.goal is None

    def test_a_motion_that_takes_longer_than_asked_says_so(self, desk):
        why = "point 1: joint_a1 has a jerk of 9 rad/s^3; its limit is 5 rad/s^3"
        (accepted,) = desk.send(goal()).planned(GoalPlan("p", "h", 3.5, 2.5, why)).effects(Accept)
        assert accepted.text.startswith("plan p of 3.500 s instead of 2.500 s waits for approval")
        assert accepted.text.endswith(f"; timed anew, because {why}")
        desk = Desk().send(goal()).planned(GoalPlan("p", "h", 2.5, 2.5, why))
        (accepted,) = desk.effects(Accept)
        assert accepted.text.startswith("plan p of 2.500 s waits") and f"timed anew, because {why}" in accepted.text
        desk = Desk().send(goal()).planned(GoalPlan("p", "h", 2.5000001, 2.5))
        assert desk.effects(Accept)[0].text.startswith("plan p of 2.500 s waits for approval; a")

    def test_what_the_planner_refuses_is_an_invalid_goal_in_its_words(self, desk):
        desk.send(goal()).effects()
        desk.goals.on_not_planned("point 0: joint_a1 is 0.2 rad, but the arm is at 0 rad", desk.now)
        assert desk.end() == End(
            "a", Ending.REJECTED, ResultCode.INVALID_GOAL, "point 0: joint_a1 is 0.2 rad, but the arm is at 0 rad"
        )
        assert desk.state is GoalState.FREE

    def test_a_rejection_is_the_reviewer_s_sentence(self, desk):
        assert desk.under_review().rejects().end() == End(
            "a",
            Ending.ABORTED,
            ResultCode.INVALID_GOAL,
            "plan plan-1 was rejected by Anna: too close to the wall",
        )

    def test_a_plan_that_the_executor_withdraws_ends_its_goal(self, desk):
        end = desk.under_review().rejects("executor", "replaced by plan plan-2").end()
        assert end.code is ResultCode.INVALID_GOAL
        assert end.sentence == "plan plan-1 was withdrawn by the executor: replaced by plan plan-2"

    def test_verdicts_and_executions_of_other_plans_change_nothing(self, desk):
        desk.under_review().rejects(plan="other").executes(ExecutorState.PLAYING, plan="other")
        desk.executes(ExecutorState.IDLE, "finished", plan="other")
        assert desk.state is GoalState.REVIEW and desk.effects() == []

    def test_verdict_and_start_may_be_heard_before_the_planner_s_answer(self):
        desk = Desk().send(goal()).executes(ExecutorState.PLAYING).planned()
        assert desk.state is GoalState.MOVING
        desk = Desk().send(goal()).rejects().planned()
        assert desk.end().code is ResultCode.INVALID_GOAL and desk.state is GoalState.FREE

    def test_the_start_that_is_heard_before_the_planner_s_answer_is_kept(self):
        desk = Desk().send(goal()).executes(ExecutorState.PLAYING, start=7)
        assert desk.goals.plan_start == 0
        assert desk.planned().goals.plan_start == 7
        desk.executes(ExecutorState.PLAYING, plan="other", start=9)
        assert desk.goals.plan_start == 0

    def test_verdicts_on_other_plans_do_not_cover_the_one_that_is_heard_too_early(self):
        desk = Desk().send(goal()).rejects()
        for other in range(VERDICTS - 1):
            desk.rejects(plan=f"other-{other}")
        end = desk.planned().end()
        assert end.code is ResultCode.INVALID_GOAL and "rejected by Anna" in end.sentence
        desk = Desk().send(goal()).rejects()
        for other in range(VERDICTS):
            desk.rejects(plan=f"other-{other}")
        assert desk.planned().state is GoalState.REVIEW

    @pytest.mark.parametrize(
        ("outcome", "code"),
        [
            ("held", ResultCode.PATH_TOLERANCE_VIOLATED),
            ("stopped", ResultCode.GOAL_TOLERANCE_VIOLATED),
            ("dropped", ResultCode.GOAL_TOLERANCE_VIOLATED),
        ],
    )
    def test_an_execution_that_ends_early_aborts_with_its_reason(self, desk, outcome, code):
        end = desk.moving().executes(ExecutorState.IDLE, outcome, "the gate holds (HOLDING)").end()
        assert (end.ending, end.code) == (Ending.ABORTED, code)
        assert end.sentence == f"plan plan-1 ended as {outcome}: the gate holds (HOLDING)"

    def test_an_executor_that_was_restarted_plays_nothing(self, desk):
        end = desk.moving().executes(ExecutorState.WAITING, reason="started", plan="").end()
        assert end.code is ResultCode.GOAL_TOLERANCE_VIOLATED
        assert end.sentence == "the executor no longer plays plan plan-1: started"

    def test_another_plan_that_begins_while_the_arm_settles_ends_the_goal(self, desk):
        desk.moving().executes(ExecutorState.IDLE, "finished").effects()
        end = desk.executes(ExecutorState.PLAYING, reason="approved by Anna", plan="plan-2").end()
        assert (end.ending, end.code) == (Ending.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED)
        assert end.sentence == "the executor no longer plays plan plan-1: approved by Anna"
        assert desk.state is GoalState.FREE

    def test_a_pause_is_told_and_ends_nothing(self, desk):
        told = desk.moving().executes(ExecutorState.PAUSED, reason="pause requested").effects()
        assert told == [Status("a", "PAUSED: pause requested")] and desk.state is GoalState.MOVING


class TestTolerances:
    @pytest.mark.parametrize(("error", "late"), [(0.02, 2.1), (math.nan, 2.1)])
    def test_an_arm_that_is_not_at_the_goal_in_time_has_violated_its_tolerance(self, desk, error, late):
        desk.moving().executes(ExecutorState.IDLE, "finished")
        assert desk.after(1.9, off_by(error), at_rest=True).effects() == []
        end = desk.after(late - 1.9, off_by(error), at_rest=True).end()
        assert (end.ending, end.code) == (Ending.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED)
        assert end.sentence.startswith("2 s after the plan's end the position of joint_a2 is off by ")

    def test_an_arm_that_comes_late_but_in_time_succeeds(self, desk):
        desk.moving().executes(ExecutorState.IDLE, "finished").after(1.5, off_by(0.5), at_rest=True)
        assert desk.after(0.4, off_by(0.0), at_rest=True).end().ending is Ending.SUCCEEDED

    def test_an_arm_that_still_answers_to_the_motion_is_not_at_the_goal(self, desk):
        desk.moving().executes(ExecutorState.IDLE, "finished")
        assert desk.after(0.1, off_by(0.0), at_rest=True, settled=False).effects() == []
        assert desk.state is GoalState.SETTLING
        assert desk.after(0.1, off_by(0.0), at_rest=True).end().ending is Ending.SUCCEEDED

    def test_an_arm_that_never_answers_is_aborted(self, desk):
        desk.moving().executes(ExecutorState.IDLE, "finished")
        end = desk.after(2.1, off_by(0.0), at_rest=True, settled=False).end()
        assert (end.ending, end.code) == (Ending.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED)
        assert end.sentence == "2 s after the plan's end twin and arm are not known to be at rest"

    def test_a_pose_that_is_not_known_is_no_success(self, desk):
        desk.moving().executes(ExecutorState.IDLE, "finished")
        assert desk.after(2.1, None, at_rest=True).end().code is ResultCode.GOAL_TOLERANCE_VIOLATED


class TestCancel:
    def test_while_moving_brakes_on_the_path_and_is_preempted_at_rest(self, desk):
        brake, told = desk.moving().cancel().effects()
        assert brake == Brake(PLAN.id) and told.text == f"{CANCELLED}; brakes on the path"
        desk.executes(ExecutorState.STOPPING, reason="stop requested").executes(
            ExecutorState.IDLE, "stopped", "at rest"
        )
        assert desk.after(0.02).effects() == []
        end = desk.after(0.02, at_rest=True).end()
        assert (end.ending, end.sentence) == (
            Ending.CANCELED,
            join_sentences(CANCELLED, "the arm is at rest on its path", "at rest"),
        )

    def test_a_stop_that_failed_is_asked_for_again_until_it_brakes(self, desk):
        desk.moving().cancel().effects()
        desk.goals.on_call_failed(desk.now)
        assert desk.after(0.9 * RETRY / NANOSECONDS).effects() == []
        assert desk.after(0.2 * RETRY / NANOSECONDS).effects() == [Brake(PLAN.id)]
        assert desk.after(10.0).effects() == []

    def test_under_review_the_plan_is_withdrawn(self, desk):
        withdraw, _told = desk.under_review().cancel().effects()
        assert withdraw == Withdraw(PLAN.id, PLAN.hash, "/move_group", CANCELLED)
        end = desk.rejects("client /move_group", CANCELLED).end()
        assert (end.ending, end.sentence) == (Ending.CANCELED, CANCELLED)
        assert desk.after(0.02, at_rest=True).effects() == [] and desk.state is GoalState.FREE

    def test_a_withdrawal_that_the_executor_did_not_take_is_repeated_and_ends_after_a_while(self, desk):
        desk.under_review().cancel().effects()
        desk.goals.on_call_failed(desk.now)
        assert len(desk.after(RETRY / NANOSECONDS).effects(Withdraw)) == 1
        end = desk.after(WITHDRAWAL / NANOSECONDS + 0.1).end()
        assert end.ending is Ending.CANCELED
        assert end.sentence == f"{CANCELLED}; the executor does not say that plan plan-1 is withdrawn: reject it"

    def test_an_approval_that_crosses_the_withdrawal_is_stopped(self, desk):
        desk.under_review().cancel().effects()
        assert desk.executes(ExecutorState.PLAYING).effects(Brake) == [Brake(PLAN.id)]
        desk.executes(ExecutorState.IDLE, "stopped")
        assert desk.after(0.02, at_rest=True).end().ending is Ending.CANCELED

    def test_while_planned_is_recalled_at_once_and_the_plan_withdrawn(self, desk):
        assert desk.send(goal()).cancel().end().ending is Ending.CANCELED
        assert desk.planned().effects() == [Withdraw(PLAN.id, PLAN.hash, "/move_group", CANCELLED)]
        assert desk.rejects().after(0.02, at_rest=True).effects() == [] and desk.state is GoalState.FREE

    def test_while_planned_and_no_plan_comes(self, desk):
        desk.send(goal()).cancel().effects()
        desk.goals.on_not_planned("no path", desk.now)
        assert desk.after(0.02, at_rest=True).effects() == [] and desk.state is GoalState.FREE

    def test_a_twin_that_is_never_seen_at_rest_holds_nobody_up_for_ever(self, desk):
        desk.moving().cancel().send(goal("b")).executes(ExecutorState.IDLE, "stopped").effects()
        assert desk.after(STOPPED / NANOSECONDS - 0.1).effects() == [] and desk.state is GoalState.STOPPED
        first, waiting = desk.after(0.2).effects(End)
        assert (first.goal_id, first.ending) == ("a", Ending.CANCELED)
        assert first.sentence == join_sentences(CANCELLED, UNKNOWN_REST, "as approved")
        assert (waiting.goal_id, waiting.ending) == ("b", Ending.CANCELED)
        assert waiting.sentence.startswith(f"not planned: {UNKNOWN_REST};")
        assert desk.state is GoalState.FREE and desk.after(1.0, at_rest=True).effects() == []

    def test_of_a_goal_that_has_ended_changes_nothing(self, desk):
        assert desk.moving().cancel("other").effects() == [] and desk.state is GoalState.MOVING


class TestAnotherGoal:
    def test_of_another_client_is_turned_away_naming_who_has_the_arm(self, desk):
        end = desk.moving().send(goal("b", "/matlab")).end()
        assert (end.goal_id, end.ending, end.code) == ("b", Ending.REJECTED, ResultCode.INVALID_GOAL)
        assert end.sentence.startswith("/move_group has the arm (goal of /move_group is MOVING, plan plan-1);")
        assert desk.state is GoalState.MOVING

    @pytest.mark.parametrize("state", [state for state in GoalState if state is not GoalState.FREE])
    def test_of_another_client_is_turned_away_in_every_state(self, state):
        desk = reach(state)
        assert desk.send(goal("b", "/matlab")).end().goal_id == "b" and desk.state is state

    @pytest.mark.parametrize("state", [state for state in GoalState if state is not GoalState.FREE])
    def test_of_the_same_client_is_planned_when_the_arm_is_at_rest(self, state):
        desk = reach(state)
        ends = []
        desk.send(goal("b"), goal("c"))
        for _ in range(3):
            effects = desk.effects()
            ends += [effect.goal_id for effect in effects if isinstance(effect, End)]
            asked = [effect.goal.id for effect in effects if isinstance(effect, RequestPlan)]
            if asked:
                break
            if desk.state is GoalState.DISCARDING:
                desk.goals.on_not_planned("cancelled", desk.now)
            elif desk.state is GoalState.WITHDRAWING:
                desk.rejects("client /move_group", "replaced")
            elif desk.state is GoalState.BRAKING:
                desk.executes(ExecutorState.IDLE, "stopped")
            assert [effect for effect in desk.after(0.02).effects() if isinstance(effect, RequestPlan)] == []
            desk.after(0.02, at_rest=True)
        assert asked == ["c"] and "b" in ends and desk.state is GoalState.PLANNING
        assert desk.goals.goal.id == "c"

    def test_of_the_same_motion_keeps_the_place_in_the_review(self, desk):
        desk.send(goal())
        for name, before in (("b", "a"), ("c", "b")):
            end = desk.send(goal(name, motion="a")).end()
            assert end == End(before, Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, REPLACED)
        assert desk.planned().effects(Accept)[0].goal_id == "c"
        end, accepted = desk.send(goal("d", motion="a")).effects()
        assert (end.goal_id, end.ending, end.sentence) == ("c", Ending.CANCELED, REPLACED)
        assert accepted.goal_id == "d" and "plan-1 of 2.500 s waits for approval" in accepted.text
        # once it is approved, another goal is another wish
        assert desk.executes(ExecutorState.PLAYING).state is GoalState.MOVING
        assert desk.send(goal("e", motion="a")).effects(Brake) == [Brake(PLAN.id)]

    def test_while_moving_the_old_goal_ends_before_the_new_one_is_planned(self, desk):
        desk.moving().send(goal("b"))
        assert desk.effects(Brake) == [Brake(PLAN.id)]
        desk.executes(ExecutorState.IDLE, "stopped", "at rest")
        end, ask = desk.after(0.02, at_rest=True).effects()
        assert (end.goal_id, end.ending) == ("a", Ending.CANCELED) and end.sentence == join_sentences(
            REPLACED, "the arm is at rest on its path", "at rest"
        )
        assert ask == RequestPlan(goal("b"))

    def test_that_waits_can_be_cancelled(self, desk):
        desk.moving().send(goal("b")).effects()
        assert desk.cancel("b").end() == End(
            "b", Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, "cancelled before it was planned"
        )
        desk.executes(ExecutorState.IDLE, "stopped").after(0.02, at_rest=True)
        assert desk.end().goal_id == "a" and desk.state is GoalState.FREE

    def test_while_a_plan_of_somebody_else_is_played_is_rejected(self, desk):
        end = desk.executes(ExecutorState.PLAYING, plan="by-hand").send(goal()).end()
        assert end.code is ResultCode.INVALID_GOAL
        assert end.sentence == "the arm follows plan by-hand, of no goal of this action; wait for its end"
        assert desk.executes(ExecutorState.IDLE, "finished", plan="by-hand").send(goal()).effects() == [
            RequestPlan(goal())
        ]


class TestStandStill:
    def test_no_points_cancel_the_goals_of_the_same_client(self, desk):
        desk.moving().send(goal("b")).effects()
        desk.goals.on_stand_still(goal("c"), desk.now)
        accepted, end_b, end_c = desk.effects()
        assert (accepted.goal_id, end_b.goal_id, end_b.ending) == ("c", "b", Ending.CANCELED)
        assert (end_c.goal_id, end_c.ending) == ("c", Ending.SUCCEEDED) and desk.state is GoalState.BRAKING

    def test_no_points_and_nothing_to_stop_is_an_invalid_goal(self, desk):
        desk.moving()
        desk.goals.on_stand_still(goal("c", "/matlab"), desk.now)
        end = desk.end()
        assert (end.goal_id, end.ending, end.code) == ("c", Ending.REJECTED, ResultCode.INVALID_GOAL)
        assert desk.state is GoalState.MOVING


def reach(state: GoalState) -> Desk:
    """Return a desk whose goal `a` of /move_group is in a state; its effects are taken."""
    desk = Desk()
    ways = {
        GoalState.PLANNING: lambda: desk.send(goal()),
        GoalState.DISCARDING: lambda: desk.send(goal()).cancel(),
        GoalState.REVIEW: desk.under_review,
        GoalState.WITHDRAWING: lambda: desk.under_review().cancel(),
        GoalState.MOVING: desk.moving,
        GoalState.BRAKING: lambda: desk.moving().cancel(),
        GoalState.STOPPED: lambda: desk.moving().cancel().executes(ExecutorState.IDLE, "stopped"),
        GoalState.SETTLING: lambda: desk.moving().executes(ExecutorState.IDLE, "finished"),
    }
    ways[state]()
    assert desk.state is state
    desk.effects()
    return desk
