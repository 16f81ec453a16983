"""Which nodes run, by the master and by what they say themselves: also slow ones, and ports that another node has taken over."""

from __future__ import annotations

import threading

import pytest
from ros_master import PID, Node, ros_master

from construction_twin.core.errors import ConfigurationError, SilenceError
from construction_twin.ros.shared.master import expect_publisher, running
from construction_twin.ros.shared.start_refusal import expect_no_other


@pytest.fixture
def master(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    with ros_master() as uri:
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        yield uri


def test_a_publisher_that_does_not_come_to_its_first_answer_is_asked_again(master):
    questions, end = [], threading.Event()

    def get_pid(caller: str) -> tuple[int, str, int]:
        questions.append(caller)
        if len(questions) == 1:
            end.wait(60.0)
        return 1, "", PID

    node = Node(master, "/kr120/executor", "/kr120/execution", get_pid=get_pid)
    try:
        expect_publisher("/kr120/execution", patience=5.0)
    finally:
        end.set()
        node.end()
    assert len(questions) == 2
    with pytest.raises(SilenceError, match="/kr120/executor has ended, or does not answer; start bringup"):
        expect_publisher("/kr120/execution", patience=5.0)


def test_another_node_on_the_port_of_one_that_was_killed_is_not_taken_for_it(master):
    killed = Node(master, "/kr120/executor", "/kr120/execution")
    port = killed.server.server_address[1]
    killed.end()
    other = Node(master, "/camera", port=port)
    try:
        assert [node.name for node in running(["/camera"], master)] == ["/camera"]
        assert running(["/kr120/executor"], master) == []
        with pytest.raises(SilenceError, match="/kr120/executor has ended, or does not answer"):
            expect_publisher("/kr120/execution")
    finally:
        other.end()


def test_a_node_of_a_name_that_runs_already_does_not_take_its_place(master, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", master)
    monkeypatch.setenv("ROS_NAMESPACE", "kr120")
    node = Node(master, "/kr120/executor")
    try:
        with pytest.raises(
            ConfigurationError, match="/kr120/executor: found .* process 4711.*, expected no such node on"
        ):
            expect_no_other("executor")
    finally:
        node.end()
    expect_no_other("executor")
    # a gateway, too, which is no node any more once it runs, does not start beside another launch of its robot
    node = Node(master, "/kr120/startup")
    expect_no_other("rsi_gateway")
    monkeypatch.setenv("CONSTRUCTION_TWIN_LAUNCH", "second")
    try:
        with pytest.raises(ConfigurationError, match="/kr120/startup: found .* process 4711"):
            expect_no_other("rsi_gateway")
    finally:
        node.end()
