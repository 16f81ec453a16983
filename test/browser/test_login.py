"""Who gets in, and what each role may do: the broker decides, the page tells."""

from __future__ import annotations

import pytest
from console_page import ConsolePage
from playwright.sync_api import expect


@pytest.mark.parametrize("file", ["main.*.js", "sentences.*.json"])
def test_where_the_page_s_script_or_its_words_do_not_arrive_a_line_says_what_to_do(browser, site, file):
    """As when the tablet changes from one network to another while it loads."""
    page = ConsolePage(browser, site.url)
    try:
        page.page.route(f"**/{file}", lambda route: route.abort("internetdisconnected"))
        page.open("?language=de")
        expect(page.page.locator("#loading")).to_contain_text("reload the page: nothing can be stopped from here")
        page.page.unroute_all()
        page.page.reload()
        expect(page.page.locator(".login")).to_be_visible()
        expect(page.page.locator("#loading")).to_have_count(0)
    finally:
        page.close()


def test_a_wrong_password_is_told_and_opens_nothing(page_of, site, robot):
    page = page_of()
    page.try_login("ada", "guess")
    expect(page.page.locator(".login .wrong")).to_have_text("The broker refuses this account or its password.")
    expect(page.page.locator(".robots button")).to_have_count(0)
    assert page.page.evaluate("async () => (await fetch('/private/one/robot.urdf')).status") == 403
    # and the password is not kept in the field
    expect(page.page.locator(".login input[name=password]")).to_have_value("")
    # who has mistyped gets in
    page.login("ada", site.password("ada"))
    assert "wrong account or password" in site.log.read_text()


def test_a_reload_keeps_the_login_of_this_tab_and_logging_out_ends_it(page_of, site, robot):
    page = page_of("ada")
    page.page.reload()
    expect(page.page.locator(".account")).to_contain_text("ada")
    other = page.context.new_page()
    other.goto(site.url)
    expect(other.locator(".login")).to_be_visible()
    page.page.locator(".menu > summary").click()
    page.page.locator(".menu-items").get_by_text("Log out").click()
    expect(page.page.locator(".login")).to_be_visible()
    page.page.reload()
    expect(page.page.locator(".login")).to_be_visible()
    expect(page.page.locator(".login input[name=password]")).to_have_value("")


def test_an_account_sees_its_own_robot_only(page_of, site, robot):
    page = page_of("ada")
    with site.robot("two"):
        # what comes through now comes after what the other one has said
        robot.show_plan(source="robot one")
        expect(page.page.locator(".verdict-title")).to_contain_text("robot one")
        expect(page.page.locator(".robots button")).to_have_text(["one"])
