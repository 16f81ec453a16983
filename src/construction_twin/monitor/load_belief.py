"""Does the model of the arm carry what the arm does? Only then can its torques be expected.

The scene says what the arm carries. While a work plan stands at a boundary, the tool takes something up or lets go of it: then
nobody knows for a moment, until the scene is the one that the plan expects and the model is that scene's. Pure.
"""

from __future__ import annotations


class LoadBelief:
    """What is known of the load; before the first scene nothing."""

    def __init__(self) -> None:
        self._scene = ""
        #: What is to be carried, and what the model carries; None: nothing is known, there is no model.
        self._load: object = None
        self._modelled: object = None
        self._at_boundary = False
        #: Hash of the scene that the plan waits for, until it is heard: the executor may go on before.
        self._expected = ""

    @property
    def counts(self) -> bool:
        """Whether the model carries what the arm does."""
        return not self._at_boundary and not self._expected and self.is_modelled

    @property
    def is_modelled(self) -> bool:
        """Whether the model is that of the newest scene."""
        return self._load is not None and self._load == self._modelled

    def on_execution(self, active: bool, at_boundary: bool, expected_scene: str) -> None:
        """Take whether a plan is played and stands at a boundary, and the hash of the scene that it waits for; empty: none."""
        self._at_boundary = active and at_boundary
        if not active:
            self._expected = ""
        elif expected_scene and expected_scene != self._scene:
            self._expected = expected_scene

    def on_scene(self, scene: str, load: object) -> None:
        """Take the hash of the newest scene, and what the arm carries in it: anything that is equal for an equal load."""
        self._scene, self._load = scene, load
        if scene == self._expected:
            self._expected = ""

    def on_model(self, load: object) -> None:
        """Take what the model carries now."""
        self._modelled = load
