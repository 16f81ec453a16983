"""Pictures of bodies that stand still."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.physics import film
from construction_twin.physics.still import StandingBody, still

CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3)))


@pytest.fixture
def with_graphics():
    try:
        film.open_context().free()
    except ConstructionTwinError as error:
        pytest.skip(f"nothing draws here: {error}")


def of_colour(pixels: np.ndarray, channel: int) -> np.ndarray:
    """Return which pixels are of one of the three colours, in some light."""
    others = [each for each in range(3) if each != channel]
    return (pixels[..., channel] > 60) & (pixels[..., others].max(axis=-1) < 0.5 * pixels[..., channel])


def test_what_stands_in_front_is_what_is_seen(with_graphics):
    # from the right, in front and above, the red one hides the green one
    behind, front = StandingBody(CUBE, (0.1, 0.9, 0.1)), StandingBody(CUBE * 3.0 + (1.5, -3.5, 0.0), (0.9, 0.1, 0.1))
    for bodies in ((behind, front), (front, behind)):
        pixels = still(bodies)
        assert pixels.shape == (film.HEIGHT, film.WIDTH, 3)
        red, green = of_colour(pixels, 0), of_colour(pixels, 1)
        assert red.mean() > 0.1 and green.mean() < 0.02
    apart = still((behind, StandingBody(CUBE + (3.0, 0.0, 0.0), (0.9, 0.1, 0.1))))
    assert of_colour(apart, 0).sum() == pytest.approx(of_colour(apart, 1).sum(), rel=0.15)


@pytest.mark.parametrize("size", [0.02, 1.0, 50.0])
def test_everything_is_in_the_picture_whatever_its_size(with_graphics, size):
    pixels = still([StandingBody(CUBE * (size, 4 * size, size) + 1.0, (0.1, 0.2, 0.9))])
    inside = np.argwhere((pixels < 250).any(axis=-1))
    low, high = inside.min(axis=0), inside.max(axis=0)
    assert (low > 2).all() and (high < np.array((film.HEIGHT, film.WIDTH)) - 3).all()
    assert max((high - low) / (film.HEIGHT, film.WIDTH)) > 0.8
    # edges are dark, the sides are not
    assert 0.002 < (pixels.max(axis=-1) < 60).mean() < 0.1
