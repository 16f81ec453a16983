"""Tickets: whose count, and how long."""

from __future__ import annotations

import itertools

from construction_twin.console.tickets import MOST_ENDED, Tickets


def test_a_ticket_ends_with_the_last_connection_of_its_account_and_no_other_account_s():
    tickets = Tickets(map(str, itertools.count(1)).__next__, 8480)
    one, two = tickets.give(None), tickets.give(None)
    tickets.login(one, "ada")
    tickets.login(two, "bob")
    tickets.logout(one, "ada")
    assert not tickets.is_known(f"console_ticket_8480={one}")
    assert tickets.is_known(f"console_ticket_8480={two}")


def test_who_logs_in_again_and_again_does_not_fill_the_memory_and_the_open_ones_stay():
    tickets = Tickets(map(str, itertools.count(1)).__next__, 8480)
    first = tickets.give(None)
    tickets.login(first, "ada")
    given = [tickets.give(None) for _ in range(2 * MOST_ENDED)]
    for ticket in given:
        tickets.login(ticket, "ada")
        tickets.logout(ticket, "ada")
    known = [ticket for ticket in (first, *given) if tickets.is_known(f"console_ticket_8480={ticket}")]
    assert known == [first, *given[-MOST_ENDED:]]
