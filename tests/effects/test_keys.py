"""Each key of a scenario has an effect: another value of it changes what a person sees, or is refused.

`key_effects.py` says which values and sessions are tried, `circumstances.py` in which sessions keys act that do nothing
in the usual one. A key without an effect is either read nowhere, or needs a session there.
"""

import random
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from changed_sections import touched
from circumstances import COSTLY, SESSIONS, WITHOUT, write_files
from compared_sessions import Seen
from key_effects import Leaf, asked_by, bases_of, by_section, effect_of, fits, leaves
from pydantic import Field, create_model

from services.afm_node import __main__ as afm_node
from telenano.launcher.scenario_keys import scenario_schema
from telenano.sections.afm_parts import FrictionConfig
from telenano.sections.afm_section import AfmConfig
from telenano.settings.config import merge

SEED = 93
SHARE = 0.05
# Keys of a changed section that `make check` tries at most.
_MOST_TOUCHED = 12
WHAT_TO_DO = (
    "no other value changes what a session shows: read the key in the code, or give in tests/effects/circumstances.py"
    " other VALUES or a session of SESSIONS in which it acts"
)


@cache
def every() -> tuple[Leaf, ...]:
    return tuple(leaf for leaf in leaves(scenario_schema()) if not reason_of(leaf))


def reason_of(leaf: Leaf) -> str:
    """Return why a key has no effect that a session in virtual time shows, empty where it has to have one."""
    return next((reason for pattern, reason in WITHOUT.items() if fits(leaf, pattern)), "")


def without_effect(found: list[Leaf]) -> list[str]:
    """Return the names of the keys that have no effect."""
    sections = by_section(leaves(scenario_schema()))
    return [leaf.name for leaf in found if not effect_of(leaf, sections)]


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    write_files(tmp_path)
    yield


def drawn() -> list[Leaf]:
    draw = random.Random(SEED)
    found = draw.sample(every(), round(SHARE * len(every())))
    return [leaf for leaf in found if not any(fits(leaf, pattern) for pattern in COSTLY)]


@pytest.mark.check("takes half a minute")
@pytest.mark.timeout(1800)
def test_a_twentieth_of_the_keys_and_those_that_a_change_touches_have_an_effect() -> None:
    changed = touched(list(every()))
    tried = {
        leaf.name: leaf for leaf in [*drawn(), *random.Random(SEED).sample(changed, min(len(changed), _MOST_TOUCHED))]
    }
    assert not (missing := without_effect(list(tried.values()))), f"{', '.join(missing)}: {WHAT_TO_DO}"


@pytest.mark.endurance("takes 10 min")
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("section", sorted({".".join(leaf.path[:2]) for leaf in every()}))
def test_every_key_has_an_effect(section: str) -> None:
    tried = [leaf for leaf in every() if ".".join(leaf.path[:2]) == section]
    assert not (missing := without_effect(tried)), f"{', '.join(missing)}: {WHAT_TO_DO}"


@pytest.mark.endurance("takes a minute")
@pytest.mark.parametrize("pattern", WITHOUT)
def test_a_key_that_is_said_to_have_no_effect_has_none(pattern: str) -> None:
    sections = by_section(leaves(scenario_schema()))
    concerned = [leaf for leaf in leaves(scenario_schema()) if fits(leaf, pattern)]
    assert concerned, f"{pattern}: no key has this name: take it from WITHOUT in tests/effects/circumstances.py"
    for leaf in concerned:
        effect = effect_of(leaf, sections, bases_only=True)
        assert not effect or effect.startswith("refused"), (
            f"{leaf.name} has an effect on {effect}: take it from WITHOUT in tests/effects/circumstances.py"
        )


@pytest.mark.check("takes 5 s")
def test_a_key_that_nothing_reads_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    about = "Rest of the tip before it goes across [s]"
    sticky = create_model(
        "Sticky", __base__=FrictionConfig, rest_s=(float, Field(0.0, ge=0.0, le=1.0, description=about))
    )
    config = create_model("WithUnread", __base__=AfmConfig, friction=(sticky, Field(sticky(), description="Friction.")))
    monkeypatch.setattr(afm_node, "AFM_NODE", replace(afm_node.AFM_NODE, config=config))
    found = {leaf.name: leaf for leaf in leaves(scenario_schema())}
    assert without_effect([found["afm_node.friction.rest_s"], found["afm_node.friction.coefficient"]]) == [
        "afm_node.friction.rest_s"
    ]


@pytest.mark.endurance("takes 2 min")
@pytest.mark.parametrize("pattern", sorted({pattern for pattern, _ in SESSIONS}))
def test_a_session_in_which_a_key_acts_runs(pattern: str) -> None:
    sections = by_section(leaves(scenario_schema()))
    concerned = [leaf for leaf in every() if fits(leaf, pattern)]
    assert concerned, f"{pattern}: no key has this name: take it from SESSIONS in tests/effects/circumstances.py"
    session = bases_of(concerned[0])[0]
    if not session.are_files:
        seen = Seen(replace(session, settings=merge(asked_by(concerned[0], sections), dict(session.settings))))
        assert not seen.refusals
