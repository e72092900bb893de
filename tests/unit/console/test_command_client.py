import re
from pathlib import Path
from typing import Any

import pytest
from command_table import NODES
from recorder_samples import sample

from telenano.console.send_commands import (
    OBEYED_BY,
    Asked,
    Attention,
    _in_force,
    addressed,
    asked,
    parse_parameters,
    send_control,
)
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.wiring.participant import Participant
from telenano.settings import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.settings.config import validate
from telenano.testing import VirtualClock
from telenano.wire.errors import ConfigError
from telenano.wire.messages import SessionEvent


@pytest.mark.parametrize(
    ("target", "nodes"),
    [
        ("afm_node", {"afm_node@slave"}),
        ("controller", {"controller@master", "controller@slave"}),
        ("controller@slave", {"controller@slave"}),
        ("delay_node", {"delay_node@master"}),
        ("*@slave", {"controller@slave", "afm_node@slave"}),
    ],
)
def test_a_target_means_nodes_of_the_site(target: str, nodes: set[str]) -> None:
    assert set(addressed(AddressBook.load(DEFAULT_SITE_FILE), target)) == nodes


def test_a_target_that_means_nobody_lists_the_nodes() -> None:
    with pytest.raises(ConfigError, match=r"'hand'.*haptic_node@master"):
        addressed(AddressBook.load(DEFAULT_SITE_FILE), "hand")


def test_a_console_at_the_slave_reaches_the_nodes_there() -> None:
    book = AddressBook.load(TWO_SITES_FILE)
    assert set(addressed(book, "*", "slave")) == {"afm_node@slave", "controller@slave", "recorder@slave"}
    assert addressed(book, "controller", "slave") == ["controller@slave"]
    assert set(addressed(book, "controller")) == {"controller@master", "controller@slave"}
    with pytest.raises(ConfigError, match=r"'haptic_node'.*haptic_node@master is commanded from the master"):
        addressed(book, "haptic_node", "slave")


HAND, TIP, LINK, HALVES = (
    "haptic_node@master",
    "afm_node@slave",
    "delay_node@master",
    ("controller@master", "controller@slave"),
)


@pytest.mark.parametrize(
    ("command", "target", "site", "who"),
    [
        ("arm", "*", "master", Asked((HAND, TIP))),
        ("arm", "*", "slave", Asked((TIP,), (HAND,))),
        ("arm", "afm_node", "slave", Asked((TIP,))),
        ("start", "*", "master", Asked((HAND,))),
        ("stop", "*", "master", Asked((HAND,))),
        ("stop", "afm_node", "master", Asked((TIP,))),
        ("set", "*", "master", Asked((*HALVES, LINK))),
        ("set", "controller", "slave", Asked((HALVES[1],), (HALVES[0],))),
        ("mark", "*", "master", Asked(("recorder@master", "recorder@slave"))),
        ("mark", "recorder@slave", "slave", Asked(("recorder@slave",))),
        ("estop", "*@slave", "master", Asked((TIP,))),
    ],
)
def test_who_is_asked_follows_from_site_file_and_target(command: Any, target: str, site: Any, who: Asked) -> None:
    found = asked(AddressBook.load(TWO_SITES_FILE), Command(command, target), site)
    assert tuple(map(sorted, found)) == tuple(map(sorted, who))


def test_a_pattern_that_means_none_who_obeys_says_who_does() -> None:
    with pytest.raises(
        ConfigError, match=r"no node that '\*@slave' means obeys start without its name: haptic_node does"
    ):
        asked(AddressBook.load(TWO_SITES_FILE), Command("start", "*@slave"))


def test_who_obeys_a_pattern_is_what_the_nodes_say() -> None:
    kinds = {name: kind.commands for name, kind in NODES.items()}
    assert {command: set(names) for command, names in OBEYED_BY.items()} == {
        command: {name for name, commands in kinds.items() if command in commands} for command in OBEYED_BY
    }
    assert {command for commands in kinds.values() for command in commands} == set(OBEYED_BY)


def test_a_site_file_without_a_console_at_the_site_is_named() -> None:
    with pytest.raises(ConfigError, match="a console@slave of this machine is missing"):
        send_control(Command("estop", "*"), DEFAULT_SITE_FILE, "slave", lambda event: None)


