"""`telenano particles` and `telenano assemble` as a user calls them."""

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from telenano_lab.assembly.find import sphere_m
from telenano_lab.assembly.messages import AfmParticles
from telenano_lab.assembly.particles.tip_shape import tip_shape

from telenano.recording import Recording
from telenano.testing import invoke

ONE = ("--afm", "sample.particles.places=[[0.0,0.0]]", "--afm", "sample.size_m=2.5e-6")


def run(*words: str) -> Any:
    return invoke(list(words))


@pytest.fixture
def image(tmp_path: Path) -> Path:
    axis = (np.arange(40) - 19.5) * 62.5e-9
    distance = np.hypot(axis[None, :] - 3e-7, axis[:, None] + 2e-7)
    heights = sphere_m(tip_shape(10e-9, np.radians(15.0)), 250e-9, distance)
    # the first row of a file is the top of the picture
    np.save(tmp_path / "scan.npy", heights[::-1])
    return tmp_path / "scan.npy"


def test_the_particles_of_an_image_are_listed_and_written(image: Path, tmp_path: Path) -> None:
    shown = run("particles", str(image), "--size", "2500", "--out", str(tmp_path / "found.json"))
    assert shown.exit_code == 0, shown.output
    assert "1 particles in" in shown.output.replace("\n", " ") and "300.00" in shown.output
    (one,) = json.loads((tmp_path / "found.json").read_text())["particles"]
    assert (one["x_m"], one["y_m"], one["radius_m"]) == pytest.approx((3e-7, -2e-7, 250e-9), rel=1e-3)
    assert json.loads(run("particles", str(image), "--size", "2500", "--json").output)["particles"] == [one]


def test_an_assembly_of_one_particle_places_it_and_writes_figure_and_table(tmp_path: Path) -> None:
    (tmp_path / "there.txt").write_text("# one place\n3e-7, 0\n")
    out = tmp_path / "out"
    done = run("assemble", "--pattern", str(tmp_path / "there.txt"), "--out", str(out), "--json", *ONE)
    assert done.exit_code == 0, done.output
    document = json.loads(done.output)
    assert (document["placed"], document["losses"]) == (1, 0)
    assert document["particles"][0]["true_error_m"] < 20e-9
    assert {path.name for path in out.iterdir()} == {"assembly.json", "assembly.png", "assembly.mcap"}
    judge_recording(out / "assembly.mcap")


def judge_recording(path: Path) -> None:
    """Look for what a page needs to show the assembly again: images, pushes, sentences, and the truth apart."""
    recording = Recording(path)
    assert run("bag", "verify", str(path)).exit_code == 0
    lines = [message.fields() for message in recording.messages(("afm/scanline",))]
    assert sum(line["line"] == 0 and line["direction"] == "trace" for line in lines) >= 3
    programs = [message.fields() for message in recording.messages(("afm/program",))]
    ends = [one["text"] for one in programs if one["program"] == "push" and one["state"] == "finished"]
    assert len(ends) == 1
    assert any(one["values"]["in_contact"] for one in programs if one["program"] == "push")
    told = [message.fields()["text"] for message in recording.messages(("session/event",))]
    assert told[0] == "1 particles were found" and "particle 0: the particle is at its goal" in told
    places = [msgspec.convert(row.fields(), AfmParticles).places_m for row in recording.messages(("afm/particles",))]
    assert math.dist(places[-1].to_numpy()[0], (3e-7, 0.0)) < 20e-9


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--pattern", "square", "--count", "6"), "its outline has 4, 8, 12"),
        (("--pattern", "no-such"), "is not one of line, square, ring"),
        (("--pattern", "line", "--spacing", "2000"), "target 0 at -7e-06, 0 m must lie 3.33e-07 m or more within the"),
        (("--afm", "sample.particles.places=[[0.0,0.0],[1e-7,0.0]]"), "numbers 0 and 1 overlap"),
        (("--afm", "sample.particles.places=[[9e-6,0.0]]"), "number 0 at 9e-06, 0 m with the radius"),
        (
            ("--pattern", "line", "--count", "3", "--spacing", "700", *ONE),
            "the pattern has 3 places, and 1 particles were found",
        ),
        (("--afm", "sample.particles.radius_m=0"), "radius_m"),
        (("--pattern", "letters:A?"), "'?' is not one of A to Z, 0 to 9 and space"),
        (("--pattern", "line", "--spacing", "400"), "targets 0 and 1 are 4e-07 m apart"),
    ],
)
def test_what_cannot_be_assembled_is_one_sentence_and_leaves_nothing(
    words: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    refused = run("assemble", "--out", str(tmp_path / "out"), *words)
    assert refused.exit_code == 2, refused.output
    assert said in " ".join(refused.output.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"1e-6 0\nhere\n", "line 2: must be x and y in m"),
        (b"nan 0\n", "line 1: must be x and y in m"),
        (b"\xff\xfe\x00", "is not text"),
        (b"# none\n", "has no places"),
    ],
)
def test_a_file_that_is_no_pattern_is_refused_by_name(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "places").write_bytes(content)
    refused = run("assemble", "--out", str(tmp_path / "out"), "--pattern", str(tmp_path / "places"))
    assert refused.exit_code == 2 and f"{tmp_path}/places" in refused.output.replace("\n", ""), refused.output
    assert said in " ".join(refused.output.split())


def test_lost_pixels_are_left_out_and_an_image_of_nothing_else_is_refused(image: Path) -> None:
    heights = np.load(image)
    heights[::7, ::3] = np.nan
    np.save(image, heights)
    (one,) = json.loads(run("particles", str(image), "--size", "2500", "--json").output)["particles"]
    assert (one["x_m"], one["y_m"], one["radius_m"]) == pytest.approx((3e-7, -2e-7, 250e-9), rel=0.02)
    np.save(image, np.full_like(heights, np.nan))
    refused = run("particles", str(image), "--size", "2500")
    assert refused.exit_code == 2 and "1600 heights that are not finite" in " ".join(refused.output.split())


def test_an_image_of_two_pixels_is_refused_by_name(image: Path) -> None:
    np.save(image, np.zeros((2, 2)))
    refused = run("particles", str(image), "--size", "2500")
    assert refused.exit_code == 2
    assert "scan.npy: an image has at least 3 rows and columns" in refused.output.replace("\n", " ")
