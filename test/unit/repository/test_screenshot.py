"""What is found in a picture."""

from __future__ import annotations

import numpy as np
import pytest
from screenshot import COLOURS, bare_view, extent, fraction

from construction_twin.core.errors import ConfigurationError

ORANGE, GREY, GREEN = (1.0, 0.46, 0.08), (0.65, 0.66, 0.67), (0.2, 0.5, 0.25)


def picture(height: int = 100, width: int = 200) -> np.ndarray:
    return np.full((height, width, 3), GREY)


def test_a_colour_that_is_not_there_has_no_share_and_no_extent():
    for colour in COLOURS:
        assert fraction(picture(), colour) == 0.0
        assert extent(picture(), colour) == (0.0, 0.0)


@pytest.mark.parametrize("light", [1.0, 0.7, 0.45])
def test_a_patch_is_found_in_light_and_in_shadow(light):
    pixels = picture()
    pixels[20:60, 50:150] = np.array(ORANGE) * light
    assert fraction(pixels, "orange") == pytest.approx(40 * 100 / 20000)
    width, height = extent(pixels, "orange")
    assert width == pytest.approx(0.5, abs=0.02) and height == pytest.approx(0.4, abs=0.02)


def test_stray_pixels_make_nothing_large():
    pixels = picture()
    pixels[40:60, 90:110] = ORANGE
    pixels[0, 0] = pixels[99, 199] = ORANGE
    assert extent(pixels, "orange") == pytest.approx((0.1, 0.2), abs=0.03)


def test_colours_are_told_apart():
    pixels = picture()
    pixels[:50] = GREEN
    assert fraction(pixels, "green") == 0.5 and fraction(pixels, "orange") == 0.0


def test_a_view_that_is_not_saved_is_refused_with_the_names_that_are():
    text = "Visualization Manager: {Views: {Current: {}, Saved: [{Name: cell}, {Name: tool}]}, Global Options: {}}"
    with pytest.raises(ConfigurationError, match="cell.*tool"):
        bare_view(text, (10, 10), "roof")
