"""Commands that take long to prepare: they are carried out, and no process of the loop is ended by its limits."""

import json
from pathlib import Path

import pytest
from stack_rig import BOTH_WAYS, Rig

pytestmark = [
    pytest.mark.stack,
    pytest.mark.drawn(0.0, "telenano/runtime/wiring/", "telenano/settings/link_files.py", "services/delay_node/"),
]
# Parsing them takes seconds, far longer than a turn may take in a process of several nodes, or of one.
LINES = 300_000


@BOTH_WAYS
def test_a_link_that_is_set_to_a_long_trace_goes_on_and_is_not_started_again(rig: Rig, tmp_path: Path) -> None:
    trace = tmp_path / "long.txt"
    trace.write_text("".join(f"{0.001 * n:.3f} {1e-6 * (n % 500):.6f}\n" for n in range(LINES)))
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    before = rig.process_of("delay_node@master")
    done = rig.telenano("link", "set", f"forward.delay_trace.file={trace}")
    assert done.returncode == 0, done.stdout + done.stderr
    # The file is named again in the settings of this command, and need not be read again.
    done = rig.telenano("link", "set", "backward.delay_s=0.001")
    assert done.returncode == 0, done.stdout + done.stderr
    shown = json.loads(rig.telenano("link", "show", "--json").stdout)
    assert shown["forward"]["settings"]["delay_trace.file"] == str(trace)
    assert rig.process_of("delay_node@master") == before
    assert not rig.log_has("launcher@master", "was started again")
    # The same from a wrong file: the line is named, and the settings stay.
    trace.with_name("wrong.txt").write_text(trace.read_text() + "0 0\n")
    done = rig.telenano("link", "set", f"forward.delay_trace.file={trace.with_name('wrong.txt')}")
    assert done.returncode == 1
    assert f"line {LINES + 1}: the time is not later than the one before it" in done.stdout + done.stderr
    code, _, err = rig.stop()
    assert code in (0, 3), err
