"""What `make dist` checks before a release goes out: the parts of the wheel, and the licences of what comes with it."""

import importlib.util
import tarfile
import zipfile
from importlib.metadata import Distribution
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
_spec = importlib.util.spec_from_file_location("release", ROOT / "tests" / "releases" / "release.py")
assert _spec is not None
assert _spec.loader is not None
release = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(release)


def wheel(folder: Path, *names: str) -> Path:
    path = folder / "telenano-0.1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, "")
    return path


def test_a_wheel_without_its_page_or_with_tests_does_not_go_out(tmp_path: Path) -> None:
    release.check_wheel(wheel(tmp_path, *release.WANTED), release.WANTED)
    with pytest.raises(release.ReleaseError, match=r"lacks services/viz_node/web/dist/index\.html"):
        release.check_wheel(wheel(tmp_path, *release.WANTED[:-1]), release.WANTED)
    for name in ("tests/a.py", "telenano_laws/tests/a.py"):
        with pytest.raises(release.ReleaseError, match=f"has {name} and 0 more that do not belong"):
            release.check_wheel(wheel(tmp_path, name), ())


def source(folder: Path, *names: str) -> Path:
    path = folder / "telenano-0.1.0.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        for name in names:
            archive.addfile(tarfile.TarInfo(f"telenano-0.1.0/{name}"))
    return path


def test_a_source_distribution_without_its_tests_or_with_what_is_made_does_not_go_out(tmp_path: Path) -> None:
    release.check_source(source(tmp_path, *release.WANTED_IN_SOURCE))
    with pytest.raises(release.ReleaseError, match=r"tar\.gz: lacks services/viz_node/web/package-lock\.json"):
        release.check_source(source(tmp_path, *release.WANTED_IN_SOURCE[:-1]))
    with pytest.raises(release.ReleaseError, match=r"has out/a\.mcap and 0 more that are made from the others"):
        release.check_source(source(tmp_path, *release.WANTED_IN_SOURCE, "out/a.mcap"))


class Package(Distribution):
    def __init__(self, text: str) -> None:
        self.text = text

    def read_text(self, filename: str) -> str | None:
        return self.text if filename == "METADATA" else None

    def locate_file(self, path: Any) -> Path:
        return Path(path)


def package(name: str, *lines: str) -> Package:
    return Package("\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1", *lines, "", ""]))


def test_licences_are_listed_as_stated_and_copyleft_first() -> None:
    found = release.licences(
        [
            package("beta", "License-Expression: MIT"),
            package("alpha", "Classifier: License :: OSI Approved :: BSD License", "License: BSD, see LICENSE"),
            package("gamma", "Classifier: License :: OSI Approved :: GNU Lesser General Public License v3 (LGPLv3)"),
            package("delta"),
            package("telenano", "License-Expression: none"),
            package("telenano-laws", "License-Expression: none"),
        ]
    )
    assert [line.split(" | ")[0] for line in found.splitlines()[6:]] == ["| gamma", "| alpha", "| beta", "| delta"]
    assert "LGPLv3) **(copyleft)**" in found
    lesser = package("gamma", "License-Expression: LGPL-3.0-or-later")
    said = release.brought_with([lesser, package("beta", "License-Expression: MIT")])
    assert said == "rig and packages bring 2 distributions; more than to be named is asked by gamma (LGPL-3.0-or-later)"
    assert release.brought_with([]).endswith("asked by none")
    assert "| delta | 1 | not stated |" in found


def test_a_python_that_is_only_a_name_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shim = tmp_path / "python3.99"
    shim.write_text("#!/bin/sh\nexit 127\n")
    shim.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not release.starts("python3.99")
    assert not release.starts("python3.98")
    shim.write_text("#!/bin/sh\nexit 0\n")
    assert release.starts("python3.99")
