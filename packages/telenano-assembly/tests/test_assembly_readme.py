"""The README of the package has every key that it adds to a scenario, and what it imports of telenano."""

import ast
import re
from pathlib import Path

from telenano.launcher.scenario_keys import all_keys

PACKAGE = Path(__file__).parents[1]
README = (PACKAGE / "README.md").read_text("utf-8")


def test_every_key_of_the_layer_and_of_the_program_is_listed() -> None:
    named = set(re.findall(r"`([a-z_0-9.]+)`", README))
    keys = [key.name.rpartition(".") for key in all_keys()]
    ours = {(above, leaf) for above, _, leaf in keys if above.endswith((".sample.particles", ".begin.push"))}
    assert len(ours) == 31
    # The page may name the second of two keys with the same words by its last part.
    assert {f"{above}.{leaf}" for above, leaf in ours if f"{above}.{leaf}" not in named and leaf not in named} == set()


def test_the_first_page_names_what_is_imported_of_each_room() -> None:
    used = set[str]()
    for path in (PACKAGE / "telenano_assembly").rglob("*.py"):
        for part in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(part, ast.ImportFrom) and (part.module or "").startswith("telenano."):
                room = part.module or ""
                if room != "telenano.faces" and not room.startswith("telenano.extend"):
                    used |= {f"{room}: {each.name}" for each in part.names}
    table = README[README.index("## What it needs") : README.index("What finds and plans")]
    missing = {use for use in used if f"`{use.partition(': ')[2]}`" not in table}
    assert missing == set()
