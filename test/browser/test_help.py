"""Where a line of the status leads to: help in the person's language where there is some, at the place that the line names."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect


@pytest.mark.parametrize(
    ("language", "more", "heading"),
    [("de", "Mehr zu: Bewegung", "Bewegung (execution)"), ("en", "Read more about: Motion", "execution")],
)
def test_a_line_leads_to_help_in_the_person_s_language(page_of, robot, language, more, heading):
    page = page_of("reviewer-ada", query=f"?language={language}")
    with page.page.expect_popup() as opened:
        page.page.get_by_role("link", name=more).click()
    manual = opened.value
    expect(manual.locator("html")).to_have_attribute("lang", language)
    expect(manual.locator(":target")).to_have_text(heading)
    expect(manual.locator(":target")).to_be_in_viewport()


def test_german_help_leads_to_its_english_original_and_to_german_pages(page_of, robot):
    manual = page_of("reviewer-ada", query="?language=de").page
    manual.goto(manual.url.split("?")[0] + "docs/de/troubleshooting.html#twin-and-physical-arm-are-not-in-sync")
    expect(manual.locator(":target")).to_contain_text("Zwilling und Arm stimmen nicht überein")
    manual.get_by_role("link", name="was dann zu tun ist").click()
    expect(manual.locator(":target")).to_have_text("3. Hinsehen")
    manual.get_by_role("link", name="stalled_joint.md").click()
    expect(manual.locator("html")).to_have_attribute("lang", "en")
    expect(manual.locator("h1")).to_contain_text("A stalled joint")
