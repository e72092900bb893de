"""The virtual rig with the link as a node of its own, and the lockstep loop, agree for each kind of impairment."""

from pathlib import Path

import pytest
from impairments import KINDS, cell_of, direction_of, fault_of, outcomes, scenario_over, write_traces

from telenano.sections.controller_section import LAWS
from telenano.settings.link_settings import Impairment
from telenano.virtual import ARMED_S, STARTED_S, Timing, VirtualRig

SEED = 7
TIMING = Timing((0, 1), (1_000, 1_001), None, (10_000, 10_001), (1_000, 1_001), (1_000, 1_001), stall_share=0.0)


def test_every_kind_of_impairment_that_the_link_has_is_among_them() -> None:
    assert {key for kind in KINDS.values() for key in kind} == set(Impairment.model_fields)
    assert {kind["outage"]["mode"] for kind in KINDS.values() if "outage" in kind} == {"drop", "hold"}


# The lines that every law is tried over; `wave` is tried over all.
LINES = (
    "delay_s", "jitter", "jitter in order", "delay_trace", "loss", "gilbert_elliott", "duplication", "reordering",
    "rate and queue", "outage that drops",
)  # fmt: skip


@pytest.mark.check("takes 10 s")
@pytest.mark.drawn(0.007)
@pytest.mark.parametrize(
    ("law", "kind"),
    [("wave", kind) for kind in KINDS] + [(law, kind) for law in LAWS if law != "wave" for kind in LINES],
)
def test_the_virtual_rig_and_lockstep_agree(tmp_path: Path, law: str, kind: str) -> None:
    write_traces(tmp_path)
    cell = cell_of(law, 20.0)
    rig = VirtualRig(tmp_path / "rec", SEED, (), TIMING, scenario_over(cell, direction_of(KINDS[kind], tmp_path)))
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(STARTED_S + cell.hold_s()[1] + 0.01)
    found, expected = outcomes(cell, rig.finish())
    assert fault_of(found, expected) == ""
    if law == "wave":
        # Through wave variables no line makes energy; other laws bound it by what they let through, or not at all.
        assert min(found.lowest_energy_j, expected.lowest_energy_j) > -1e-6
