"""A reader in a child hands back what it read, and cannot take more than it is given."""

import sys
from pathlib import Path

import numpy as np
import pytest

from telenano.files.limited_child import Limits, read_in_child

READER = """
import os, signal, sys, time
import numpy as np

def whole(path, *texts):
    print("a library that prints")
    content = np.frombuffer(open(path, "rb").read(), np.uint8)
    return {"texts": texts, "k": 1.5}, [content, np.arange(6.0).reshape(2, 3).T]

def memory(path):
    return {}, [np.ones(10**9)]

def endless(path):
    while True:
        pass

def waits(path):
    time.sleep(1000)

def crashes(path):
    os.kill(os.getpid(), signal.SIGSEGV)

def leaves(path):
    os._exit(3)

def exits(path):
    sys.exit("with a word")

def missing(path):
    import no_such_package

def refuses(path):
    raise PermissionError(13, "Permission denied", path)

def key(path):
    return {}["data"]
"""
SMALL = Limits(256 << 20, 1, 20.0)


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "reader_in_child.py").write_text(READER)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    (tmp_path / "file").write_bytes(bytes(range(100)))
    return tmp_path / "file"


def test_values_and_arrays_come_back_as_they_were(file: Path) -> None:
    facts, (content, table) = read_in_child("reader_in_child:whole", file, "a", None)
    assert facts == {"texts": ["a", None], "k": 1.5}
    assert content.tobytes() == bytes(range(100))
    assert np.array_equal(table, [[0.0, 3.0], [1.0, 4.0], [2.0, 5.0]])
    # it is the reader's own, and may be changed
    table[0, 0] = 1.0


@pytest.mark.check("takes 1.0 s")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("memory", "it cannot be read with 256 MB of memory"),
        ("endless", "it cannot be read within 1 s of processor time"),
        ("crashes", "it cannot be read: the program that reads it was ended by SIGSEGV"),
        ("leaves", "it cannot be read: the program that reads it ended with code 3"),
        ("exits", "with a word"),
        ("key", "KeyError: 'data'"),
    ],
)
def test_what_a_reader_does_ends_in_a_sentence(file: Path, name: str, said: str) -> None:
    with pytest.raises(ValueError, match=f"^{said}$"):
        read_in_child(f"reader_in_child:{name}", file, limits=SMALL)


@pytest.mark.check("waits until a reader is given up")
def test_a_reader_that_waits_is_given_up(file: Path) -> None:
    with pytest.raises(ValueError, match="it cannot be read within 2 s"):
        read_in_child("reader_in_child:waits", file, limits=SMALL._replace(wall_s=2.0))


def test_what_is_missing_or_not_permitted_is_raised_as_it_was(file: Path) -> None:
    with pytest.raises(ImportError) as missing:
        read_in_child("reader_in_child:missing", file)
    assert missing.value.name == "no_such_package"
    with pytest.raises(OSError, match="Permission denied"):
        read_in_child("reader_in_child:refuses", file)


def test_a_larger_file_may_take_more_and_none_may_be_without_end(file: Path) -> None:
    assert Limits.of_size(1 << 30).memory_bytes > Limits.of_size(1000).memory_bytes > 1 << 28
    with file.open("r+b") as stream:
        stream.truncate((1 << 30) + 1)
    with pytest.raises(ValueError, match="it has 1073741825 bytes; at most 1073741824 are read"):
        read_in_child("reader_in_child:whole", file)
