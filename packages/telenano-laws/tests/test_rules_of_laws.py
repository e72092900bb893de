"""The rules that the rig relies on, of every law that this package brings."""

import tomllib
from pathlib import Path

import pytest

import telenano

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]


@pytest.mark.check("compiles the law")
@pytest.mark.drawn(0.4, "packages/telenano-laws/telenano_laws/")
@pytest.mark.parametrize("name", PROJECT["entry-points"]["telenano.laws"])
def test_the_law_keeps_every_rule(name: str) -> None:
    assert {rule: faults for rule, faults in telenano.check_law(name).items() if faults} == {}
