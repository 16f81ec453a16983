"""What launch files ask for: the URDF of a xacro and a home pose, printed; what is wrong is one sentence."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml

from construction_twin.robot import home_command, xacro_command
from construction_twin.robot.description import home_positions
from construction_twin.robot.urdf import expand_xacro

ROOT = Path(__file__).resolve().parents[3]
XACRO, YAML = ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml"


def test_the_urdf_is_printed_with_the_arguments(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["expand_xacro", str(XACRO), "alpha:=0.4"])
    xacro_command.main()
    assert capsys.readouterr().out == expand_xacro(XACRO, {"alpha": "0.4"}) + "\n"


def test_the_home_pose_is_printed_as_yaml(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["home_pose", str(YAML)])
    home_command.main()
    assert yaml.safe_load(capsys.readouterr().out) == home_positions(YAML)


@pytest.mark.parametrize(
    "main, words, sentence",
    [
        (xacro_command.main, [], "usage: expand_xacro FILE"),
        (xacro_command.main, ["/no/such"], "robot_xacro: /no/such: found "),
        (xacro_command.main, [str(XACRO), "no argument"], "robot_xacro: "),
        (home_command.main, [], "usage: home_pose FILE"),
        (home_command.main, ["/no/such"], "/no/such: found "),
    ],
)
def test_what_is_wrong_is_one_sentence(monkeypatch, capsys, main, words, sentence):
    monkeypatch.setattr(sys, "argv", ["program", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert str(ended.value).startswith(sentence) and capsys.readouterr().out == ""
