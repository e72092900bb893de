"""The real bus agrees with the lockstep loop."""

import json
from typing import Any

# theory for the virtual impedance on a spring of 38 N/m, half a sample period included [ms]
EDGE_MS = 22.44
DELAYS_MS = (18.0, 25.0)


def test_bus_agrees_with_lockstep_on_both_sides_of_the_edge(rig: Any) -> None:
    out = rig.folder / "study"
    delays = ",".join(f"{delay:g}" for delay in DELAYS_MS)
    spring = ("--environment", "spring", "--stiffness", "38", "--delay", delays)
    done = rig.tell("study", "validate", *spring, "--out", str(out), "--json", patience_s=150.0)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["agree"]
    assert [cell["bus"] == "stable" for cell in found["cells"]] == [True, False]
    # no more than the two verdicts where the motion died out too fast for a rate
    if found["cells"][0]["bus_growth_per_s"] is None:
        return
    (edge,) = found["bus_critical_delay_ms"]
    # the law bears so much in all, and what the processes take of it is this machine's
    ages = sorted(json.loads(path.read_text())["loop_age_ms"]["p50"] for path in out.glob("bus-*/summary.json"))
    own_ms = max(age - delay for age, delay in zip(ages, DELAYS_MS, strict=True))
    assert EDGE_MS - own_ms - 1.5 < edge["bus_critical_delay_ms"] < EDGE_MS + 1.5, (edge, own_ms)
