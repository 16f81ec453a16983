"""What the tests of the mock over real UDP share."""

from __future__ import annotations

import pytest
from mock_cell import Pc
from processes import ROOT

from construction_twin.robot.description import read_robot_files


@pytest.fixture(scope="module")
def robot():
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


@pytest.fixture
def pc():
    """A PC that answers; closed at the end of the test."""
    pc = Pc()
    pc.start()
    yield pc
    pc.close()
