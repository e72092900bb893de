"""A sweep on a real rig: a session for each value, one figure and one table."""

import json
import shlex
import subprocess
from pathlib import Path

import pytest
from stack_rig import ROOT, Rig

pytestmark = [pytest.mark.stack, pytest.mark.endurance]


def test_a_sweep_leaves_a_session_for_each_delay_and_compares_them(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    text = (ROOT / "README.md").read_text()
    (words,) = [shlex.split(line, comments=True)[1:] for line in text.splitlines() if "--sweep" in line]
    words[words.index("--out") + 1] = str(rig.out)
    try:
        done = subprocess.run(
            rig.command(*words, "--duration", "3", "--json"),
            env=rig.environment, cwd=ROOT, capture_output=True, text=True, timeout=140,
        )  # fmt: skip
    finally:
        rig.close()
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["sessions"]
    assert [row["session"] for row in rows] == [f"round_trip_ms={delay_ms}" for delay_ms in (0, 40, 60)]
    # the rig adds a millisecond or two of its own
    for row, delay_ms in zip(rows[1:], (40.0, 60.0), strict=True):
        added_ms = row["round trip of the link [ms]"] - rows[0]["round trip of the link [ms]"]
        assert added_ms == pytest.approx(delay_ms, abs=5.0)
    for name in ("compare.png", "compare.csv", "round_trip_ms=40/session.mcap", "round_trip_ms=40/fig12.png"):
        assert (rig.out / name).stat().st_size > 0
