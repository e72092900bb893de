"""Whose a file is, judged by every folder above it: what others can rename they can replace."""

import os
from pathlib import Path

import pytest

from telenano.files.regular_files import is_own_path

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")


@pytest.fixture
def leaf(tmp_path: Path) -> Path:
    path = tmp_path / "a" / "b" / "leaf"
    path.mkdir(parents=True, mode=0o700)
    for folder in (tmp_path, tmp_path / "a", tmp_path / "a" / "b"):
        folder.chmod(0o755)
    return path


@pytest.mark.parametrize("above", [1, 2, 3])
def test_a_folder_that_others_can_write_at_any_height_is_none_of_ones_own(leaf: Path, above: int) -> None:
    folder = leaf.parents[above - 1]
    assert is_own_path(leaf) and is_own_path(leaf / "absent")
    for mode in (0o777, 0o757, 0o702):
        folder.chmod(mode)
        assert not is_own_path(leaf), (folder, mode)
    # as in /tmp, others cannot rename what is not theirs
    folder.chmod(0o1777)
    assert is_own_path(leaf)


@as_root
@pytest.mark.parametrize("above", [1, 2, 3])
def test_a_folder_of_another_user_or_group_at_any_height_is_none_of_ones_own(leaf: Path, above: int) -> None:
    folder = leaf.parents[above - 1]
    os.chown(folder, -1, 12345)
    folder.chmod(0o775)
    assert not is_own_path(leaf)
    # the group that has the number of the user is the user's alone
    os.chown(folder, -1, os.getuid())
    assert is_own_path(leaf)
    os.chown(folder, 12345, -1)
    folder.chmod(0o755)
    assert not is_own_path(leaf)


@as_root
def test_a_link_of_another_user_at_any_height_is_none_of_ones_own(leaf: Path, tmp_path: Path) -> None:
    for link, way in ((tmp_path / "to_a", "b/leaf"), (tmp_path / "to_leaf", "")):
        link.symlink_to(tmp_path / "a" if way else leaf)
        assert is_own_path(link / way)
        os.chown(link, 12345, -1, follow_symlinks=False)
        assert not is_own_path(link / way)