def test_parameters_are_flags_numbers_or_text() -> None:
    given = parse_parameters(["a=true", "b.c=3", "d=1e-9", "e=two words", "f=a=b", "g="])
    assert given == {"a": True, "b.c": 3, "d": 1e-9, "e": "two words", "f": "a=b", "g": ""}
    assert [type(value) for value in given.values()] == [bool, int, float, str, str, str]


@pytest.mark.parametrize("pair", ["x", "=1", "x=nan", "x=inf", "x=-inf", f"x={2**63}"])
def test_a_parameter_that_cannot_be_sent_is_named(pair: str) -> None:
    with pytest.raises(ConfigError, match="^" + re.escape(pair)):
        parse_parameters([pair])


ALIVE = ("afm_node@slave", "controller@master")


@pytest.mark.parametrize(
    ("lateness_s", "turns_s", "heard", "why"),
    [
        (1e-4, 0.02, 10, "it runs, and reports in time"),
        (0.4, 0.02, 10, "the rig is late by 0.4 s (afm_node@slave), so that the command may not have been read yet"),
        (1e-4, 0.52, 10, "the rig is late by 0.5 s (this command), so that the command may not have been read yet"),
        # it was heard for a second, and then no more
        (1e-4, 0.02, 2, "the rig is late by 3.5 s (afm_node@slave), so that the command may not have been read yet"),
    ],
)
def test_a_node_that_has_not_answered_is_said_to_be_silent_or_late(
    lateness_s: float, turns_s: float, heard: int, why: str
) -> None:
    attention = Attention(0.0)
    for number in range(round(5.0 / turns_s)):
        attention.turn((number + 1) * turns_s)
    for report in range(10):
        for node, late_s in zip(ALIVE, (lateness_s, 1e-4), strict=True):
            if node != "afm_node@slave" or report < heard:
                told = sample("node/health", report, src=node, lateness_max_s=late_s)
                attention.heard(told, 0.5 * (report + 1))
    assert {attention.why(node, 5.0) for node in ALIVE} == {why}
    assert attention.why("recorder@master", 5.0) == "nothing was heard of it"


def test_commands_are_typed_at_the_console_of_ones_own_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path / "keys"))
    monkeypatch.delenv("TELENANO_MACHINE", raising=False)
    nodes: dict[str, Any] = {
        "console@master": "ipc:///run/console",
        "console_desk@master": {"network": "tcp://{desk}:5707", "machine": "desk"},
        "controller@slave": "tcp://{slave}:5711",
    }
    machines = {"slave": "10.0.0.2", "desk": "10.0.0.3"}
    book = validate(AddressBook, {"nodes": nodes, "machines": machines}, "site.yaml")
    Keyring(tmp_path / "keys").create("desk")

    def console() -> str:
        with Participant.at_console(book, "master") as participant:
            return participant.key

    assert console() == "console_desk@master"
    # with the keys of two machines here, as where one tries both, the site's own console comes first
    Keyring(tmp_path / "keys").create("master")
    assert console() == "console@master"
    monkeypatch.setenv("TELENANO_MACHINE", "desk")
    assert console() == "console_desk@master"
    monkeypatch.setenv("TELENANO_MACHINE", "slave")
    with pytest.raises(ConfigError, match=r"console@master, console_desk@master is on another machine"):
        console()
    assert addressed(book, "*") == ["controller@slave"]


@pytest.mark.parametrize("readers", [0, 1])
@pytest.mark.parametrize("expected", [("afm_node@slave", "haptic_node@master"), ("afm_node@slave",)])
@pytest.mark.parametrize("heard", [(), ("ack",), ("refused",), ("expired",)])
def test_a_command_that_was_read_and_not_answered_is_said_to_be_in_force_perhaps(
    readers: int, expected: tuple[str, ...], heard: tuple[str, ...]
) -> None:
    sent: list[dict[str, Any]] = []
    arm = Command("arm", "*", expected)
    client = CommandClient(VirtualClock(), lambda topic, **fields: sent.append(fields), [arm])
    client.advance()
    for node in expected:
        for kind in heard:
            data = {"expired": True} if kind == "expired" else {}
            kind = "ack" if kind == "ack" else "refused"
            fields: dict[str, Any] = {"id": sent[-1]["id"], "kind": kind, "level": "info", "text": "", "data": data}
            client.on_event(SessionEvent(seq=0, t_ns=0, src=node, v=1, **fields))
    text = _in_force([arm], client, readers)
    assert ("arm was sent and may be in force all the same" in text) == bool(readers and not heard)
    assert ("`telenano estop` stops them" in text) == bool(text)
