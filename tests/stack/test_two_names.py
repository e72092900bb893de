"""What the wheel puts into an environment: two import names, and nothing that a distribution of others has as well."""

import zipfile
from pathlib import Path

import pytest
from installations import ROOT, Installation, wheel_of

pytestmark = pytest.mark.endurance("builds and installs wheels")

# The distribution has the import name of proto-plus, which comes with every client of Google.
STRANGER = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "proto-stand-in"
version = "1.0"

[tool.hatch.build.targets.wheel]
packages = ["proto"]
"""
BOTH = """
import proto, telenano
from telenano.wire.topics import OWN_TOPICS as TOPICS
from telenano.wire import decode
from telenano.wire import example
assert proto.NAME == "the stranger's" and len(TOPICS) > 20
assert example("afm/state", seq=7).seq == 7
print(telenano.simulate("fig12", duration_s=1.0).verdict is not None)
"""


@pytest.fixture(scope="module")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stranger")
    (folder / "source" / "proto").mkdir(parents=True)
    (folder / "source" / "proto" / "__init__.py").write_text('NAME = "the stranger\'s"\n')
    (folder / "source" / "pyproject.toml").write_text(STRANGER)
    return wheel_of(folder / "source", folder)


def test_the_wheel_has_two_import_names_and_each_package_one(wheel: Path, tmp_path: Path) -> None:
    assert _names(wheel) == {"services", "telenano"}
    for folder in sorted(path.parent for path in ROOT.glob("packages/*/pyproject.toml")):
        assert _names(wheel_of(folder, tmp_path / folder.name)) == {folder.name.replace("-", "_")}


@pytest.mark.parametrize("is_first", [False, True], ids=["before", "after"])
def test_a_distribution_of_others_that_installs_proto_and_telenano_leave_each_other_whole(
    is_first: bool, wheel: Path, stranger: Path, tmp_path: Path
) -> None:
    installation = Installation(tmp_path, *((wheel, ()) if is_first else (stranger, ())))
    installation.add(stranger if is_first else wheel)
    done = installation.run(str(installation.python), "-c", BOTH)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr


def _names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as file:
        tops = {name.partition("/")[0] for name in file.namelist()}
    return {top for top in tops if not top.endswith(".dist-info")}
