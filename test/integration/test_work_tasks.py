#!/usr/bin/env python3
"""Elements of a building model, each placed once, though one is stalled and the work node killed in the worst moments of others.

A machine that pauses for a tenth of a second makes the gate hold, as it should. So what was not meant to hold is done again as a
person would: the question is answered by what the gripper reads, and the task is planned anew.
"""

import os
import signal
import sys
from pathlib import Path

import rospy
import rostest
from construction_twin.msg import Execution, Scene, ToolState, WorkTasks
from construction_twin.srv import EditScene, WorkDecide, WorkPlanTask
from geometry_msgs.msg import PoseStamped
from twin_client import RobotTest, node_pid

from construction_twin.core.append_only import read_lines
from construction_twin.ros.shared.params import ros_home

#: Longest that reading the model and doing a task may take, on a machine that does other things too [s].
READING, DOING = 150.0, 60.0
#: Tasks that the steps below do.
DONE = 4
#: Plans of one task, the way back included, after which it is a failure of ours.
MOST_PLANS = 8
#: As built against the model: the gate's tolerance and the wire's digits at the end of an arm of 2.5 m.
MOST_MM, MOST_DEG = 1.0, 0.05


class WorkTest(RobotTest):
    """One session; its steps follow each other, as on a site."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.tasks = cls.scene = cls.tool = None
        rospy.Subscriber("tool", ToolState, lambda message: setattr(cls, "tool", message))
        rospy.Subscriber("work/tasks", WorkTasks, lambda message: setattr(cls, "tasks", message))
        rospy.Subscriber("scene", Scene, lambda message: setattr(cls, "scene", message))
        for name in ("work/plan", "work/decide", "review_plan", "edit_scene"):
            rospy.wait_for_service(name, READING)
        cls.plan_task = rospy.ServiceProxy("work/plan", WorkPlanTask)
        cls.decide = rospy.ServiceProxy("work/decide", WorkDecide)

    # -- what the steps have in common

    def task(self, number: int):
        return self.tasks.tasks[number]

    def wait_for_state(self, number: int, *states: str, timeout: float = DOING) -> None:
        self.client.wait(
            lambda: self.task(number).state in states,
            f"task {number} to be {' or '.join(states)}; it is {self.task(number).state}: {self.task(number).reason}",
            timeout,
        )

    def planned(self, number: int):
        """Return the answer with a plan of a task, which waits for approval."""
        self.client.start_over(60.0)
        answer = self.plan_task(self.task(number).id)
        self.assertTrue(answer.success, answer.message)
        self.client.wait(lambda: self.client.plans and self.client.plans[-1].id == answer.plan_id, "the plan")
        return answer

    def approve(self, answer) -> None:
        self.client.approve(answer)

    def carrying(self, number: int):
        """Return the answer with the plan that carries an element now."""
        for _ in range(MOST_PLANS):
            answer = self.planned(number)
            self.approve(answer)

            def moves(plan_id: str = answer.plan_id) -> bool:
                now = self.client.execution
                carries = now.segment_name == "carry" and not now.at_boundary and now.state == Execution.PLAYING
                return now.plan_id == plan_id and carries

            self.client.wait(lambda: moves() or self.has_ended(answer.plan_id), "the arm to carry", DOING)
            if moves():
                return answer
            self.settle(number)
        self.fail(f"task {number} was not carried with {MOST_PLANS} plans; {self.client.describe()}")

    def has_ended(self, plan_id: str) -> bool:
        """Return whether a plan was played and is not any more."""
        now = self.client.execution
        return now.plan_id == plan_id and now.outcome != ""

    def settle(self, number: int) -> None:
        """Wait until a task can be planned, or is done; answer as a person who looks at the gripper."""
        self.client.start_over(60.0)
        self.wait_for_state(number, "ready", "carried", "asks", "done")
        row = self.task(number)
        if row.state != "asks":
            return
        holds = dict(zip(self.tool.inputs, self.tool.input_values))["vacuum_reached"]
        let_go = [entry["event"] for entry in self.entries() if entry.get("task") == row.id][-2:-1] == ["releasing"]
        answer = "in_grip" if holds else "placed" if let_go else "in_stock"
        taken = self.decide(task=row.id, decision="answer", answer=answer, person="tester", reason="seen")
        self.assertTrue(taken.success, taken.message)
        self.wait_for_state(number, "ready", "carried", "done")

    def complete(self, number: int) -> None:
        """Plan and approve until a task is done."""
        for _ in range(MOST_PLANS):
            self.settle(number)
            if self.task(number).state == "done":
                return
            answer = self.planned(number)
            self.approve(answer)
            self.client.wait(lambda plan_id=answer.plan_id: self.has_ended(plan_id), "the plan to end", DOING)
        self.settle(number)
        self.assertEqual(self.task(number).state, "done", self.task(number).reason)

    def kill_the_work_node(self) -> int:
        pid = node_pid("work")
        self.assertTrue(pid, "the work node does not run")
        os.kill(pid, signal.SIGKILL)
        # what the killed one said last counts no more
        type(self).tasks = WorkTasks()
        return pid

    def wait_until_it_is_back(self, before: int) -> None:
        self.client.wait(lambda: node_pid("work") not in (0, before), "another work node", 30.0)
        self.client.wait(lambda: self.tasks.tasks, "the model to be read again", READING)

    def ledger(self) -> Path:
        (path,) = (ros_home() / "construction_twin" / "work").glob("*.jsonl")
        return path

    def entries(self) -> list[dict]:
        """Return the lines of the ledger."""
        return read_lines(self.ledger())

    # -- the steps

    def test_elements_are_placed_once(self):
        self.client.wait(lambda: self.tasks is not None and self.tasks.tasks, "the tasks", READING)
        self.assertEqual(len(self.tasks.tasks), 14)
        self.refused_out_of_order()
        self.stalled_while_it_carries(0)
        self.killed_while_the_arm_carries(1)
        for number, step in ((2, "gripping"), (3, "releasing")):
            self.killed_when_the_ledger_says(step, number)
        self.refused_twice(0)
        self.measured(0)
        self.each_is_placed_once()

    def refused_out_of_order(self):
        stud, plate = self.task(2), self.task(0)
        answer = self.plan_task(stud.id)
        self.assertFalse(answer.success)
        self.assertIn(plate.name, answer.message)
        self.assertEqual(self.decide(task=stud.id, decision="answer", answer="in_grip", person="tester").success, False)
        self.assertIn("who says so", self.decide(task=stud.id, decision="skip", person=" ").message)

    def stalled_while_it_carries(self, number: int):
        answer = self.carrying(number)
        self.client.stall("joint_a1", True)
        self.client.wait_for_outcome(answer.plan_id, "held", DOING)
        self.client.stall("joint_a1", False)
        self.client.start_over(60.0)
        self.wait_for_state(number, "asks")
        asked = self.task(number)
        self.assertIn("where is", asked.question)
        refused = self.plan_task("")
        self.assertFalse(refused.success)
        self.assertIn("asks first", refused.message)
        self.assertIn("in_grip", asked.answers)
        self.complete(number)

    def killed_while_the_arm_carries(self, number: int):
        self.carrying(number)
        self.wait_until_it_is_back(self.kill_the_work_node())
        self.complete(number)

    def killed_when_the_ledger_says(self, step: str, number: int):
        """Between the line that a switch is about to be set and the one of what it did: then nobody knows where the element is."""
        answer = None
        for _ in range(MOST_PLANS):
            answer = self.planned(number)
            written = self.ledger().stat().st_size
            self.approve(answer)

            def reached(written: int = written) -> bool:
                # as text: the last line may be half written
                return f'"{step}"' in self.ledger().read_text()[written:]

            self.client.wait(lambda: reached() or self.has_ended(answer.plan_id), f"the ledger to say {step}", DOING)
            if reached():
                break
            self.settle(number)
        else:
            self.fail(f"task {number} was not {step} with {MOST_PLANS} plans; {self.client.describe()}")
        self.wait_until_it_is_back(self.kill_the_work_node())
        self.client.wait(lambda: self.has_ended(answer.plan_id), "the plan to end", DOING)
        self.complete(number)

    def refused_twice(self, number: int):
        for _ in range(MOST_PLANS):
            self.client.start_over(60.0)
            if not self.client.execution.engaged:
                break
            # what was held beside the element is done, but while the arm is engaged every plan is the way back
            answer = self.planned(number)
            self.approve(answer)
            self.client.wait(lambda plan_id=answer.plan_id: self.has_ended(plan_id), "the way back to end", DOING)
        answer = self.plan_task(self.task(number).id)
        self.assertFalse(answer.success)
        self.assertIn("is done", answer.message)
        # and an edit that is not between the scenes it names is none
        edit = rospy.ServiceProxy("edit_scene", EditScene)(before="0" * 64, remove=[f"{self.task(number).element}/0"])
        self.assertFalse(edit.success)

    def measured(self, number: int):
        (body,) = [item for item in self.scene.objects if item.name == f"{self.task(number).element}/0"]
        far = PoseStamped(pose=body.pose)
        far.pose.position.x += 100.0
        measured = {"task": self.task(number).element, "decision": "measured", "pose": far}
        self.assertFalse(rospy.ServiceProxy("work/decide", WorkDecide)(**measured, person="tester").success)

    def each_is_placed_once(self):
        entries = self.entries()
        placed = [
            entry["task"]
            for entry in entries
            if entry["event"] == "released" or (entry["event"] == "answered" and entry.get("answer") == "placed")
        ]
        self.assertEqual(sorted(placed), sorted(self.task(number).id for number in range(DONE)))
        names = [item.name for item in self.scene.objects]
        for number in range(DONE):
            task = self.task(number)
            self.assertEqual(task.state, "done")
            self.assertLess(task.deviation_mm, MOST_MM, task.name)
            self.assertLess(task.deviation_deg, MOST_DEG, task.name)
            standing = [item for item in self.scene.objects if item.name.startswith(f"{task.element}/")]
            self.assertTrue(standing and all(not item.link for item in standing), names)
        self.assertEqual([task.state for task in self.tasks.tasks].count("done"), DONE)
        self.assertTrue(any(entry["event"] == "answered" for entry in entries))
        self.client.assert_trace_within_limits()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "work_tasks", WorkTest, sys.argv)
