"""OpenConnections of connections: who has to go for whom."""

from __future__ import annotations

from construction_twin.console.connection_limits import ConnectionLimits, OpenConnections


def test_the_address_with_the_most_loses_its_oldest_and_no_other():
    connections = OpenConnections(ConnectionLimits(anonymous=4, anonymous_per_address=3))
    assert [connections.enter(number, address) for number, address in enumerate("abb", 1)] == [None] * 3
    assert connections.enter(4, "c") is None
    assert connections.enter(5, "d") == 2
    # all have one: the oldest of all
    assert connections.enter(6, "e") == 1


def test_an_address_that_is_full_loses_its_own_oldest_however_much_room_there_is():
    connections = OpenConnections(ConnectionLimits(anonymous=100, anonymous_per_address=2))
    assert [connections.enter(number, address) for number, address in enumerate("baaaa")] == [None, None, None, 1, 2]


def test_who_is_logged_in_is_no_visitor_any_more_and_never_has_to_go():
    connections = OpenConnections(ConnectionLimits(anonymous=1, anonymous_per_address=1))
    connections.enter(1, "a")
    assert connections.login(1, "ada") == ""
    assert [connections.enter(number, "a") for number in (2, 3)] == [None, 2]
    assert connections.login(2, "ada") == "the connection has ended"


def test_the_places_of_an_account_are_its_own_and_free_when_it_leaves():
    connections = OpenConnections(ConnectionLimits(logins=3, logins_per_account=2))
    for number in range(1, 6):
        connections.enter(number, f"address {number}")
    assert [connections.login(number, "ada") for number in (1, 2)] == ["", ""]
    assert connections.login(3, "ada") == "too many connections are logged in to this account"
    assert connections.login(4, "bob") == ""
    assert connections.login(5, "eve") == "too many connections are logged in"
    connections.leave(1)
    assert connections.login(3, "ada") == ""


def test_a_broker_without_accounts_has_no_limit_per_account():
    connections = OpenConnections(ConnectionLimits(logins_per_account=1))
    for number in (1, 2):
        connections.enter(number, "a")
        assert connections.login(number, "") == ""


def test_one_account_fills_no_address_and_the_last_places_are_for_others():
    connections = OpenConnections(
        ConnectionLimits(logins_per_address=6, logins_per_account_and_address=3, kept_per_address=2)
    )
    numbers = iter(range(100))

    def login(account: str, address: str = "a") -> str:
        number = next(numbers)
        connections.enter(number, address)
        return connections.login(number, account)

    kept = "the last places of this address are kept for other accounts"
    assert [login("ada") for _ in range(4)] == [
        *[""] * 3,
        "too many connections from this address are logged in to this account",
    ]
    assert login("ada", "b") == ""
    assert [login("bob") for _ in range(2)] == ["", kept]
    assert [login("cy"), login("cy"), login("dee")] == ["", kept, ""]
    assert login("eve") == "too many connections from this address are logged in"


def test_a_broker_without_accounts_has_places_for_nobody_in_particular():
    connections = OpenConnections(
        ConnectionLimits(logins_per_address=2, logins_per_account_and_address=1, kept_per_address=1)
    )
    for number in (1, 2):
        connections.enter(number, "a")
        assert connections.login(number, "") == ""
