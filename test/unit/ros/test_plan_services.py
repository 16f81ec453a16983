"""What is asked of the services that make plans, by the command line as by a console, and what is read of their answers."""

from __future__ import annotations

import rospy
from construction_twin.srv import PlanToPose, PlanToPoseRequest, ReviewPlan

from construction_twin.link.requests import GOALS, GoalRequest, ReviewRequest
from construction_twin.ros.messages.services import PLAN_SERVICES, Outcome, request_fields


def test_every_kind_of_request_has_a_service_that_takes_its_fields():
    assert {*GOALS, "csv"} == set(PLAN_SERVICES)
    for kind, service in PLAN_SERVICES.items():
        asked = GoalRequest(kind, position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 0.0, 1.0))
        rospy.ServiceProxy(service.name, service.kind).request_class(
            **service.fields(asked, source="ada", asked="c0ffee00-7")
        )


def test_a_field_reaches_the_services_field_of_its_name_and_a_goal_is_formed():
    asked = GoalRequest(
        "pose", position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 1.0, 0.0), configuration="front", duration=2.5,
        speed_scale=0.5, acceleration_scale=0.25, frame="stock",
    )  # fmt: skip
    request = PlanToPoseRequest(**PLAN_SERVICES["pose"].fields(asked, source="ada", asked="c0ffee00-7"))
    assert (request.source, request.configuration, request.duration) == ("ada", "front", 2.5)
    assert (request.speed_scale, request.acceleration_scale, request.goal.header.frame_id) == (0.5, 0.25, "stock")
    assert (request.goal.pose.position.y, request.goal.pose.orientation.z) == (2.0, 1.0)


def test_a_verdict_has_the_fields_of_its_service():
    verdict = ReviewRequest("p", "h", "approved", "Ada", "fine", moment="c0ffee00-5000")
    given = {
        "plan_id": "p", "plan_hash": "h", "approve": True, "reviewer": "Ada", "reason": "fine", "override_rehearsal": False,
        "rehearsal_hash": "", "moment": "c0ffee00-5000",
    }  # fmt: skip
    assert request_fields(ReviewPlan, verdict) == given


def test_an_answer_is_read_with_every_field_that_it_has():
    plan = {"plan_id": "p", "plan_hash": "h", "duration": 2.5}
    assert Outcome.of(Outcome(True, "done", fields=plan).response(PlanToPose)) == Outcome(True, "done", fields=plan)
    assert Outcome.of(Outcome(False, "late", expired=True).response(ReviewPlan)) == Outcome(False, "late", True)
