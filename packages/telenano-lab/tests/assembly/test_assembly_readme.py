"""The page of the part has every key that it adds to a scenario."""

import re
from pathlib import Path

from telenano.launcher import all_keys

README = (Path(__file__).parents[2] / "docs" / "assembly.md").read_text("utf-8")


def test_every_key_of_the_layer_and_of_the_program_is_listed() -> None:
    named = set(re.findall(r"`([a-z_0-9.]+)`", README))
    keys = [key.name.rpartition(".") for key in all_keys()]
    ours = {(above, leaf) for above, _, leaf in keys if above.endswith((".sample.particles", ".begin.push"))}
    assert len(ours) == 31
    # The page may name the second of two keys with the same words by its last part.
    assert {f"{above}.{leaf}" for above, leaf in ours if f"{above}.{leaf}" not in named and leaf not in named} == set()
