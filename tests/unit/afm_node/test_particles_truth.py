"""Truth and estimate are two things: no node and no plan can know where the particles of a simulation are."""

from pathlib import Path

import msgpack
import pytest
from telenano_lab.assembly.messages import AfmParticles

from services.afm_node import node as afm
from services.controller.__main__ import HALVES
from services.haptic_node import node as haptic
from services.viz_node.source import TOPICS_SHOWN
from telenano.testing.filled_messages import examples
from telenano.wire import Topic
from telenano.wire.codec import WireError, accept, fields_of
from telenano.wire.schema import json_schema
from telenano.wire.topics import row_of

ROOT = Path(__file__).parents[3]
TRUTH = "afm/particles"
# These are what declares the topic, what writes it into recordings, and what judges a trial of an experiment
# afterwards; docs and generated files of the contract are no readers.
SAYS_IT = {
    "telenano/settings/known_packages.py",
    "packages/telenano-lab/telenano_lab/assembly/messages.py",
    "packages/telenano-lab/telenano_lab/assembly/layers.py",
    "packages/telenano-lab/telenano_lab/assembly/recording.py",
    "packages/telenano-lab/telenano_lab/experiments/recorded_trial.py",
    "packages/telenano-lab/telenano_lab/experiments/tasks/push_particle.py",
}


@pytest.fixture
def row() -> Topic:
    """The row of the topic, for which its package is imported."""
    found = row_of(TRUTH)
    assert found is not None
    return found


def test_no_code_names_the_topic_of_the_truth_but_what_says_it() -> None:
    folders = ("services", "telenano", "packages")
    names = set()
    for folder in folders:
        for path in (ROOT / folder).rglob("*"):
            ours = path.suffix in (".py", ".ts", ".yaml") and not {"node_modules", "dist", "tests"} & set(path.parts)
            if ours and TRUTH in path.read_text(encoding="utf-8"):
                names.add(str(path.relative_to(ROOT)))
    assert names == SAYS_IT


def test_the_truth_is_recorded_and_goes_to_no_other_machine_and_to_no_node(row: Topic) -> None:
    assert row.recorded and row.bridged is None and row.publishers == ("afm_node",)
    inputs = (afm.INPUTS, *(half.inputs for half in HALVES.values()), haptic.INPUTS, TOPICS_SHOWN)
    assert not any(TRUTH in topics for topics in inputs)


def test_a_message_of_the_truth_is_marked_as_simulated(row: Topic) -> None:
    assert json_schema(AfmParticles)["properties"]["simulated"]["const"] is True
    truth = fields_of(examples(row)["ordinary"])
    with pytest.raises(WireError, match="simulated must be true"):
        accept(TRUTH, msgpack.packb({**truth, "simulated": False}))
