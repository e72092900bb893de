"""The pure parts of the page: ring buffers, decimation, colours, decoding of the golden vectors, in Vitest."""

import os
import subprocess
from pathlib import Path

import pytest

from services.viz_node import build_page

WEB = Path(build_page.__file__).parent / "web"


def test_the_pure_parts_of_the_page() -> None:
    node = build_page.node_folder()
    vitest = WEB / "node_modules" / "vitest" / "vitest.mjs"
    if node is None or not vitest.is_file():
        pytest.skip("the page has not been built: make page")
    done = subprocess.run([str(node / "node"), str(vitest), "run"], cwd=WEB, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_page_is_as_new_as_its_newest_source(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(build_page, "WEB", tmp_path)
    (tmp_path / "src").mkdir()
    (tmp_path / "dist").mkdir()
    source, page = tmp_path / "src" / "main.ts", tmp_path / "dist" / "index.html"
    source.write_text("")
    assert not build_page.is_built()
    page.write_text("")
    assert build_page.is_built()
    source.write_text("changed")
    newer_ns = page.stat().st_mtime_ns + 10**9

    os.utime(source, ns=(newer_ns, newer_ns))
    assert not build_page.is_built()


def test_npm_is_run_from_its_package_where_that_lies_beside_the_node(tmp_path: Path) -> None:
    folder = tmp_path / "bin"
    assert build_page.npm_of(folder) == [str(folder / "npm")]
    package = tmp_path / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    package.parent.mkdir(parents=True)
    package.write_text("")
    # the script in a wheel is a copy, which no longer finds what it belongs to
    assert build_page.npm_of(folder) == [str(folder / "node"), str(package)]


def test_without_a_node_that_is_new_enough_the_page_is_not_built(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build_page, "WEB", tmp_path)
    monkeypatch.setattr(build_page, "_LEAST_NODE", (999, 0))
    assert build_page.main() == 1
    assert "Node.js 999.0 or newer is needed" in capsys.readouterr().err
