"""From each state of the rig the filled button of the page leads to a touch in at most eight presses.

Three hundred walks that a generator draws; `make check` has two of them.
"""

import shutil
import subprocess
from pathlib import Path

import pytest
from page_walk import MOST_PRESSES, PageWalk, walks

from services.viz_node import build_page

WEB = Path(build_page.__file__).parent / "web"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return what decides on the page, bundled for Node.js, and the program that runs it."""
    node, bundler = build_page.node_folder(), WEB / "node_modules" / "rolldown" / "bin" / "cli.mjs"
    if node is None or not bundler.is_file():
        pytest.skip("the page has not been built: make page")
    bundle = tmp_path_factory.mktemp("walk") / "walker.mjs"
    options = ["test/walker.ts", "--format", "esm", "--platform", "node", "-o", str(bundle)]
    subprocess.run([str(node / "node"), str(bundler), *options], cwd=WEB, check=True, capture_output=True)
    return bundle, shutil.which("node", path=str(node)) or "node"


@pytest.mark.check("walks in virtual time beside a page in Node.js")
@pytest.mark.parametrize("seed", [4, 20])
def test_the_filled_button_leads_to_a_touch(page: tuple[Path, str], seed: int) -> None:
    for _, presses in walks([seed], *page):
        assert presses <= MOST_PRESSES


@pytest.mark.endurance
@pytest.mark.parametrize("first", range(0, 300, 10))
def test_three_hundred_walks(page: tuple[Path, str], first: int) -> None:
    counts = [presses for _, presses in walks(range(first, first + 10), *page)]
    assert max(counts) <= MOST_PRESSES


@pytest.mark.check("a session in virtual time beside a page in Node.js")
def test_after_each_withdrawal_the_hand_has_the_travel_of_a_fresh_start(page: tuple[Path, str]) -> None:
    with PageWalk(117, *page) as walk:
        walk.presses_to_touch()
        contacts_m = []
        for _ in range(3):
            contacts_m.append(walk.rig.hands[-1].place_m)
            walk.rig.command("stop", "afm_node")
            walk.wait(0.5)
            assert walk.presses_to_touch() <= MOST_PRESSES
        # A hand that lost travel with each withdrawal would meet the sample lower and lower.
        assert max(contacts_m) - min(contacts_m) < 1.5e-3


@pytest.mark.check("a session in virtual time beside a page in Node.js")
def test_hand_and_tip_do_not_meet_in_the_sample(page: tuple[Path, str]) -> None:
    """Nobody holds the hand while hand and tip are brought together: a hand that is too low is to be lifted."""
    with PageWalk(118, *page) as walk:
        walk.presses_to_touch()
        walk.rig.command("stop", "afm_node")
        walk.wait(0.5)
        walk.key("n")
        walk.wait(1.0)
        walk.couple()
        assert "lift" in walk.trace[-1]
        assert not walk.rig.states[-1].in_contact
