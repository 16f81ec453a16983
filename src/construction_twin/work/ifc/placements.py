"""Where products are: ``model_T_element`` in metres, with a loop or a placement that means nothing refused."""

from __future__ import annotations

import ifcopenshell
import ifcopenshell.util.placement
import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.ifc.notes import Where, label

#: Farther from the origin [m] no model is; map coordinates reach 1e7.
FARTHEST = 1e8


class Placements:
    """Placements of a file, each computed once.

    Args:
        name: The file's, for messages.
        unit: Metres per length unit.
    """

    def __init__(self, name: str, unit: float):
        self._name, self._unit = name, unit
        self._known: dict[int, np.ndarray | None] = {}

    def matrix(self, product: ifcopenshell.entity_instance) -> np.ndarray | None:
        """Return where a product is.

        Returns:
            Shape (4, 4). ``model_T_element`` [m]; None: on a grid or an alignment, where the geometry kernel knows it.

        Raises BuildingError.
        """
        with Where(self._name, product):
            placement = product.ObjectPlacement
        if placement is None:
            return np.eye(4)
        chain: dict[int, ifcopenshell.entity_instance] = {}
        while placement is not None and placement.id() not in self._known:
            if placement.id() in chain:
                raise BuildingError(
                    self._name, label(placement), Sentence("ifc.found.relative"), Sentence("ifc.no_loop")
                )
            chain[placement.id()] = placement
            with Where(self._name, placement):
                placement = placement.PlacementRelTo if placement.is_a("IfcLocalPlacement") else None
        parent = np.eye(4) if placement is None else self._known[placement.id()]
        for each in reversed(chain.values()):
            parent = self._step(parent, each)
            self._known[each.id()] = parent
        return parent

    def _step(self, parent: np.ndarray | None, placement: ifcopenshell.entity_instance) -> np.ndarray | None:
        if parent is None or not placement.is_a("IfcLocalPlacement"):
            return None
        with Where(self._name, placement), np.errstate(all="ignore"):
            relative = np.array(
                ifcopenshell.util.placement.get_axis2placement(placement.RelativePlacement), dtype=float
            )
            relative[:3, 3] *= self._unit
            # IFC's x axis is the given one projected at right angles to z
            relative[:3, 0] = np.cross(relative[:3, 1], relative[:3, 2])
            matrix = parent @ relative
        check_rigid(self._name, placement, matrix)
        return matrix


def check_rigid(name: str, entity: object, matrix: np.ndarray) -> None:
    """Check that a matrix is a rotation and a shift that a building can have.

    Raises BuildingError.
    """
    if not np.isfinite(matrix).all() or not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-6):
        raise BuildingError(name, label(entity), Sentence("ifc.found.axes"), Sentence("ifc.no_axes"))
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        far = Sentence("ifc.found.far", distance=float(np.abs(matrix[:3, 3]).max()))
        raise BuildingError(name, label(entity), far, Sentence("ifc.at_most", most=FARTHEST))
