"""Pictures and videos of a rehearsal, drawn by MuJoCo without a screen: the shapes that are simulated, in RGB, 8 bits.

It draws by EGL, or by OSMesa in software where there is none; the environment variable ``MUJOCO_GL`` chooses one. Who wants no
picture needs neither.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator, Set
from dataclasses import dataclass

import mujoco
import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.physics.arm import SimulatedArm
from construction_twin.extensions.physics.model import PhysicsModel

#: Pixels of a picture, even, as video encoders ask.
WIDTH, HEIGHT = 960, 720
#: How OpenGL is reached without a screen, the preferred way first.
WAYS = ("egl", "osmesa")
#: Colours: links, what the arm carries or may move, what stands, what touches although the plan has no contact.
_LINK, _LOAD, _STANDS, _TOUCHES = (
    (1.0, 0.45, 0.05), (0.2, 0.45, 0.75), (0.65, 0.65, 0.62), (0.9, 0.05, 0.1),
)  # fmt: skip
#: What stands lets so much of its colour be seen.
_VEILED = 0.5
#: The camera stands so many times as far off as the arm reaches in the film, and looks from here [deg].
_AWAY, _AZIMUTH, _ELEVATION = 2.6, 150.0, -24.0


@dataclass(frozen=True, eq=False)
class _Frame:
    time: float
    physics: PhysicsModel
    positions: np.ndarray


class Film:
    """What a rehearsal looked like in each cycle. `watch` is `Rehearsal.of_plan`'s ``progress``."""

    def __init__(self) -> None:
        self._frames: list[_Frame] = []

    def watch(self, time: float, arm: SimulatedArm) -> None:
        """Keep what is there at a time of the plan [s]."""
        self._frames.append(_Frame(time, arm.physics, arm.data.qpos.copy()))

    def picture(self, time: float, touching: Set[str] = frozenset()) -> np.ndarray:
        """Return the picture at a time of the plan [s], shape (`HEIGHT`, `WIDTH`, 3), 8 bits."""
        frame = min(self._frames, key=lambda one: abs(one.time - time))
        artist = _Artist(self._frames, touching)
        try:
            return artist.draw(frame)
        finally:
            artist.close()

    def pictures(self, rate: float, touching: Set[str] = frozenset()) -> Iterator[np.ndarray]:
        """Yield the pictures of the whole film, `rate` per second; raises like `picture`."""
        artist = _Artist(self._frames, touching)
        try:
            for number in self._numbers(rate):
                yield artist.draw(self._frames[number])
        finally:
            artist.close()

    def count(self, rate: float) -> int:
        """Return how many pictures that are."""
        return len(self._numbers(rate))

    def _numbers(self, rate: float) -> list[int]:
        times = np.array([frame.time for frame in self._frames])
        wanted = np.arange(times[0], times[-1] + 1e-9, 1.0 / rate)
        return np.minimum(np.searchsorted(times, wanted - 1e-9), len(times) - 1).tolist()


class _Artist:
    """Draws frames of a film; `close` gives back what the graphics have lent."""

    def __init__(self, frames: list[_Frame], touching: Set[str]):
        self._touching = touching
        self._gl = open_context()
        self._camera = _camera(frames)
        self._physics: PhysicsModel | None = None
        self._context: mujoco.MjrContext | None = None
        self._rectangle = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)

    def draw(self, frame: _Frame) -> np.ndarray:
        """Return a frame's picture, shape (`HEIGHT`, `WIDTH`, 3), 8 bits."""
        model = frame.physics.model
        if frame.physics is not self._physics:
            # a model has its own context
            self._physics = frame.physics
            _colour(frame.physics, self._touching)
            self._data = mujoco.MjData(model)
            model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
            if self._context is not None:
                self._context.free()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
            self._scene = mujoco.MjvScene(model, maxgeom=2 * model.ngeom + 100)
        self._data.qpos[:] = frame.positions
        mujoco.mj_forward(model, self._data)
        mujoco.mjv_updateScene(
            model, self._data, mujoco.MjvOption(), None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        pixels = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rectangle, self._context)
        return np.flipud(pixels)

    def close(self) -> None:
        """Give back what the graphics have lent."""
        if self._context is not None:
            self._context.free()
        self._gl.free()


def open_context():
    """Return a context of OpenGL that is current, for pictures of `WIDTH` and `HEIGHT`; ``free`` gives it back."""
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    problems = []
    for way in [chosen] if chosen in WAYS else WAYS:
        try:
            context = importlib.import_module(f"mujoco.{way}").GLContext(WIDTH, HEIGHT)
            context.make_current()
        except Exception as error:  # noqa: BLE001 (drivers fail in ways of their own: no library, no device, no such call)
            problems.append(f"{way}: {' '.join(str(error).split())}")
            # PyOpenGL keeps the first way for good otherwise
            os.environ.pop("PYOPENGL_PLATFORM", None)
            for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
                del sys.modules[name]
        else:
            return context
    raise ConstructionTwinError(f"no picture can be drawn here: {'; '.join(problems)}")


def _camera(frames: list[_Frame]) -> mujoco.MjvCamera:
    """Return a camera that sees the arm, wherever it is in the film."""
    seen = []
    for frame in frames[:: max(1, len(frames) // 20)]:
        model = frame.physics.model
        data = mujoco.MjData(model)
        data.qpos[:] = frame.positions
        mujoco.mj_kinematics(model, data)
        seen += [data.body(model.body(number).name).xpos.copy() for number in model.jnt_bodyid[frame.physics.joints]]
    low, high = np.min(seen, axis=0), np.max(seen, axis=0)
    low[2] = min(low[2], 0.0)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = (low + high) / 2.0
    camera.distance = _AWAY * max(0.5, float(np.linalg.norm(high - low)) / 2.0) + 0.5
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    return camera


def _colour(physics: PhysicsModel, touching: Set[str]) -> None:
    """Give each geom its colour."""
    model = physics.model
    for geom, owner in enumerate(physics.owners):
        moves = bool(model.body_weldid[model.geom_bodyid[geom]])
        is_link = owner in physics.links
        colour = _TOUCHES if owner in touching else _LINK if is_link else _LOAD if moves else _STANDS
        # what stands may hide the arm
        model.geom_rgba[geom] = (*colour[:3], 1.0 if moves or is_link else _VEILED)
    model.vis.headlight.ambient, model.vis.headlight.diffuse = [0.45] * 3, [0.55] * 3
