"""What packages advise is told as a warning of the launcher, and an adviser that fails ends itself and no session."""

import sys
from collections.abc import Iterable, Sequence
from typing import Any

import pytest
from launcher_bench import Rig

from telenano.doctor.checks import check_advisers
from telenano.extend.advice import Advice, AdvisedSession
from telenano.launcher import advisers
from telenano.launcher.advisers import Advisers, advisers_for
from telenano.launcher.run import advised_of
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.log import StructuredLog
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.settings.plugins import LoadedEntries, Plugin
from telenano.testing.filled_messages import examples
from telenano.wire.messages import Message, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import TOPICS

STATUS = examples(TOPICS["law/status"])["ordinary"]
LOG = StructuredLog("launcher@master")


class Reader:
    """What has come since it was read last."""

    drained = True

    def __init__(self) -> None:
        self.waiting: list[Message] = []

    def receive(self) -> Sequence[Received]:
        waiting, self.waiting = self.waiting, []
        return [Received("", message, b"", 0, Arrival.NEXT) for message in waiting]


class EveryMessage:
    """An adviser that warns of each law/status of a session that runs."""

    inputs: Sequence[str] = ("law/status",)

    def __init__(self) -> None:
        self.looks: list[bool] = []

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        self.looks.append(runs)
        return Advice("Mind the law.", {"seen": 1.0}) if runs and list(messages) else None


class Failing(EveryMessage):
    """An adviser that fails at its second look."""

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        super().look(messages, runs=runs)
        if len(self.looks) > 1:
            raise OSError("no table")
        return None


class AdvisedRig(Rig):
    """A rig with these advisers."""

    def __init__(self, **named: Any) -> None:
        super().__init__(3600.0)
        self.reader = Reader()
        readers: Any = [self.reader]
        self.session.advisers = Advisers(LOG, named, readers)
        self.all_ready()
        self.tick_alive(5)
        assert self.session.phase == "running"

    def warnings(self) -> list[SessionEvent]:
        sent = (message for message in self.bus.sent if isinstance(message, SessionEvent))
        return [event for event in sent if event.level == "warning" and "seen" in event.data]


def test_advice_is_an_event_of_the_launcher_and_a_line_for_the_person() -> None:
    rig = AdvisedRig(every=EveryMessage())
    assert rig.warnings() == []
    rig.reader.waiting = [STATUS]
    rig.tick_alive(3)
    (event,) = rig.warnings()
    assert (event.src, event.text, event.data) == ("launcher@master", "Mind the law.", {"seen": 1.0, "advice": True})
    assert rig.reports.count("Mind the law.") == 1


def test_an_adviser_that_fails_ends_itself_and_neither_another_one_nor_the_session(
    capfd: pytest.CaptureFixture[str],
) -> None:
    failing, every = Failing(), EveryMessage()
    rig = AdvisedRig(failing=failing, every=every)
    rig.reader.waiting = [STATUS]
    rig.tick_alive(10)
    assert len(failing.looks) == 2 and len(every.looks) > 10
    assert len(rig.warnings()) == 1
    assert rig.session.phase == "running" and not rig.session.failure


def test_one_that_cannot_be_made_or_has_nothing_to_say_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(session: AdvisedSession) -> None:
        raise ValueError("no settings")

    strange = EveryMessage()
    strange.inputs = ("wind/speed",)
    found = {
        "good": lambda session: EveryMessage(),
        "silent": lambda session: None,
        "bad": fails,
        "ended": lambda session: sys.exit(3),
        "strange": lambda session: strange,
        "no_adviser": lambda session: 7,
    }
    rows = {name: Plugin("advisers", name, "hollow", "1.2", "hollow:it") for name in found}
    monkeypatch.setattr(advisers, "load", lambda kind: LoadedEntries(found, {"worse": "it cannot be imported"}))
    monkeypatch.setattr(advisers, "installed", lambda kind: rows)
    assert set(advisers_for(AdvisedSession(None, lambda: 0), LOG)) == {"good"}


def test_doctor_says_where_nothing_is_warned_of_and_which_package_would() -> None:
    assert check_advisers({"benchmark": object()}).found == "sessions are watched by benchmark"
    without = check_advisers({})
    assert without.level == "ok" and "nothing is warned of" in without.found
    assert "telenano-lab" in without.advice


def test_advisers_hear_the_devices_of_both_sites_where_the_machine_reaches_them() -> None:
    book = AddressBook.load(DEFAULT_SITE_FILE)
    wanted = ("law/status", "haptic/state", "afm/state", "session/event")
    heard = advised_of(book, "launcher@master", wanted)
    assert set(heard["afm_node@slave"]) == {"afm/state", "session/event"}
    assert "haptic/state" in heard["haptic_node@master"] and "law/status" in heard["controller@master"]
    assert "launcher@master" not in heard
    assert {topic for topics in heard.values() for topic in topics} == set(wanted)
    assert set(advised_of(book, "launcher@master", ("afm/state",))) == {"afm_node@slave"}
