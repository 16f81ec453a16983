"""Pictures of rviz without a display: a virtual display, a view file for it, a screenshot, and what can be seen in it.

Uses the programs Xvfb (X server in memory, drawn by the processor) and ImageMagick's `import`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml
from matplotlib import image

from construction_twin.core.errors import ConfigurationError

#: Longest wait for a program to answer [s].
TIMEOUT = 60.0
#: Hues of what is looked for in a picture: lowest and highest, as a fraction of the colour circle; least saturation and brightness.
COLOURS = {
    "orange": (0.03, 0.095, 0.6, 0.35),
    "pink": (0.87, 0.96, 0.45, 0.5),
    "green": (0.25, 0.45, 0.15, 0.1),
    "yellow": (0.105, 0.17, 0.35, 0.4),
    "violet": (0.68, 0.82, 0.15, 0.3),
    "red": (0.96, 0.02, 0.5, 0.3),
}


class VirtualDisplay:
    """An X server in memory with a number of its own choice, while the ``with`` block runs.

    Args:
        size: Width and height in pixels.

    Attributes:
        environment: For programs that are to show themselves there.
    """

    def __init__(self, size: tuple[int, int] = (1200, 800)):
        self.size = size
        self.environment: dict[str, str] = {}
        self._server: subprocess.Popen | None = None

    def __enter__(self) -> VirtualDisplay:
        """Start the server.

        Raises:
            ConfigurationError: If it is not installed or does not start.
        """
        if shutil.which("Xvfb") is None:
            raise ConfigurationError("Xvfb", None, "the program; apt-get install xvfb")
        read, write = os.pipe()
        screen = f"{self.size[0]}x{self.size[1]}x24"
        # without TCP; the server writes the number of its display when it is ready
        self._server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", screen, "-nolisten", "tcp", "+extension", "GLX"],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        if not number:
            self._server.wait()
            raise ConfigurationError("Xvfb", f"exit code {self._server.returncode}", "a display")
        self.environment = os.environ | {"DISPLAY": f":{number}", "LIBGL_ALWAYS_SOFTWARE": "1"}
        return self

    def __exit__(self, *_) -> None:
        self._server.terminate()
        self._server.wait(TIMEOUT)

    def capture(self, path: Path) -> np.ndarray:
        """Write what is shown as a PNG; return it as `read_picture` does."""
        subprocess.run(
            ["import", "-silent", "-window", "root", "-strip", str(path)],
            env=self.environment,
            check=True,
            timeout=TIMEOUT,
        )
        return read_picture(path)


def read_picture(path: Path) -> np.ndarray:
    """Return a PNG's red, green and blue, shape (height, width, 3), 0 to 1."""
    pixels = np.asarray(image.imread(path), dtype=float)
    return pixels[:, :, :3] if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)


def fraction(pixels: np.ndarray, colour: str) -> float:
    """Return which fraction of a picture has one of the `COLOURS`, light or in shadow."""
    return float(_has(pixels, colour).mean())


def extent(pixels: np.ndarray, colour: str) -> tuple[float, float]:
    """Return which fraction of a picture's width and height lies between the outermost pixels of one of the `COLOURS`.

    The outermost hundredth on each side does not count: a few stray pixels make nothing large. (0, 0) without any.
    """
    rows, columns = np.nonzero(_has(pixels, colour))
    if not len(rows):
        return 0.0, 0.0
    (left, right), (top, bottom) = np.percentile(columns, (1, 99)), np.percentile(rows, (1, 99))
    return float(right - left) / pixels.shape[1], float(bottom - top) / pixels.shape[0]


def _has(pixels: np.ndarray, colour: str) -> np.ndarray:
    """Return where a picture has one of the `COLOURS`, shape (height, width)."""
    low, high, saturation, value = COLOURS[colour]
    top, bottom = pixels.max(axis=2), pixels.min(axis=2)
    spread = top - bottom
    safe = np.maximum(spread, 1e-9)
    red, green, blue = np.moveaxis(pixels, 2, 0)
    hue = (
        np.where(
            top == red,
            (green - blue) / safe % 6,
            np.where(top == green, (blue - red) / safe + 2, (red - green) / safe + 4),
        )
        / 6
    )
    inside = (low <= hue) & (hue <= high) if low <= high else (low <= hue) | (hue <= high)
    return inside & (spread >= saturation * np.maximum(top, 1e-9)) & (top >= value)


def bare_view(text: str, size: tuple[int, int], view: str = "", camera: Mapping[str, object] | None = None) -> str:
    """Return a view file's text for a picture: no panels, the window as large as the display.

    Args:
        text: Of a file of rviz/.
        size: Width and height in pixels.
        view: One of the file's saved views.
        camera: Keys of the view that are to be different.

    Raises:
        ConfigurationError: If there is no such view.
    """
    settings = yaml.safe_load(text)
    views = settings["Visualization Manager"]["Views"]
    if view:
        saved = {entry["Name"]: entry for entry in views["Saved"]}
        if view not in saved:
            raise ConfigurationError("view", view, f"one of the saved views {sorted(saved)}")
        views["Current"] = saved[view] | {"Name": "Current View"}
    views["Current"] |= dict(camera or {})
    # a low frame rate will do; without a graphics card every frame costs processor time
    settings["Visualization Manager"]["Global Options"]["Frame Rate"] = 4
    settings["Panels"] = []
    settings["Window Geometry"] = {"Width": size[0], "Height": size[1], "X": 0, "Y": 0}
    return yaml.safe_dump(settings, sort_keys=False)
