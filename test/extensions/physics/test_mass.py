import math
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.physics.mass import LEAST_MASS, MassProperties, combined, of_link, of_shape

SIZES = st.tuples(*[st.floats(0.02, 3.0)] * 3)


@given(SIZES)
@settings(deadline=None)
def test_a_box_weighs_its_volume_and_turns_like_one(size):
    found = of_shape(coal.Box(*size), 800.0)
    x, y, z = size
    mass = 800.0 * x * y * z
    assert found.mass == pytest.approx(mass)
    assert found.estimated
    expected = mass / 12.0 * np.diag((y * y + z * z, x * x + z * z, x * x + y * y))
    np.testing.assert_allclose(found.inertia, expected, rtol=1e-9, atol=1e-12)


def wedge(turned: bool) -> coal.BVHModelOBBRSS:
    """Return a tetrahedron whose triangles are in order, or turned inside out."""
    mesh = coal.BVHModelOBBRSS()
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    mesh.beginModel(len(faces), len(corners))
    for corner in corners:
        mesh.addVertex(np.array(corner))
    for one, two, three in faces:
        order = (one, three, two) if turned else (one, two, three)
        mesh.addTriangle(*(np.array(corners[corner]) for corner in order))
    mesh.endModel()
    return mesh


def test_a_mesh_that_is_inside_out_weighs_the_same():
    right, turned = of_shape(wedge(False)), of_shape(wedge(True))
    assert right.mass == pytest.approx(1000.0 / 6.0)
    np.testing.assert_allclose(right.centre, 0.25)
    assert turned.mass == pytest.approx(right.mass)
    np.testing.assert_allclose(turned.centre, right.centre)
    np.testing.assert_allclose(turned.inertia, right.inertia)


@given(SIZES, SIZES, st.floats(-math.pi, math.pi))
@settings(deadline=None)
def test_parts_together_are_what_pinocchio_makes_of_them(one, other, angle):
    away = pinocchio.SE3(pinocchio.utils.rpyToMatrix(angle, 0.3, -angle), np.array((0.4, -angle, 0.2)))
    parts = [of_shape(coal.Box(*one)), of_shape(coal.Box(*other)).at(away)]
    expected = sum_of([pinocchio.Inertia(part.mass, part.centre, part.inertia) for part in parts])
    found = combined(parts)
    assert found.mass == pytest.approx(expected.mass)
    np.testing.assert_allclose(found.centre, expected.lever, atol=1e-9)
    np.testing.assert_allclose(found.inertia, expected.inertia, rtol=1e-9, atol=1e-9)


def sum_of(inertias: list[pinocchio.Inertia]) -> pinocchio.Inertia:
    total = inertias[0]
    for one in inertias[1:]:
        total = total + one
    return total


def link(inertia: pinocchio.Inertia, *shapes: coal.CollisionGeometry, name: str = "a") -> MassProperties:
    """Return what a link is taken for that has this inertia in its URDF, and these shapes."""
    bodies = [SimpleNamespace(joint=1, geometry=shape, placement=pinocchio.SE3.Identity()) for shape in shapes]
    model = SimpleNamespace(names=["universe", name], inertias=[None, inertia])
    return of_link(SimpleNamespace(model=model, bodies=bodies), 1)[0]


def test_a_link_of_unknown_mass_is_estimated_from_its_shapes():
    ball = coal.Sphere(0.1)
    assert link(pinocchio.Inertia.Zero(), ball).mass == pytest.approx(of_shape(ball).mass)
    assert link(pinocchio.Inertia.Zero()).mass == LEAST_MASS
    assert link(pinocchio.Inertia(3.0, np.zeros(3), np.eye(3)), ball).mass == 3.0


def test_an_inertia_that_no_body_has_is_refused_with_its_link():
    with pytest.raises(ConfigurationError) as refusal:
        link(pinocchio.Inertia(3.0, np.zeros(3), np.diag((1.0, 1.0, 3.0))), name="forearm")
    assert "principal moments" in refusal.value.expected
    assert "forearm" in str(refusal.value)
