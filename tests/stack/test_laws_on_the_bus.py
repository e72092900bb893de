"""The real bus agrees with the lockstep loop."""

import json
from pathlib import Path
from typing import Any

import machine
import pytest
from stack_rig import HELD_UP_MS, SESSIONS

# theory for the virtual impedance on a spring of 38 N/m, half a sample period included [ms]
EDGE_MS = 22.44
STABLE_MS, UNSTABLE_MS = 18.0, 25.0


def fault_of(done: Any, delays_ms: tuple[float, ...], ages: list[dict[str, float]]) -> str:
    """Return in what the bus does not agree; empty when it does."""
    if done.returncode != 0:
        return f"exit code {done.returncode}: {done.stderr}{done.stdout}"
    found = json.loads(done.stdout)
    if not found["agree"] or [cell["bus"] == "stable" for cell in found["cells"]] != [
        delay < EDGE_MS for delay in delays_ms
    ]:
        return f"other verdicts: {found['cells']}"
    # no more than the verdicts on one side of the edge, and where the motion died out too fast for a rate
    if len(delays_ms) < 2 or found["cells"][0]["bus_growth_per_s"] is None:
        return ""
    edge_ms = found["bus_critical_delay_ms"][0]["bus_critical_delay_ms"]
    # the law bears so much in all, and what the processes take of it is this machine's
    medians = sorted(age["p50"] for age in ages)
    own_ms = max(median - delay for median, delay in zip(medians, delays_ms, strict=True))
    agrees = EDGE_MS - own_ms - 1.5 < edge_ms < EDGE_MS + 1.5
    return "" if agrees else f"an edge at {edge_ms:.2f} ms, {own_ms:.2f} ms of the loop are the processes'"


@pytest.mark.drawn(0.0, "telenano/laws/", "telenano/lockstep/", "services/controller/")
@pytest.mark.parametrize(
    "delays_ms",
    [
        pytest.param((UNSTABLE_MS,), id="beyond the edge"),
        pytest.param((STABLE_MS, UNSTABLE_MS), id="both sides of the edge", marks=pytest.mark.endurance),
    ],
)
def test_bus_agrees_with_lockstep(rig: Any, delays_ms: tuple[float, ...]) -> None:
    delays = ",".join(f"{delay:g}" for delay in delays_ms)
    spring = ("--environment", "spring", "--stiffness", "38", "--delay", delays)
    for attempt in range(SESSIONS):
        out: Path = rig.folder / f"study{attempt}"
        done = rig.telenano("study", "validate", *spring, "--out", str(out), "--json", patience_s=150.0)
        ages = [json.loads(path.read_text())["loop_age_ms"] for path in out.glob("bus-*/summary.json")]
        fault = fault_of(done, delays_ms, ages)
        held_up_ms = max((age["max"] - age["p50"] for age in ages), default=0.0)
        if not fault:
            return
        # tried again on this ground alone
        assert held_up_ms > HELD_UP_MS, fault
        machine.note(f"the bus was compared with lockstep again: its loop was held up by {held_up_ms:.0f} ms ({fault})")
    # no session went through undisturbed: that is the machine's, and has been printed
