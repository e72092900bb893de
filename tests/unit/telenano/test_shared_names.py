"""Another distribution that has a package `proto`: named with the remedy, wherever telenano begins."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from proto import extras

ROOT = Path(__file__).parents[3]


@pytest.fixture
def overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Give the environment of a process that finds a `proto` of another distribution first."""
    # a program given as text looks into the working directory before all
    monkeypatch.chdir(tmp_path)
    (tmp_path / "proto").mkdir()
    (tmp_path / "proto" / "__init__.py").write_text('"""Of somebody else."""\n')
    about = tmp_path / "proto_plus-1.26.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: proto-plus\nVersion: 1.26.0\n")
    (about / "RECORD").write_text("proto/__init__.py,,\nproto_plus-1.26.0.dist-info/RECORD,,\n")
    return {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}


@pytest.mark.parametrize("arguments", [["status"], ["doctor"], ["estop"]])
def test_the_command_says_whose_package_is_in_the_way(overwritten: dict[str, str], arguments: list[str]) -> None:
    command = [sys.executable, "-c", "from telenano.cli.app import main; main()", *arguments]
    done = subprocess.run(command, env=overwritten, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("telenano: the package proto of proto-plus has taken the place of telenano's own")
    assert "pip uninstall proto-plus" in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_library_says_so_too(overwritten: dict[str, str]) -> None:
    program = "import telenano; telenano.open('a.mcap')"
    done = subprocess.run([sys.executable, "-c", program], env=overwritten, capture_output=True, text=True, timeout=60)
    last = done.stderr.splitlines()[-1]
    assert last.startswith("ImportError: the package proto of proto-plus has taken the place of telenano's own")


@pytest.mark.parametrize(
    ("module", "extra"),
    [
        ("numba", "studies"),
        ("pandas", "export"),
        ("matplotlib.pyplot", "viz"),
        ("serial", "haptic"),
        ("pymodbus", "afm"),
        ("starlette", "view"),
        ("gwyfile", "instrument"),
        ("cryptography", "delay"),
        ("never_heard_of", "rig"),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_has_it(module: str, extra: str) -> None:
    assert extras.extra_of(module) == extra
    assert extras.missing(module).endswith(f"[{extra}]'")


def test_the_command_names_where_this_installation_came_from(monkeypatch: pytest.MonkeyPatch) -> None:
    origins = {
        '{"dir_info": {"editable": true}, "url": "file:///a%20b/telenano"}': "pip install -e '/a b/telenano[view]'",
        '{"archive_info": {}, "url": "file:///t-0.1-py3-none-any.whl"}': "pip install '/t-0.1-py3-none-any.whl[view]'",
        '{"url": "https://example.org/t.whl"}': "pip install 'https://example.org/t.whl[view]'",
        "": "pip install 'telenano[view]'",
    }

    class Installed:
        def __init__(self, text: str) -> None:
            self.text = text

        def read_text(self, name: str) -> str:
            assert name == "direct_url.json"
            return self.text

    for text, command in origins.items():
        monkeypatch.setattr("importlib.metadata.distribution", lambda name, text=text: Installed(text))
        assert extras.how_to_install("view") == command
