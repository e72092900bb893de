"""`telenano push` as a user calls it, in simulated time."""

import json
import math
from typing import Any

import pytest

from telenano.testing import invoke

FAST = ("--speed", "5000", "--approach", "5000", "--afm", "sample.size_m=2.5e-6")


def run(*words: str) -> Any:
    return invoke(["push", *words])


def test_a_push_says_where_the_particle_is_believed_to_be_and_where_it_is() -> None:
    done = run("--from", "0,0", "--to", "300,100", "--json", *FAST)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["why"], document["at_goal"]) == ("the particle is at its goal", True)
    assert math.dist(document["believed_m"], document["true_m"]) < 5e-9
    assert math.dist(document["true_m"], (3e-7, 1e-7)) < 20e-9
    assert document["plateau_n"] == pytest.approx(10.75e-9, rel=0.05)
    assert document["error_m"] == pytest.approx(math.dist(document["believed_m"], (3e-7, 1e-7)))


def test_where_no_particle_is_it_says_so() -> None:
    done = run("--from", "0,0", "--to", "300,0", "--json", *FAST, "--afm", "sample.particles.places=[[0.0,7e-7]]")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["why"], document["at_goal"], document["in_contact"]) == ("no particle was met", False, False)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--from", "0", "--to", "100,0"), "--from 0: must be two numbers in nm with a comma between"),
        (("--from", "0,0", "--to", "nan,0"), "--to nan,0: must lie within 1e+06 nm of the middle of the sample"),
        (("--from", "0,0", "--to", "1e9,0"), "--to 1e9,0: must lie within 1e+06 nm"),
        (("--from", "0,0", "--to", "0,0"), "within push.tolerance_m = 5e-09 m of its goal already"),
        (("--from", "0,0", "--to", "100,0", "--radius", "0"), "--radius"),
        (("--from", "0,0", "--to", "100,0", "--live", "--afm", "model=dynamic"), "--afm: not with --live"),
    ],
)
def test_what_cannot_be_pushed_is_one_sentence(words: tuple[str, ...], sentence: str) -> None:
    refused = run(*words)
    assert refused.exit_code != 0
    assert sentence in " ".join(refused.output.split())
