"""Arguments on roslaunch's command line that no launch file reads, told with the name that was probably meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from construction_twin.core.sentences import Sentence
from construction_twin.views.roslaunch_call import argument_problem, known_arguments, roslaunch_call

ROOT = Path(__file__).resolve().parents[3]
LAUNCH = ROOT / "launch"


def find(package: str) -> str | None:
    return str(ROOT) if package == "construction_twin" else None


def problem(file: str, **given: str) -> str:
    known = known_arguments(LAUNCH / file, find)
    assert known is not None
    return argument_problem(given, known, file)


def test_the_command_line_is_read_with_its_options():
    call = roslaunch_call(
        ["/usr/bin/python3", "/usr/bin/roslaunch", "-p", "11399", "--screen", "construction_twin", "bringup.launch", "arm:=none",
         "--pid=/tmp/x", "__ns:=/a", "robot:=kr120_2"]
    )  # fmt: skip
    assert call is not None
    assert call.files == ("construction_twin", "bringup.launch")
    assert call.given == {"arm": "none", "robot": "kr120_2"}
    assert call.port == "11399" and call.starts
    assert call.options == {"-p": "11399", "--screen": "", "--pid": "/tmp/x"}


@pytest.mark.parametrize("option", ["--nodes", "--ros-args", "--dump-params", "--files", "--args=/x", "--find-node=/x"])
def test_a_call_that_only_prints_starts_nothing(option):
    call = roslaunch_call(["roslaunch", option, "a.launch"])
    assert call is not None and not call.starts and call.files == ("a.launch",)


def test_a_misspelt_argument_is_named_with_the_one_that_was_probably_meant():
    meant = Sentence(
        "preflight.argument.near", name="auto_aprove", value="true", file="bringup.launch", near="auto_approve"
    )
    assert problem("bringup.launch", auto_aprove="true") == meant
    unknown = Sentence("preflight.argument.unknown", name="zzz", value="1", file="bringup.launch")
    assert problem("bringup.launch", zzz="1") == unknown


def test_what_a_file_hands_on_is_known_and_what_it_sets_itself_is_not():
    assert problem("two_robots.launch", decimals="6") == ""
    assert problem("two_robots.launch", neighbour="b").key.startswith("preflight.argument.")
    assert problem("experiment.launch", quick="true", realtime="0") == ""


def test_an_empty_value_that_roslaunch_drops_is_told_where_the_default_is_another():
    assert problem("bringup.launch", broker_host="") == Sentence("preflight.argument.empty", name="broker_host")
    assert problem("bringup.launch", scene="") == Sentence("preflight.argument.empty_none", name="scene")
    assert problem("bringup.launch", bridge_account="") == ""


def test_a_second_sign_in_a_value_is_told_because_roslaunch_drops_the_argument():
    call = roslaunch_call(["roslaunch", "construction_twin", "bringup.launch", "robot_xacro_args:=prefix:=left_ a:=b"])
    assert call is not None
    values = {"name": "robot_xacro_args", "value": "prefix:=left_ a:=b", "meant": "'prefix=left_ a=b'"}
    assert problem("bringup.launch", **call.given) == Sentence("preflight.argument.second", **values)
    assert problem("bringup.launch", robot_xacro_args="prefix=left_") == ""
