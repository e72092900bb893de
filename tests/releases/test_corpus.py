"""The recordings of live sessions are read, judged and made again as on the day they were recorded."""

from typing import Any

import pytest
import yaml
from make_corpus import CORPUS, SESSIONS, VERDICTS
from references import RERUN, MachineTolerances

import telenano
from telenano.recording.reader import Recording
from telenano.recording.verify import verify
from telenano.rerun.rerun import rerun

KEPT: dict[str, Any] = yaml.safe_load(VERDICTS.read_text(encoding="utf-8"))


def test_each_session_has_its_recording_and_its_verdict() -> None:
    assert set(KEPT) == set(SESSIONS) == {path.stem for path in CORPUS.glob("*.mcap")}


@pytest.mark.check("reads whole recordings")
@pytest.mark.parametrize("name", SESSIONS)
def test_a_session_lacks_nothing_and_is_judged_as_it_was(name: str) -> None:
    path = CORPUS / f"{name}.mcap"
    assert verify([path]).sound
    summary = telenano.open(path).summary
    assert summary["verdict"] == KEPT[name]["verdict"]
    for hold, kept in zip(summary["holds"], KEPT[name]["holds"], strict=True):
        assert hold["verdict"] == kept["verdict"]
        assert hold["hold_ratio"] == (None if kept["hold_ratio"] is None else pytest.approx(kept["hold_ratio"]))


@pytest.mark.check("runs every node of a recording again")
@pytest.mark.parametrize("name", SESSIONS)
def test_every_node_makes_the_messages_again_that_it_sent(name: str) -> None:
    recording = Recording(CORPUS / f"{name}.mcap")
    for node in RERUN:
        # another C library may give other last bits
        found = rerun(recording, node, MachineTolerances(recording, node))
        assert found.identical, found.verdict
        assert sum(found.compared.values()) > 300
