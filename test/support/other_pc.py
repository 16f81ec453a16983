"""A twin's PC and another PC, each in a network namespace of its own, with a line between them that can be cut. Needs root.

`TwinPc` starts bringup there and makes this process a ROS node of the same PC; `OtherPc` runs programs whose clock is another one.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import rospy
from actionlib_msgs.msg import GoalID
from construction_twin.msg import Execution, Link, Plan, Sync
from construction_twin.srv import ReviewPlan
from namespaces import CELL_PC, ROS_PC, Namespaces
from processes import ROOT, wait_until

#: Other namespaces are other networks: ports are free there.
MASTER = f"http://{ROS_PC}:11311"
NAMESPACE = "/kr120"


class TwinPc:
    """Bringup with the mock arm in the namespace `ros`, and what it reports; entered when a plan could be approved."""

    def __init__(self, spaces: Namespaces, folder: Path):
        self._spaces = spaces
        self._log = folder / "bringup.log"
        self._environment = {"ROS_MASTER_URI": MASTER, "ROS_IP": ROS_PC, "ROS_HOME": str(folder / "ros_home")}
        self._launch: subprocess.Popen | None = None
        self.plans: list[Plan] = []
        self.executions: list[Execution] = []
        self.syncs: list[Sync] = []
        self.links: list[Link] = []
        self._cancel: rospy.Publisher | None = None

    def __enter__(self) -> TwinPc:
        command = ["roslaunch", "-p", "11311", "construction_twin", "bringup.launch"]
        with open(self._log, "wb") as log:
            self._launch = subprocess.Popen(
                [*self._spaces.prefix(self._spaces.ros), *command],
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | self._environment,
                start_new_session=True,
            )
        try:
            self._join()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_) -> None:
        rospy.signal_shutdown("the test is over")
        if self._launch.poll() is None:
            self._launch.send_signal(signal.SIGINT)  # roslaunch ends its nodes
        self._launch.wait(60.0)
        assert "escalating" not in self.log(), "a node did not end by itself"

    def ready(self) -> bool:
        """Return whether a plan could be approved."""
        latest = (self.links, Link.ARMED), (self.syncs, Sync.IN_SYNC), (self.executions, Execution.IDLE)
        return all(reports and reports[-1].state == state for reports, state in latest)

    def approve(self) -> None:
        """Approve the newest plan, as soon as the executor has it, too."""
        plan = self.plans[-1]
        answers = []

        def approved() -> bool:
            review = rospy.ServiceProxy(f"{NAMESPACE}/review_plan", ReviewPlan)
            answers.append(review(plan_id=plan.id, plan_hash=plan.hash, approve=True, reviewer="test"))
            return answers[-1].success or "is not under review" not in answers[-1].message

        with self._spaces.entered():  # the main thread lives outside
            wait_until(approved, 10.0, "a verdict that counts")
        assert answers[-1].success, answers[-1].message

    def cancel_all_before(self, stamp: float) -> None:
        """Cancel every goal whose stamp is not after `stamp` [s], as actionlib's clients can."""
        wait_until(self._cancel.get_num_connections, 10.0, "the action's server")
        self._cancel.publish(GoalID(stamp=rospy.Time.from_sec(stamp)))

    def ended(self, plan_id: str) -> str:
        """Return how the execution of a plan ended; empty before."""
        last = self.executions[-1]
        return last.outcome if last.plan_id == plan_id and last.state == Execution.IDLE else ""

    def log(self) -> str:
        """Return what bringup printed."""
        return self._log.read_text(errors="replace")

    def _join(self) -> None:
        # what a thread that lives in the namespace starts lives there, too: all of rospy's threads do
        with self._spaces.entered():
            os.environ.update(self._environment)
            wait_until(self._master_answers, 30.0, "the master's answer")
            rospy.init_node("test_other_pc", disable_signals=True)
            for name, kind, kept in (
                ("plan", Plan, self.plans),
                ("execution", Execution, self.executions),
                ("sync", Sync, self.syncs),
                ("link", Link, self.links),
            ):
                rospy.Subscriber(f"{NAMESPACE}/{name}", kind, kept.append)
            action = f"{NAMESPACE}/follow_joint_trajectory"
            self._cancel = rospy.Publisher(f"{action}/cancel", GoalID, queue_size=1)
            rospy.wait_for_service(f"{NAMESPACE}/review_plan", 40.0)
            wait_until(self.ready, 40.0, "a robot that is ready")

    def _master_answers(self) -> bool:
        assert self._launch.poll() is None, self.log()
        try:
            rospy.get_master().getPid()
        except OSError:
            return False
        return True


