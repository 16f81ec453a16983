"""The building model as binary glTF, as the console's page reads it."""

from __future__ import annotations

import json
import struct

import numpy as np

from construction_twin.extensions.work.loaded_model import ElementFacts, glb
from construction_twin.kinematics.chain import Pose

TRIANGLES = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def document(*elements: tuple[str, np.ndarray]) -> dict:
    facts = {
        name: ElementFacts(f"Stud {name}", (), Pose(np.array([1.0, 2.0, 3.0]), QUARTER), triangles)
        for name, triangles in elements
    }
    contents = glb(facts, "5ce9e0")
    (length,) = struct.unpack_from("<I", contents, 12)
    return json.loads(contents[20 : 20 + length])


def test_each_element_with_triangles_is_a_node_at_its_place_with_y_up():
    found = document(("2O2Fr$t4X7Zf8NOew3FLOH", TRIANGLES), ("flat", np.empty((0, 3, 3))))
    assert found["asset"]["extras"] == {"model_hash": "5ce9e0"}
    (node,) = [each for each in found["nodes"] if "mesh" in each]
    assert node["extras"] == {"element": "2O2Fr$t4X7Zf8NOew3FLOH", "label": "Stud 2O2Fr$t4X7Zf8NOew3FLOH"}
    # columns first: x, y, z of the base become x, z, -y
    matrix = np.reshape(node["matrix"], (4, 4)).T
    np.testing.assert_allclose(matrix @ [0.0, 0.0, 0.0, 1.0], [1.0, 3.0, -2.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 0.0, 1.0], [1.0, 3.0, -3.0, 1.0], atol=1e-12)


def test_a_model_without_geometry_is_an_empty_scene():
    assert document()["asset"]["extras"] == {"model_hash": "5ce9e0"}
