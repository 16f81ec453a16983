"""The building model as binary glTF: read back as the specification says, number by number."""

from __future__ import annotations

import json
import math
import struct

import numpy as np
import pytest

from construction_twin.extensions.work.glb import glb
from construction_twin.extensions.work.loaded_model import ElementFacts
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import quaternion_to_rotation

TRIANGLES = np.array(
    [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float
)  # two that share an edge
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def elements(triangles=TRIANGLES, **places: float) -> dict[str, ElementFacts]:
    poses = {name: Pose(np.array([x, 2.0, 3.0]), QUARTER) for name, x in places.items()}
    return {name: ElementFacts(f"Stud {name}", (), pose, triangles) for name, pose in poses.items()}


def chunks(contents: bytes) -> tuple[dict, bytes]:
    magic, version, length = struct.unpack_from("<4sII", contents)
    assert (magic, version, length) == (b"glTF", 2, len(contents)) and length % 4 == 0
    found, at = {}, 12
    while at < length:
        size, kind = struct.unpack_from("<I4s", contents, at)
        assert size % 4 == 0
        found[kind] = contents[at + 8 : at + 8 + size]
        at += 8 + size
    return json.loads(found[b"JSON"]), found.get(b"BIN\0", b"")


def array(document: dict, binary: bytes, number: int) -> np.ndarray:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    kind, width = {5126: ("<f4", 4), 5125: ("<u4", 4)}[accessor["componentType"]]
    columns = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    assert view["byteOffset"] % width == 0 and view["byteLength"] == accessor["count"] * columns * width
    return np.frombuffer(binary, kind, accessor["count"] * columns, view["byteOffset"]).reshape(-1, columns)


def test_each_element_is_a_node_with_its_triangles_where_the_model_has_it():
    document, binary = chunks(glb(elements(**{"2O2Fr$t4X7Zf8NOew3FLOH": 0.0, "b": 5.0}), "h"))
    assert document["buffers"] == [{"byteLength": len(binary)}]
    root, first, second = document["nodes"]
    assert document["scenes"] == [{"nodes": [0]}] and root["children"] == [1, 2]
    assert first["name"] == first["extras"]["element"] == "2O2Fr$t4X7Zf8NOew3FLOH"
    assert (first["extras"]["label"], second["translation"]) == ("Stud 2O2Fr$t4X7Zf8NOew3FLOH", [5.0, 2.0, 3.0])
    np.testing.assert_allclose(quaternion_to_rotation(first["rotation"]), QUARTER, atol=1e-12)
    (primitive,) = document["meshes"][first["mesh"]]["primitives"]
    vertices = array(document, binary, primitive["attributes"]["POSITION"])
    indices = array(document, binary, primitive["indices"]).reshape(-1)
    assert len(vertices) == 4, "shared corners stand once"
    np.testing.assert_array_equal(vertices[indices].reshape(-1, 3, 3), TRIANGLES)
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    assert (accessor["min"], accessor["max"]) == ([0.0, 0.0, 0.0], [1.0, 1.0, 0.0])


def test_what_is_up_in_the_base_is_up_in_gltf():
    document, _ = chunks(glb(elements(a=0.0), "h"))
    upright = quaternion_to_rotation(document["nodes"][0]["rotation"])
    np.testing.assert_allclose(upright @ [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(upright @ [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("shown", [{}, elements(np.empty((0, 3, 3)), flat=0.0)])
def test_a_model_without_geometry_is_an_empty_scene(shown):
    document, binary = chunks(glb(shown, "5ce9e0"))
    assert document["asset"]["extras"] == {"model_hash": "5ce9e0"}
    assert binary == b"" and len(document["nodes"]) == 1 and "meshes" not in document
    assert math.isclose(sum(value**2 for value in document["nodes"][0]["rotation"]), 1.0)