class OtherPc:
    """The namespace `cell` as the PC of a planner, with a wall clock of its own.

    Args:
        folder: For what is compiled.
        ahead: How far its wall clock is ahead [s]; its monotonic clock is the machine's.
    """

    def __init__(self, spaces: Namespaces, folder: Path, ahead: int):
        self._spaces = spaces
        self._prefix = spaces.prefix(spaces.cell)
        library = folder / "wall_clock.so"
        source = Path(__file__).with_name("wall_clock.c")
        subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
        clock = {"LD_PRELOAD": str(library), "WALL_CLOCK_AHEAD": str(ahead)}
        self._environment = os.environ | clock | {"ROS_MASTER_URI": MASTER, "ROS_IP": CELL_PC}

    def clock(self) -> float:
        """Return its wall clock [s]."""
        command = [*self._prefix, sys.executable, "-c", "import time; print(time.time())"]
        return float(subprocess.run(command, check=True, capture_output=True, env=self._environment).stdout)

    @contextmanager
    def running(self, *words: str):
        """Run a program while the block runs; yields a `Running`."""
        process = subprocess.Popen(
            [*self._prefix, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=self._environment,
            start_new_session=True,
        )
        program = Running(process)
        try:
            yield program
        finally:
            program.kill()

    @contextmanager
    def reaching(self, by: str, goal_deg, duration: float, output: Path):
        """Run matlab/reaching_task.py, which sends by ``action`` or ``topic``: what a person at MATLAB does."""
        options = [
            "--by",
            by,
            "--namespace",
            NAMESPACE,
            "--duration",
            f"{duration}",
            "--count",
            f"{int(20 * duration)}",
        ]
        options += ["--patience", "60", "--output", str(output), "--goal", *map(str, goal_deg)]
        with self.running(sys.executable, str(ROOT / "matlab" / "reaching_task.py"), *options) as program:
            yield program

    def reaches_the_twin(self) -> bool:
        """Return whether the twin's PC can be reached over the line."""
        words = [*self._prefix, "timeout", "1", "bash", "-c", f"</dev/tcp/{ROS_PC}/11311"]
        return subprocess.run(words, capture_output=True).returncode == 0

    def cut(self) -> None:
        """Cut the line: nothing passes, and nobody is told."""
        self._spaces.inside(self._spaces.cell, "ip", "link", "set", "line", "down")

    def mend(self) -> None:
        """Join the line again."""
        self._spaces.inside(self._spaces.cell, "ip", "link", "set", "line", "up")


class Running:
    """A program that runs; what it prints is read in a thread."""

    def __init__(self, process: subprocess.Popen):
        self._process = process
        self._lines: list[str] = []
        self._reading = threading.Thread(target=lambda: self._lines.extend(process.stdout), daemon=True)
        self._reading.start()

    @property
    def output(self) -> str:
        """What it has printed so far."""
        return "".join(self._lines)

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def wait(self, timeout: float) -> int:
        """Return its exit code, at the latest after `timeout` [s]."""
        code = self._process.wait(timeout)
        self._reading.join(5.0)
        return code

    def kill(self) -> None:
        """End it as a power cut would, with what it started."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(5.0)
