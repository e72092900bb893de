"""`telenano curve`: a measured curve beside the simulated one, whether or not a contact fits it."""

import json
from pathlib import Path

import pytest
from telenano_lab.microscopy import adhesion_fit

from telenano.testing import invoke
from telenano.wire import ConfigError


def curve(*arguments: str) -> dict[str, object]:
    result = invoke(["curve", "--points", "60", *arguments, "--json"])
    assert result.exit_code == 0, result.stderr
    found: dict[str, object] = json.loads(result.stdout)
    return found


def test_a_measured_curve_is_drawn_where_no_contact_fits_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> None:
        raise ConfigError("the curve has no contact: give the one of this sample")

    curve("--out", str(tmp_path / "measured"))
    monkeypatch.setattr(adhesion_fit, "fit_adhesion", refuse)
    found = curve("--out", str(tmp_path / "both"), "--overlay", str(tmp_path / "measured" / "curve.h5"))
    assert found["fit"] == {"refused": "the curve has no contact: give the one of this sample with --reduced-modulus"}
    assert "measured" in found
    assert (tmp_path / "both" / "curve.png").stat().st_size > 10_000
