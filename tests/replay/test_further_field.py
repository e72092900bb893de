"""A further field of node/health moves no session in virtual time where it tells of the machine."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from references import REFERENCES

FOLDER = Path(__file__).parent


def recorded(teller: str) -> dict[str, Any]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(FOLDER), str(FOLDER.parents[1])])}
    words = [sys.executable, str(FOLDER / "further_field.py"), teller]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)  # type: ignore[no-any-return]


@pytest.mark.check("takes 15 s")
@pytest.mark.drawn(0.0, "telenano/wire/", "telenano/runtime/", "telenano/virtual/", "tests/replay/")
def test_a_further_field_of_the_machine_changes_no_reference_whatever_the_rate_of_its_link() -> None:
    found = recorded("machine")
    assert found.keys() == REFERENCES.keys()
    for name, facts in found.items():
        assert facts["reports"] > 10 and (facts["with_threads"], facts["changed"]) == (0, []), name


@pytest.mark.check("takes 6 s")
@pytest.mark.drawn(0.0, "telenano/wire/", "telenano/runtime/", "telenano/virtual/", "tests/replay/")
def test_the_same_field_said_by_a_node_in_virtual_time_moves_what_a_link_of_a_limited_rate_carries() -> None:
    found = recorded("node")
    assert found
    for name, facts in found.items():
        assert facts["with_threads"] == facts["reports"] and facts["changed"], name
