"""Rows of an image have one level, particles decide nothing of it, and every file says what was done."""

import json
from pathlib import Path

import gwyfile
import numpy as np
import pytest
from PIL import Image as Picture
from telenano_lab.microscopy.image_files import Image, write_gsf
from telenano_lab.microscopy.row_levels import Method, align_rows

from telenano.testing import invoke
from telenano.wire import ConfigError

METHODS: tuple[Method, ...] = ("median", "mean", "polynomial")


def made(seed: int, *, particles: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return a surface [m], and the same as a scan has it, each line with a level, a tilt and a bow of its own."""
    random = np.random.default_rng(seed)
    x = np.linspace(-1.0, 1.0, 96)
    truth = random.normal(0.0, 0.05e-9, (64, 96))
    if particles:
        for i, j in random.integers((8, 8), (56, 76), (6, 2)):
            truth[i - 5 : i + 5, j - 5 : j + 7] += 10e-9
    levels = np.cumsum(random.normal(0.0, 0.5e-9, 64))[:, None]
    return truth, truth + levels + random.normal(0.0, 0.3e-9, (64, 1)) * x + random.normal(0.0, 0.3e-9, (64, 1)) * x**2


def rms(values: np.ndarray) -> float:
    return float(np.std(values - np.median(values)))


@pytest.mark.parametrize("seed", range(4))
def test_a_polynomial_takes_off_what_a_line_has_and_the_mask_keeps_particles_out_of_it(seed: int) -> None:
    truth, scanned = made(seed, particles=True)
    masked, steps = align_rows(scanned, "polynomial", above_m=2e-9, below_m=2e-9)
    plain, _ = align_rows(scanned, "polynomial")
    assert rms(masked - truth) < 0.3 * rms(plain - truth)
    assert rms(masked - truth) < 0.2 * rms(scanned - truth)
    assert [step.partition(":")[0] for step in steps] == ["masked", "masked", "rows aligned"]


@pytest.mark.parametrize("method", METHODS)
def test_rows_of_a_flat_image_get_one_level_and_the_same_again_changes_nothing(method: Method) -> None:
    truth, _ = made(1, particles=False)
    scanned = truth + np.cumsum(np.random.default_rng(1).normal(0.0, 1e-9, 64))[:, None]
    aligned, steps = align_rows(scanned, method)
    assert np.ptp([np.mean(row) for row in aligned]) < 0.1 * np.ptp([np.mean(row) for row in scanned])
    assert np.allclose(align_rows(aligned, method)[0], aligned, rtol=0, atol=1e-22)
    assert len(steps) == 1


def test_what_cannot_be_aligned_is_refused() -> None:
    _, scanned = made(0, particles=False)
    with pytest.raises(ConfigError, match="take a wider limit"):
        align_rows(scanned, "median", above_m=0.0, below_m=0.0)
    scanned[3, 4] = np.nan
    with pytest.raises(ConfigError, match="all numbers"):
        align_rows(scanned, "median")


def test_the_command_aligns_a_file_and_each_file_that_it_writes_says_so(tmp_path: Path) -> None:
    truth, scanned = made(2, particles=True)
    write_gsf(tmp_path / "scan.gsf", Image("Height", "m", scanned, 1e-6, 1e-6))
    words = ["sample", "--sample", str(tmp_path / "scan.gsf"), "--tip-radius", "0", "--out", str(tmp_path / "out")]
    result = invoke([*words, "--align-rows", "polynomial", "--mask-above", "2", "--json"])
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert len(document["steps"]) == 2
    container = gwyfile.load(str(tmp_path / "out" / "sample.gwy"))
    assert list(container["/0/data/log"]["strings"]) == document["steps"]
    found = container["/0/data"].data[::-1]
    assert rms(found - truth) < 0.3 * rms(scanned - truth)
    header = (tmp_path / "out" / "sample.gsf").read_bytes()[:2000].decode("latin-1")
    assert f"Step1 = {document['steps'][0]}" in header
    with Picture.open(tmp_path / "out" / "sample.png") as picture:
        assert document["steps"][0] in picture.info["Description"]
    refused = invoke([*words, "--mask-above", "2"])
    assert refused.exit_code != 0
    assert "--align-rows" in refused.stderr


@pytest.mark.check("images a sample in simulated time")
def test_a_scan_aligns_its_heights_and_says_so(tmp_path: Path) -> None:
    words = ["scan", "--mode", "contact", "--pixels", "16", "--lines", "8", "--out", str(tmp_path), "--json"]
    result = invoke([*words, "--align-rows", "median"])
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["steps"] == ["rows aligned: the median of each row taken off"]
    heights = gwyfile.load(str(tmp_path / "scan.gwy"))["/0/data"].data
    assert np.abs(np.median(heights, axis=1)).max() < 1e-15
