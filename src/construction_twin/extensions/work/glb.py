"""The elements of a building model as one binary glTF 2.0 file, for a browser: a node of its own for each element.

glTF has the y axis up: the one root node turns the base_link's axes accordingly. Metres. Standard library and numpy.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping

import numpy as np

from construction_twin.extensions.work.loaded_model import ElementFacts
from construction_twin.robot.frames import rotation_to_quaternion

_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_FLOAT, _UNSIGNED = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
#: From the base_link's axes, z up, to glTF's, y up: minus 90 deg about x, as x y z w.
_UPRIGHT = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]


def glb(elements: Mapping[str, ElementFacts], model_hash: str) -> bytes:
    """Return the file of elements by GlobalId; those without triangles are left out."""
    nodes: list[dict] = []
    meshes: list[dict] = []
    accessors: list[dict] = []
    views: list[dict] = []
    binary = bytearray()

    def put(values: np.ndarray, kind: int, form: str, target: int, **bounds: object) -> int:
        contents = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(contents), "target": target})
        binary.extend(contents)
        described = {"bufferView": len(views) - 1, "componentType": kind, "count": len(values), "type": form}
        accessors.append(described | bounds)
        return len(accessors) - 1

    for name, element in elements.items():
        corners = np.asarray(element.triangles, dtype=np.float32).reshape(-1, 3)
        if not len(corners):
            continue
        vertices, indices = np.unique(corners, axis=0, return_inverse=True)
        low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        position = put(np.ascontiguousarray(vertices, "<f4"), _FLOAT, "VEC3", _VERTICES, min=low, max=high)
        order = put(indices.reshape(-1).astype("<u4"), _UNSIGNED, "SCALAR", _INDICES)
        meshes.append({"primitives": [{"attributes": {"POSITION": position}, "indices": order, "material": 0}]})
        pose = element.base_T_goal
        nodes.append(
            {
                "name": name,
                "mesh": len(meshes) - 1,
                "translation": [float(value) for value in pose.position],
                "rotation": [float(value) for value in rotation_to_quaternion(pose.rotation)],
                "extras": {"element": name, "label": element.name},
            }
        )
    root = {"name": "base_link", "rotation": _UPRIGHT}
    if nodes:
        root["children"] = list(range(1, len(nodes) + 1))
    document = {
        "asset": {"version": "2.0", "generator": "construction_twin", "extras": {"model_hash": model_hash}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [root, *nodes],
    }
    if nodes:
        material = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9}, "doubleSided": True}
        document |= {"meshes": meshes, "materials": [material], "accessors": accessors, "bufferViews": views}
        document["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    chunks = _chunk(_JSON, text, b" ") + (_chunk(_BINARY, bytes(binary), b"\0") if nodes else b"")
    return struct.pack("<4sII", _MAGIC, 2, 12 + len(chunks)) + chunks


def _chunk(kind: bytes, contents: bytes, filler: bytes) -> bytes:
    contents += filler * (-len(contents) % 4)
    return struct.pack("<I4s", len(contents), kind) + contents
