"""A file whose reader lacks a library names the package, and what it is installed with."""

from pathlib import Path
from typing import Any

import pytest

from telenano.sections import read_surface
from telenano.settings import file_readers
from telenano.wire import ConfigError


def test_a_library_that_is_missing_is_named_with_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(*arguments: Any, **options: Any) -> Any:
        raise ImportError(name="afmformats")

    monkeypatch.setattr(file_readers, "read_in_child", lacking)
    (tmp_path / "map.spm").write_bytes(b"\\*File list")
    with pytest.raises(ConfigError, match=r"needs afmformats to be read: afmformats is not installed: .*"):
        read_surface(tmp_path / "map.spm")
