"""`make regenerate` names, rewrites and removes what the code does not make, and leaves the rest as it is."""

from pathlib import Path

import pytest
import regenerate


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[Path, str]:
    """Return three files as the code makes them, of which one is there, one differs and one is missing."""
    schemas = tmp_path / "proto" / "schemas"
    schemas.mkdir(parents=True)
    files = {schemas / "Same.json": "same", schemas / "Other.json": "new", tmp_path / "docs" / "page.md": "page"}
    (schemas / "Same.json").write_text("same")
    (schemas / "Other.json").write_text("old")
    (schemas / "Gone.json").write_text("gone")
    monkeypatch.setattr(regenerate, "ROOT", tmp_path)
    monkeypatch.setattr(regenerate, "files", lambda: files)
    return files


def test_a_stale_file_is_named_with_the_command_that_renews_it(
    made: dict[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert regenerate.main(["--check"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[0] for line in lines] == [
        "docs/page.md",
        "proto/schemas/Gone.json",
        "proto/schemas/Other.json",
    ]
    assert all("`make regenerate`" in line for line in lines)


def test_stale_files_are_written_once(made: dict[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert regenerate.main([]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "wrote docs/page.md",
        "removed proto/schemas/Gone.json: its message is gone",
        "wrote proto/schemas/Other.json",
    ]
    assert all(path.read_text() == text for path, text in made.items())
    assert regenerate.main([]) == regenerate.main(["--check"]) == 0
    assert capsys.readouterr().out == capsys.readouterr().err == ""
