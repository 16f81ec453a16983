"""Whether anything of a model is in reach from where the robot stands."""

import numpy as np
import pytest
from building_models import box, building, element

from construction_twin.extensions.work.building import PlacementError
from construction_twin.extensions.work.worker_functions import check_placement
from construction_twin.kinematics.chain import Pose

HERE = Pose(np.zeros(3), np.eye(3))
NEAR, OUT, LOST = (element(name, box((x, 0, 0), (x + 1, 1, 1))) for name, x in (("near", 1), ("out", 5), ("lost", 200)))


def test_a_model_of_which_something_is_in_reach_is_placed():
    check_placement(building(NEAR, OUT, LOST), HERE, 3.0)


def test_a_model_that_is_out_of_reach_is_refused_with_the_figures():
    with pytest.raises(PlacementError, match=r"all 2 elements.*3\.00 m.*'out'.*5\.00 m"):
        check_placement(building(OUT, LOST), HERE, 3.0)


def test_a_model_without_geometry_is_refused():
    with pytest.raises(PlacementError, match="no element has geometry"):
        check_placement(building(element("a")), HERE, 3.0)
