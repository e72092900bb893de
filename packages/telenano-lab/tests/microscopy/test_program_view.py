"""A program of the instrument as a person sees it: its bar, and the options that a running rig decides."""

import msgspec
from telenano_lab.microscopy.program_view import bar_of

from telenano.testing import run
from telenano.wire import AfmProgram


def test_a_bar_shows_how_far_it_is_and_the_keys() -> None:
    report = AfmProgram(
        seq=0, t_ns=0, src="afm_node@slave", v=1, program="scan", state="paused", text="lines", done_percent=50.0,
        line=32, lines=64,
    )  # fmt: skip
    text = bar_of(report)
    assert (text.count("━"), text.count("╌")) == (15, 15)
    assert "32/64  paused  (space: pause, q: end)" in text
    assert bar_of(msgspec.structs.replace(report, program="curve", lines=0)).endswith("(q: end)")


def test_options_that_the_rig_decides_are_refused_by_name() -> None:
    code, _, err = run("scan", "--out", "out", "--live", "--afm", "a=1", "--temperature", "300")
    assert code == 2 and "--afm, --temperature: not with --live, whose scenario decides it" in err
