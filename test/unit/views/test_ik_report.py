"""The report on how an arm's inverse kinematics is solved: kind, reason, figures."""

from __future__ import annotations

import itertools
import re

import pytest
from inverse_cases import KR120, PANDA_LIKE, ROOT, SEARCHED, TRACK, UR_LIKE

from construction_twin.views.ik_report import main, report


@pytest.mark.parametrize(
    "robot, kind, why",
    [
        (KR120, "OPW", "axes 2 and 3 are parallel"),
        (UR_LIKE, "closed form", "axes 2, 3 and 4 are parallel and axes 5 and 6 meet in a point"),
        (TRACK, "OPW on a linear axis", "behind joint 1, which is prismatic"),
        (PANDA_LIKE, "search", "its joints are neither six revolute ones nor"),
        (SEARCHED, "search", "no closed form is near: .* miss by 2[0-9] mm"),
    ],
)
def test_every_arm_is_told_its_kind_and_why(robot, kind, why):
    ticks = itertools.count()
    lines = report(robot, poses=3, seed=1, clock=lambda: 1e-3 * next(ticks))
    assert re.match(rf"{robot.name}: {kind}, because .*{why}", lines[0]), lines[0]
    assert any(line.startswith("solved    3 of 3 reachable poses (100.00%)") for line in lines)


def test_the_times_are_those_of_the_clock():
    ticks = itertools.count()
    lines = report(UR_LIKE, poses=3, seed=1, clock=lambda: 1e-3 * next(ticks))
    assert "time      median 1,000 us, p99 1,000 us" in lines


def test_the_command_reads_an_arms_files(capsys):
    files = [str(ROOT / "test/data/ur_like.urdf"), str(ROOT / "test/data/ur_like.yaml")]
    main([*files, "--poses", "2"])
    assert capsys.readouterr().out.startswith("ur_like: closed form, because ")


@pytest.mark.parametrize("options", [["--poses", "0"], ["--seed", "-1"]])
def test_numbers_that_make_no_sense_are_refused(options):
    with pytest.raises(SystemExit, match="expected 1 or more"):
        main(["a.urdf", "a.yaml", *options])


def test_files_that_are_not_there_are_named():
    with pytest.raises(SystemExit, match="ik_report: .*nowhere"):
        main(["/nowhere.urdf", "/nowhere.yaml"])
