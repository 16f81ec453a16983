import copy

import pytest
import yaml
from physics_samples import DRIVES, drives, robot_of

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.physics.drive import drives_of, read_drives

CONTENT = yaml.safe_load(DRIVES.read_text())


def changed(path: str, value: object) -> dict:
    content = copy.deepcopy(CONTENT)
    *folders, last = path.split("/")
    inner = content
    for folder in folders:
        inner = inner[folder]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return content


def test_the_file_of_the_kr120_is_read_in_the_order_of_its_joints():
    found = drives()
    assert found.torque == (7290.0, 8910.0, 7759.0, 2462.0, 1492.0, 908.0)
    assert found.armature == (120.0, 120.0, 90.0, 12.0, 10.0, 6.0)
    assert found.rating.mass_kg == 120.0
    assert found.estimates == ("torque", "armature", "damping", "link_masses")


@pytest.mark.parametrize(
    "path, value",
    [
        ("robot", None),
        ("source", None),
        ("joints/joint_a3", None),
        ("joints/joint_a7", {"torque_nm": 1.0}),
        ("joints/joint_a1/torque_nm", 0.0),
        ("joints/joint_a1/torque_nm", "much"),
        ("joints/joint_a1/armature_kg_m2", -1.0),
        ("joints/joint_a1/friction_nm", float("nan")),
        ("joints/joint_a1/torque", 7290.0),
        ("payload/mass_kg", -120.0),
        ("payload/source", None),
        ("colour", "orange"),
        ("estimates", ["torque", "mass of the links"]),
    ],
)
def test_a_wrong_file_is_refused_with_file_and_key(tmp_path, path, value):
    (file := tmp_path / "drives.yaml").write_text(yaml.safe_dump(changed(path, value)))
    with pytest.raises(ConfigurationError) as refusal:
        read_drives(file, robot_of("kr120"))
    assert "drives.yaml" in str(refusal.value)
    assert path.split("/")[0] in str(refusal.value)


def test_what_only_a_urdf_says_is_an_estimate():
    found = drives_of(robot_of("ur_like"))
    assert "torque" in found.estimates
    assert found.rating is None
    assert found.armature == (0.0,) * 6
