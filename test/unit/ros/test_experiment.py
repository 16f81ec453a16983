"""The experiment's own pieces: rest, settings, progress, the link to the latest results. The run itself is a rostest."""

from __future__ import annotations

from pathlib import Path

import pydantic
import pytest
import yaml

from construction_twin.core.units import radians
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.commands.driver import RestDetector
from construction_twin.ros.commands.experiment import ExperimentSettings

CONFIG = yaml.safe_load(Path("config/experiment.yaml").read_text())


def test_arm_is_at_rest_after_the_rest_time_without_motion():
    rest = RestDetector(tolerance=1e-6, rest_time=0.5)
    for stamp, position in ((0.0, 0.0), (0.3, 1e-3), (0.7, 1e-3 + 5e-7)):
        rest.update(stamp, [position, 0.0])
        assert not rest.at_rest
    rest.update(0.8, [1e-3, 0.0])
    assert rest.at_rest
    rest.update(0.9, [1e-3, 2e-6])
    assert not rest.at_rest


def test_slow_creep_is_motion():
    rest = RestDetector(tolerance=1e-6, rest_time=0.5)
    for cycle in range(500):
        rest.update(cycle * 0.004, [cycle * 1e-8])
        assert not rest.at_rest


def test_shipped_configuration_is_valid_and_its_goals_are_in_range():
    settings = ExperimentSettings(results_dir="/tmp", **CONFIG)
    robot = read_robot_files("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml")
    for goal in settings.goals_deg:
        robot.check_range(radians(goal))
    assert (settings.duration, settings.waypoints) == (75.2, 1500)


@pytest.mark.parametrize("change", [{"results_dir": "results"}, {"duration": 0}, {"goals_deg": []}, {"speed": 1}])
def test_settings_that_make_no_sense_are_refused(change):
    with pytest.raises(pydantic.ValidationError):
        ExperimentSettings(**{"results_dir": "/tmp", **CONFIG, **change})
