"""The endpoint of an experiment on a real bus: cues and trials go out, and each answer comes once."""

import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from telenano_lab.experiments.asked import CONSENT, NASA_TLX
from telenano_lab.experiments.bus import Answer, ExperimentBus
from telenano_lab.experiments.extend import Course
from telenano_lab.experiments.types import Trial

from telenano.console import RigHand
from telenano.runtime import AddressBook, Observer
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing import until
from telenano.wire import ConfigError, EndpointError

PATIENCE_S = 20.0
TRIAL = Trial("P07", 1, 2, 5, "main", "track", {}, {"law": "wave", "delay_s": 0.1, "on": (1, 2)}, {}, 11)


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # a socket's path is short by law, pytest's folders are not
    with tempfile.TemporaryDirectory(prefix="tne-") as folder:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", folder)
        yield


@pytest.fixture
def bus() -> Iterator[ExperimentBus]:
    with ExperimentBus(DEFAULT_SITE_FILE) as found:
        yield found


@pytest.fixture
def page() -> Iterator[RigHand]:
    with closing(RigHand(DEFAULT_SITE_FILE)) as found:
        yield found


def give(page: RigHand, number: int, cue: str, role: str = "participant", **values: Any) -> None:
    facts = {"id": f"a-{number}", "cue": cue, "role": role, "values": values, "given_ns": 1000 + number}
    page.publish("experiment/answer", **facts, shown_s=0.5)


def connected(bus: ExperimentBus, page: RigHand) -> None:
    """Wait until what the page says reaches the experiment."""

    def said() -> bool:
        give(page, 0, "none", "experimenter", action="resume")
        return bool(bus.answers())

    until(said)


def test_a_cue_and_a_trial_are_told_and_the_cue_again_to_who_comes_later(bus: ExperimentBus) -> None:
    course = Course(np.array([0.0, 1.0]), np.array([1e-9, 2e-9]), "force")
    cue = bus.cue("trial", "Track", course=course, band=1e-10, remaining_s=60.0, done=1, total=6, questions=(CONSENT,))
    with closing(Observer(AddressBook.load(DEFAULT_SITE_FILE), ["experiment/cue", "experiment/trial"])) as observer:
        seen: dict[str, Any] = {}

        def both() -> bool:
            bus.answers()
            bus.trial(TRIAL, state="running", trials=6, picture_delay_s=0.2)
            seen.update({found.name: found.received.message for found in observer.listen(0.02)})
            return len(seen) == 2

        until(both)
    told, trial = seen["experiment/cue"], seen["experiment/trial"]
    assert (told.id, told.stage, told.quantity, told.questions) == (cue, "trial", "force", (CONSENT,))
    assert 0.0 < told.remaining_s <= 60.0
    assert told.target.to_numpy().tolist() == [1e-9, 2e-9]
    assert (trial.participant, trial.index, trial.picture_delay_s) == ("P07", 5, 0.2)
    assert trial.condition == {"law": "wave", "delay_s": 0.1, "on": "(1, 2)"}


def test_each_answer_comes_once_and_the_first_one_counts(bus: ExperimentBus, page: RigHand) -> None:
    connected(bus, page)
    cue = bus.cue("question", questions=NASA_TLX)
    give(page, 1, cue, effort=5.0)
    # sent again, and given again after the connection was lost
    give(page, 1, cue, effort=5.0)
    give(page, 2, cue, effort=90.0)
    give(page, 3, cue, "experimenter", action="pause", reason="")
    give(page, 4, cue, "experimenter", action="pause", reason="")
    found: list[Answer] = []

    def all_came() -> bool:
        found.extend(bus.answers())
        return found[-1:] != [] and found[-1].id == "a-4"

    until(all_came)
    assert [(answer.id, dict(answer.values)) for answer in found if answer.role == "participant"] == [
        ("a-1", {"effort": 5.0})
    ]
    assert [answer.id for answer in found if answer.role == "experimenter"] == ["a-3", "a-4"]
    assert found[0] == Answer("a-1", cue, "participant", {"effort": 5.0}, 1001, 0.5)
    # all of them are acknowledged, so that nobody sends them on
    assert set(bus._taken) >= {"a-1", "a-2", "a-3", "a-4"}


def test_waiting_ends_with_the_answer_the_time_or_whoever_looks_on(bus: ExperimentBus, page: RigHand) -> None:
    connected(bus, page)
    cue = bus.cue("instruction")
    assert bus.wait(cue, 0.05) is None
    saying = threading.Timer(0.1, lambda: give(page, 5, cue, ready="yes"))
    saying.start()
    answer = bus.wait(cue, PATIENCE_S)
    saying.join()
    assert answer is not None
    assert answer.values == {"ready": "yes"}
    looked: list[Answer] = []
    give(page, 6, cue, "experimenter", action="stop", reason="")
    assert bus.wait(bus.cue("rest"), PATIENCE_S, lambda answers: looked.extend(answers) or bool(looked)) is None
    assert looked[0].values["action"] == "stop"


def test_one_experiment_at_a_time_runs_on_a_rig(bus: ExperimentBus, tmp_path: Any) -> None:
    with pytest.raises(EndpointError, match="in use by process"):
        ExperimentBus(DEFAULT_SITE_FILE)
    lines = DEFAULT_SITE_FILE.read_text().splitlines()
    old = tmp_path / "site.yaml"
    old.write_text("\n".join(line for line in lines if "experiment@master" not in line))
    with pytest.raises(ConfigError, match=r"site\.yaml: nodes\.experiment@master is missing.*add `exp"):
        ExperimentBus(old)
