"""What is looked at before a rig is started: disks, rights and descriptors, each refused with its path and number."""

import os
import random
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from telenano.launcher.disk_space import check_room
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.descriptors import Descriptors, check_rig, needed_by
from telenano.settings.included import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.testing import disk_of
from telenano.wire.errors import EndpointError, RigError

PLENTY = {"f_frsize": 4096, "f_bavail": 1 << 20, "f_files": 1 << 20, "f_favail": 1 << 20, "f_flag": 0}


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    for name in ("run", "tmp", "out"):
        (tmp_path / name).mkdir(mode=0o700)
    return make_plan(UpRequest(scenario="fig12", out=tmp_path / "out"), tmp_path)


def disks(tmp_path: Path, name: str, **lacks: int) -> Any:
    """Return what says of each disk that it has plenty, but of one."""

    def status(path: Path) -> Any:
        return SimpleNamespace(**(PLENTY | lacks if path == tmp_path / name else PLENTY))

    return status


def test_disks_with_plenty_and_of_odd_kinds_are_no_obstacle(tmp_path: Path, plan: Plan) -> None:
    check_room(plan)
    check_room(plan, disks(tmp_path, ""))
    check_room(plan, disks(tmp_path, "out", f_files=0, f_favail=0))

    def unknown(path: Path) -> Any:
        raise PermissionError

    check_room(plan, unknown)


@pytest.mark.parametrize("name", ["out", "run"])
def test_each_disk_without_room_is_refused_with_its_path_and_both_sizes(tmp_path: Path, plan: Plan, name: str) -> None:
    draw, refused = random.Random(name), 0
    for _ in range(50):
        left = {"f_bavail": draw.randrange(400), "f_frsize": draw.choice((512, 4096, 65536))}
        try:
            check_room(plan, disks(tmp_path, name, **left))
        except RigError as error:
            refused += 1
            numbers = re.fullmatch(rf"{tmp_path / name}: its disk has (\d+) kB left, .* takes (\d+) kB .*", str(error))
            assert numbers is not None, error
            assert int(numbers[1]) == round(left["f_bavail"] * left["f_frsize"] / 1e3)
            assert int(numbers[1]) <= int(numbers[2])
    assert 0 < refused < 50
    with pytest.raises(RigError, match=rf"{tmp_path / name}: its disk takes 3 more files, .* which are \d+"):
        check_room(plan, disks(tmp_path, name, f_favail=3))
    with pytest.raises(RigError, match=rf"{tmp_path / name}: its disk is mounted read-only"):
        check_room(plan, disks(tmp_path, name, f_flag=os.ST_RDONLY))


def test_a_folder_that_cannot_be_written_to_is_refused_and_one_that_is_to_be_made_is_judged_by_its_parent(
    tmp_path: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "out").rmdir()
    check_room(plan)
    (tmp_path / "out").write_text("a file")
    with pytest.raises(RigError, match="out: is not a folder, and the session is recorded there"):
        check_room(plan)
    (tmp_path / "out").unlink()
    monkeypatch.setattr("os.access", lambda path, how: Path(path) != tmp_path)
    with pytest.raises(RigError, match=f"{tmp_path}: this user may not write there, and the session is recorded"):
        check_room(plan)


@pytest.mark.check("takes 3 s")
def test_up_on_a_full_disk_ends_in_a_sentence_with_the_path_before_it_has_made_anything(tmp_path: Path) -> None:
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(tmp_path / "run")}
    with disk_of(tmp_path / "run", "64k") as full:
        (full / "filler").write_bytes(bytes(40_000))
        command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--out", str(tmp_path / "out")]
        done = subprocess.run(
            [*command, "--headless"], env=environment, capture_output=True, text=True, timeout=60, check=False
        )
        assert [path.name for path in full.iterdir()] == ["filler"]
    assert not (tmp_path / "out").exists()
    assert done.returncode == 1
    assert re.fullmatch(rf"telenano: {tmp_path / 'run'}: its disk has \d+ kB left, .*\n", done.stderr), done.stderr


# --- descriptors ---


def test_the_node_that_needs_most_is_named_with_what_it_needs_and_may_have(monkeypatch: pytest.MonkeyPatch) -> None:
    for site_file in (DEFAULT_SITE_FILE, TWO_SITES_FILE):
        book = AddressBook.load(site_file)
        needs = {node: needed_by(book, node, 8).needed for node in book.nodes}
        most = max(needs.values())
        monkeypatch.setattr("telenano.runtime.wiring.descriptors.descriptor_limit", lambda limit=most: limit)
        check_rig(book, list(book.nodes), 8)
        monkeypatch.setattr("telenano.runtime.wiring.descriptors.descriptor_limit", lambda limit=most - 1: limit)
        with pytest.raises(EndpointError, match=f"needs {most} open files, and may have {most - 1}: raise `ulimit -n`"):
            check_rig(book, list(book.nodes), 8)
        # Each further file that is held is one that all need, and a node that is not started is not asked for.
        assert {node: needed_by(book, node, 9).needed - 1 for node in book.nodes} == needs
        check_rig(book, [node for node in book.nodes if needs[node] < most], 8)
    check_rig(book, [], 8)


def test_what_is_open_or_permitted_may_be_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telenano.runtime.wiring.descriptors.descriptor_limit", lambda: None)
    descriptors = Descriptors(1)
    descriptors.add_reader(10**6)
    descriptors.check("nobody")
    monkeypatch.setattr("telenano.runtime.wiring.descriptors.descriptor_limit", lambda: 10)
    monkeypatch.setattr("telenano.runtime.wiring.descriptors.open_descriptors", lambda: None)
    unknown = Descriptors(1)
    unknown.add_reader(10**6)
    unknown.check("nobody")


@pytest.mark.check("takes 2 s each")
@pytest.mark.parametrize(
    "words",
    [
        ("up", "--scenario", "fig12", "--headless", "--out", "{out}"),
        ("node", "afm_node", "--scenario", "fig12", "--site", "slave"),
        ("node", "recorder", "--scenario", "fig12"),
        ("record", "--out", "{out}/x.mcap", "--duration", "1"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_every_start_with_too_few_descriptors_ends_in_one_sentence(tmp_path: Path, words: tuple[str, ...]) -> None:
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(tmp_path / "run")}
    command = [sys.executable, "-m", "telenano", *(word.format(out=tmp_path) for word in words)]
    done = subprocess.run(
        ["prlimit", "--nofile=20", *command], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    text = done.stdout + done.stderr
    assert done.returncode in (1, 2), text
    assert "Traceback" not in text
    assert re.search(r"needs \d+ open files, and may have 20: raise `ulimit -n`", text), text
