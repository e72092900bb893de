"""`telenano bag plot` and `bag diff`: fields of a recording over time, and two recordings compared."""

import json
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.studies.plot import Trace, draw

from telenano.recording import FileSettings, RecordingWriter
from telenano.testing import EPOCH_NS, hand_state, invoke
from telenano.wire import encode


def run(*arguments: str | Path, exit_code: int = 0) -> str:
    result = invoke(["bag", *(str(argument) for argument in arguments)])
    assert result.exit_code == exit_code, result.output
    return result.stdout


def recorded(folder: Path) -> Path:
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(40):
        log_ns = EPOCH_NS + seq * 1_000_000
        writer.write(channel, log_ns + 100, log_ns, seq, encode(hand_state(seq, t_ns=log_ns)))
    writer.finish()
    return writer.path


def test_a_plot_is_drawn_on_the_terminal_or_saved(tmp_path: Path) -> None:
    path = recorded(tmp_path)
    drawn = run("plot", path, "haptic/state.position_m.2")
    assert "0.039 s" in drawn
    assert "-0.039" in drawn
    run("plot", path, "haptic/state.position_m.2", "haptic/state.limited", "--out", tmp_path / "p.png")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    run("plot", path, "haptic/state", exit_code=2)
    run("plot", path, "haptic/state.nothing", exit_code=1)
    run("plot", path, "haptic/state.mode", exit_code=1)
    run("plot", path, "haptic/state.seq", "--out", tmp_path / "none" / "p.png", exit_code=1)


def test_a_rising_line_is_drawn_rising() -> None:
    ramp = Trace("ramp", np.linspace(0.0, 1.0, 500), np.linspace(-1.0, 1.0, 500))
    rows = draw(ramp, 60, 5).splitlines()[1:6]
    first_marks = [next(i for i, c in enumerate(row[13:]) if c != "⠀") for row in rows]
    assert first_marks == sorted(first_marks, reverse=True)
    assert "1" in rows[0][:12]
    assert "-1" in rows[-1][:12]
    flat = Trace("flat", np.zeros(3), np.full(3, np.nan))
    assert draw(flat, 60, 5) == "flat: no value"


@pytest.mark.parametrize(
    ("offset", "span", "highest", "lowest"),
    [(1e-6, 1e-12, "1.000001e-06", "1e-06"), (0.0, 1e-9, "1e-09", "0"), (1.7e18, 6e9, "1.700000006e+18", "1.7e+18")],
)
def test_a_small_motion_is_drawn_at_any_offset(offset: float, span: float, highest: str, lowest: str) -> None:
    time_s = np.linspace(0.0, 1.0, 500)
    lines = draw(Trace("base", time_s, offset + span * time_s), 60, 5).splitlines()
    rows = [line.rpartition(" ") for line in lines[1:6]]
    assert (rows[0][0].strip(), rows[-1][0].strip()) == (highest, lowest)
    assert all(set(drawn) - {"\u2800"} for _, _, drawn in rows)
    assert {len(line) for line in lines[1:]} == {60}


def test_two_recordings_are_the_same_or_differ(tmp_path: Path) -> None:
    path, part = recorded(tmp_path), tmp_path / "part.mcap"
    run("filter", path, "--out", part, "--end", "0.02")
    assert "the same" in run("diff", path, path)
    assert json.loads(run("diff", path, part, "--json", exit_code=1))["same"] is False
