"""Meshes of a link, beside the URDF that names them: one box, the same size from every format, unit and up axis."""

from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh
from scene_samples import box_triangles, write_obj, write_stl

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.new_robot import robot_of_urdf
from construction_twin.scene.collision_bodies import RobotBodies

SIZE, CENTRE = (0.15, 0.2, 0.95), (0.0, 0.1, 0.475)
BOX = box_triangles(SIZE, CENTRE)

URDF = """<robot name="arm"><link name="base_link"/><link name="tool0">
<collision><geometry><mesh filename="{mesh}" {scale}/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="base_link"/><child link="tool0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="0" velocity="1"/></joint></robot>"""

COLLADA = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><contributor/><created>2026-01-01T00:00:00</created><modified>2026-01-01T00:00:00</modified>{unit}<up_axis>{axis}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="{count}">{numbers}</float_array>
<technique_common><accessor source="#a" count="{corners}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{triangles}"><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def write_collada(metres, axis):
    def write(path, triangles):
        numbers = (np.asarray(triangles) / metres).ravel()
        text = COLLADA.format(
            unit=f'<unit name="u" meter="{metres}"/>' if metres != 1 else "", axis=axis, count=len(numbers),
            corners=len(numbers) // 3, triangles=len(triangles), numbers=" ".join(f"{number:.9g}" for number in numbers),
            indices=" ".join(map(str, range(len(numbers) // 3))),
        )  # fmt: skip
        path.write_text(text)

    return write


def write_glb(path, triangles):
    """Write what a program for drawing does that counts in mm: the root node makes metres of all below it."""
    mesh = trimesh.Trimesh(np.asarray(triangles).reshape(-1, 3) * 1e3, np.arange(3 * len(triangles)).reshape(-1, 3))
    scene = trimesh.Scene()
    scene.graph.update("metres", matrix=np.diag([1e-3, 1e-3, 1e-3, 1.0]))
    scene.add_geometry(mesh, parent_node_name="metres")
    path.write_bytes(trimesh.exchange.gltf.export_glb(scene))


def bodies_of(folder, mesh, scale=""):
    (folder / "arm.urdf").write_text(URDF.format(mesh=mesh, scale=scale))
    return RobotBodies(robot_of_urdf(folder / "arm.urdf")).bodies


def corners(body):
    assert isinstance(body.geometry, coal.ConvexBase), "a closed convex mesh is solid"
    points = body.geometry.points() @ body.placement.rotation.T + body.placement.translation
    return points.min(axis=0), points.max(axis=0)


@pytest.mark.parametrize(
    "name, write",
    [
        ("arm.STL", write_stl),
        ("arm part.obj", write_obj),
        ("metres.dae", write_collada(1, "Z_UP")),
        ("inches.dae", write_collada(0.0254, "Z_UP")),
        ("centimetres.DAE", write_collada(0.01, "Y_UP")),
        ("arm.glb", write_glb),
    ],
)
def test_a_mesh_beside_the_urdf_has_its_size(tmp_path, name, write):
    (tmp_path / "meshes").mkdir()
    write(tmp_path / "meshes" / name, BOX)
    for scale in (1.0, 0.5):
        (body,) = bodies_of(tmp_path, f"meshes/{name}", f'scale="{scale} {scale} {scale}"')
        np.testing.assert_allclose(corners(body), scale * np.array([BOX.min((0, 1)), BOX.max((0, 1))]), atol=1e-6)


def test_a_mesh_in_millimetres_is_refused_with_the_scale_that_it_lacks(tmp_path):
    write_stl(tmp_path / "arm.stl", 1e3 * BOX)
    with pytest.raises(ConfigurationError, match=r'link tool0 .*arm.stl, 950 m large.*scale="0.001 0.001 0.001"'):
        bodies_of(tmp_path, "arm.stl")
    (body,) = bodies_of(tmp_path, "arm.stl", 'scale="0.001 0.001 0.001"')
    np.testing.assert_allclose(np.ptp(corners(body), axis=0), SIZE, atol=1e-6)


def test_a_mesh_in_metres_with_the_scale_of_millimetres_is_refused(tmp_path):
    write_stl(tmp_path / "arm.stl", BOX)
    with pytest.raises(ConfigurationError, match=r"0.00095 m large"):
        bodies_of(tmp_path, "arm.stl", 'scale="0.001 0.001 0.001"')


def test_a_broken_collada_file_is_named(tmp_path):
    (tmp_path / "arm.dae").write_text("<COLLADA>")
    with pytest.raises(ConfigurationError, match=r"link tool0 collision mesh: .*arm.dae"):
        bodies_of(tmp_path, "arm.dae")
