"""Where a line of the status leads to: the page of the docs, at the place that the line names."""

from __future__ import annotations

from playwright.sync_api import expect


def test_a_line_leads_to_its_page_of_the_docs(page_of, robot):
    page = page_of("ada", query="?language=de")
    with page.page.expect_popup() as opened:
        page.page.get_by_role("link", name="Mehr zu: Bewegung").click()
    manual = opened.value
    expect(manual.locator("html")).to_have_attribute("lang", "en")
    expect(manual.locator(":target")).to_have_text("execution")
    expect(manual.locator(":target")).to_be_in_viewport()
