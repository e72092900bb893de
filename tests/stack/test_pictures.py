"""Each picture of the documents whose title names a file of out/ is what the command beside it makes.

With TELENANO_PICTURES set the pictures of docs/ are renewed: `make pictures`. Look at them.
"""

import os
import sys
from pathlib import Path

import pytest
from browser_page import keep
from documented_lines import PICTURE, Line, Picture, differing, lines, makes, of_kind, pictures
from documents import LONGEST_S, ROOT, lines_of, prepare, run

pytestmark = [pytest.mark.stack, pytest.mark.endurance]
# of the pixels that may differ: curves of a live rig are never the same twice
_MOST = {"up": 0.10}
_ALIKE = 0.01


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pictures")


def maker_of(picture: Picture) -> Line:
    """Return the line of its page that makes a picture, which has to be the only one."""
    (found,) = [line for line in lines_of(picture.page) if makes(line, picture.origin)] or [
        line for line in lines_of(picture.page) if line.text.startswith("make demo")
    ]
    return found


def test_every_page_with_pictures_has_the_commands_that_make_them() -> None:
    assert len([picture for picture in pictures() if picture.page == "packages/telenano-lab/docs/gallery.md"]) >= 8
    assert {maker_of(picture) for picture in pictures()} >= set(of_kind(PICTURE))
    assert all(line in lines() for line in of_kind(PICTURE))


@pytest.mark.timeout(LONGEST_S)
@pytest.mark.parametrize("picture", pictures(), ids=lambda picture: f"{Path(picture.page).stem}-{picture.origin}")
def test_a_picture_is_what_its_command_makes(picture: Picture, place: Path) -> None:
    line, made = maker_of(picture), place / picture.origin
    if not made.exists():
        prepare(line, place)
        words = line.words if line.is_telenano else ["up", "--scenario", "fig12", "--out", str(made.parent)]
        done = run([sys.executable, "-m", "telenano", *words], place)
        assert done.returncode in (0, 3), done.stderr
    shipped = ROOT / Path(picture.page).parent / picture.path
    if "TELENANO_PICTURES" in os.environ:
        shipped.parent.mkdir(exist_ok=True)
        keep(made.read_bytes(), shipped)
    most = _MOST.get(line.words[0] if line.is_telenano else "up", _ALIKE)
    assert differing(made, shipped) < most, "run `make pictures`, and look at them"
