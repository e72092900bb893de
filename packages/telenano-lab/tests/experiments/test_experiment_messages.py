"""The messages of an experiment keep the bytes and the schemas that they had in the core."""

from pathlib import Path
from typing import Any

import pytest
from telenano_lab.experiments.messages import ANSWER, CUE, TRIAL

from telenano.testing import assert_same_bytes, assert_same_schema, case_of, vectors_of
from telenano.wire import Topic

HERE = Path(__file__).parent
ROWS = (ANSWER, CUE, TRIAL)
VECTORS = vectors_of(HERE / "golden_messages.json", *ROWS)


@pytest.mark.parametrize("vector", VECTORS, ids=case_of)
def test_golden_bytes_are_read_and_written_as_ever(vector: dict[str, Any]) -> None:
    assert_same_bytes(vector)


def test_every_topic_has_its_vectors() -> None:
    assert {vector["topic"] for vector in VECTORS} == {row.name for row in ROWS}
    assert len(VECTORS) == 27


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_the_schema_is_the_one_that_clients_in_other_languages_have(row: Topic) -> None:
    assert_same_schema(HERE / "schemas", row)
