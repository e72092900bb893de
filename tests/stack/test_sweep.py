"""A sweep on a real rig: a session for each value, one figure and one table."""

import json
import subprocess
from pathlib import Path

import pytest
from stack_rig import ROOT, Rig

pytestmark = [pytest.mark.stack, pytest.mark.endurance]


def test_a_sweep_leaves_a_session_for_each_delay_and_compares_them(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        done = subprocess.run(
            rig.command("up", "--scenario", "fig12", "--duration", "3", "--sweep", "round_trip_ms=0,40", "--out",
                        str(rig.out), "--json"),
            env=rig.environment, cwd=ROOT, capture_output=True, text=True, timeout=140,
        )  # fmt: skip
    finally:
        rig.close()
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["sessions"]
    assert [row["session"] for row in rows] == ["round_trip_ms=0", "round_trip_ms=40"]
    # the rig adds a millisecond or two of its own
    added_ms = rows[1]["round trip of the link [ms]"] - rows[0]["round trip of the link [ms]"]
    assert added_ms == pytest.approx(40.0, abs=5.0)
    for name in ("compare.png", "compare.csv", "round_trip_ms=40/session.mcap", "round_trip_ms=40/fig12.png"):
        assert (rig.out / name).stat().st_size > 0
