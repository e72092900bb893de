"""`telenano sample` says how the heights of a file are levelled, and between which heights they then lie."""

import json
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.microscopy.image_files import Image, write_gsf

from telenano.testing import invoke


@pytest.mark.parametrize(
    ("level", "said", "middle_m"),
    [
        (None, "centre: its heights are shifted so that its middle is at 0", 0.0),
        ("absolute", "absolute: its heights are those of the file", -4e-7),
        ("plane", "plane: its mean plane is subtracted", None),
    ],
)
def test_the_level_of_a_file_is_said_with_its_heights(
    tmp_path: Path, level: str | None, said: str, middle_m: float | None
) -> None:
    heights = -4e-7 + 1e-9 * np.arange(-8.0, 8.0)[None, :] + 0.5e-9 + np.zeros((16, 1))
    write_gsf(tmp_path / "map.gsf", Image("Height", "m", heights, 1e-7, 1e-7))
    options = ["sample", "--sample", str(tmp_path / "map.gsf"), "--out", str(tmp_path / "out"), "--json"]
    result = invoke([*options, *(["--set", f"level={level}"] if level else [])])
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["level"] == said
    if middle_m is None:
        assert max(abs(found["lowest_m"]), found["highest_m"]) < 1e-12
    else:
        assert 0.5 * (found["lowest_m"] + found["highest_m"]) == pytest.approx(middle_m, rel=1e-6, abs=1e-14)


def test_a_computed_sample_has_no_level_to_choose(tmp_path: Path) -> None:
    options = ["sample", "--sample", "flat", "--out", str(tmp_path / "out")]
    result = invoke([*options, "--json"])
    assert "level" not in json.loads(result.stdout)
    refused = invoke([*options, "--set", "level=plane"])
    assert refused.exit_code != 0
    assert "level: is for files; flat has heights of its own" in " ".join(refused.output.split())
