import pytest

from telenano.serving.access import Access, Role, is_loopback
from telenano.wire.errors import ConfigError

OPERATOR, OBSERVER = "o" * 20, "p" * 20


def test_a_token_gives_its_role_and_no_other() -> None:
    access = Access.made(operator=OPERATOR, observer=OBSERVER)
    assert access.role_of(OPERATOR) is Role.OPERATOR
    assert access.role_of(OBSERVER) is Role.OBSERVER
    for wrong in ("", OPERATOR[:-1], OPERATOR + "o", "ö" * 20):
        assert access.role_of(wrong) is None


def test_tokens_that_are_not_given_are_new_each_time() -> None:
    first, second = Access.made(), Access.made()
    tokens = {first.operator_token, first.observer_token, second.operator_token, second.observer_token}
    assert len(tokens) == 4
    assert min(map(len, tokens)) >= 32


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ({"operator": "short"}, "5 characters"),
        ({"operator": OPERATOR, "observer": OPERATOR}, "are the same"),
        ({"origins": ["https://app.foxglove.dev/"]}, "--allow-origin https://app"),
        ({"allow": ["10.0.0.0/33"]}, r"--allow 10\.0\.0\.0/33"),
    ],
)
def test_access_that_protects_nothing_is_refused(given: dict[str, object], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        Access.made(**given)  # type: ignore[arg-type]


def test_only_allowed_addresses_and_names_are_admitted() -> None:
    access = Access.made(names=["rig.example"], allow=["10.1.2.0/24"])
    assert access.admits_address("127.0.0.1")
    assert access.admits_address("10.1.2.77")
    assert not access.admits_address("10.1.3.77")
    assert not access.admits_address("")
    assert access.admits_host("rig.example:8650")
    assert access.admits_host("[::1]:8650")
    assert not access.admits_host("evil.example:8650")
    assert not access.admits_host("")


@pytest.mark.parametrize(
    "origin",
    ["", "null", "http://evil.example", "http://127.0.0.1:1", "http://127.0.0.1:8650.evil", "https://127.0.0.1:8650"],
)
def test_a_page_of_another_origin_is_not_admitted(origin: str) -> None:
    assert not Access.made().admits_origin(origin, "127.0.0.1:8650")


def test_the_own_page_is_admitted() -> None:
    assert Access.made().admits_origin("http://127.0.0.1:8650", "127.0.0.1:8650")
    assert Access.made().admits_origin("https://rig.example", "rig.example", encrypted=True)
    assert not Access.made().admits_origin("http://rig.example", "rig.example", encrypted=True)


def test_pages_of_other_origins_are_admitted_by_name_alone() -> None:
    access = Access.made(origins=["", "https://app.foxglove.dev", "null"])
    for origin in ("", "https://app.foxglove.dev", "null", "http://127.0.0.1:8765"):
        assert access.admits_origin(origin, "127.0.0.1:8765")
    for origin in ("https://app.foxglove.dev.evil", "http://app.foxglove.dev", "https://evil.example"):
        assert not access.admits_origin(origin, "127.0.0.1:8765")


@pytest.mark.parametrize(
    ("host", "expected"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("rig", False)]
)
def test_what_only_this_machine_reaches(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected
