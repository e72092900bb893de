"""The recording that the project comes with opens, is sound, and is judged as it was."""

import json
from pathlib import Path

import numpy as np
import pytest
from make_demo import DEMO
from typer.testing import CliRunner

import telenano
from telenano.cli.root import app
from telenano.recording.verify import verify

# whatever is added to a message later
COLUMNS = {
    "afm/state": (
        "time_s",
        "src",
        "t_ns",
        "base_position_m.2",
        "deflection_m",
        "tip_force_n.2",
        "separation_m",
        "mode",
    ),
    "haptic/state": ("time_s", "position_m.2", "operator_force_n.2", "session_s", "mode"),
    "haptic/command": ("time_s", "t_ns"),
    "session/event": ("time_s", "text"),
}


def said(*words: str | Path, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done.output


@pytest.mark.check("takes 1.6 s")
def test_the_demo_opens_and_is_sound() -> None:
    assert verify([DEMO]).sound
    session = telenano.open(DEMO)
    for channel, columns in COLUMNS.items():
        table = session.table(channel, "*")
        assert [name for name in columns if name not in table] == [], channel
        assert len(table["time_s"]) > 0
    assert np.isfinite(session.table("afm/state")["tip_force_n.2"]).all()
    assert session.summary["recording"]["complete"]
    assert session.summary["scenario"] == "fig12"
    assert json.loads(said("bag", "info", DEMO, "--json"))["messages"] > 1000


@pytest.mark.check("takes 0.8 s")
def test_the_demo_is_stable_and_has_the_figures_of_the_paper() -> None:
    summary = telenano.open(DEMO).summary
    assert summary["verdict"] == "stable"
    assert summary["hold_ratio"] == pytest.approx(1.05, abs=0.005)
