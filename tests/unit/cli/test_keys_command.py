"""`telenano keys`: what it prints and leaves behind, and what it refuses."""

import json
import os
from datetime import timedelta
from pathlib import Path

import pytest
import zmq
from zmq.utils import z85

from telenano.runtime.security.keyring import Keyring, utc_today
from telenano.testing import run

# the same at each collection: they stand in the names of tests, which two workers must agree on
KEY, OTHER = (zmq.curve_public(z85.encode(bytes([number]) * 32)).decode() for number in (1, 2))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path / "keys"))
    return tmp_path / "keys"


def document(*arguments: str) -> dict[str, object]:
    code, out, err = run("keys", *arguments, "--json")
    assert (code, err) == (0, "")
    return json.loads(out)


def test_a_new_key_is_shown_with_what_to_do_elsewhere_and_its_secret_never(folder: Path) -> None:
    code, out, err = run("keys", "new", "master")
    pair = Keyring(folder).own("master")
    assert (code, err) == (0, "")
    assert out == (
        f"made the key of master in {folder}; its public key is\n\n  {pair.public.decode()}\n\n"
        f"On each other machine:  telenano keys allow master '{pair.public.decode()}' --role ...\n"
    )
    shown = run("keys", "show")[1] + run("keys", "show", "--json")[1] + out
    assert pair.public.decode() in shown
    assert pair.secret.decode() not in shown


def test_a_key_that_is_there_is_replaced_on_demand_alone(folder: Path) -> None:
    first = document("new", "master")
    assert first == {"name": "master", "public_key": first["public_key"], "folder": str(folder)}
    code, out, err = run("keys", "new", "master")
    assert (code, out) == (2, "")
    assert err.startswith(f"telenano: {folder / 'master.key_secret'} already exists: --replace creates a new key")
    assert document("new", "master", "--replace")["public_key"] != first["public_key"]


def test_the_way_of_two_machines_to_one_another(tmp_path: Path) -> None:
    folders = {name: str(tmp_path / name) for name in ("master", "slave")}
    keys = {name: str(document("new", name, "--dir", folders[name])["public_key"]) for name in folders}
    arguments = ("--role", "data", "--role", "control", "--dir", folders["slave"])
    code, out, _ = run("keys", "allow", "master", keys["master"], *arguments)
    assert (code, out) == (0, "master is allowed: data, control\n")
    # a file that was copied serves as well as the text
    public_file = str(tmp_path / "slave" / "slave.key")
    entry = document("allow", "slave", public_file, "--role", "data", "--dir", folders["master"])
    assert entry == {"name": "slave", "public_key": keys["slave"], "roles": ["data"], "revoked": False}
    assert document("show", "--dir", folders["slave"]) == {
        "folder": folders["slave"],
        "own": {"slave": keys["slave"]},
        "allowed": [{"name": "master", "public_key": keys["master"], "roles": ["data", "control"], "revoked": False}],
    }


def test_a_table_shows_whole_keys_and_how_they_stand(folder: Path) -> None:
    code, out, _ = run("keys", "show")
    assert (code, out) == (0, f"no key is in {folder}: `telenano keys new NAME`\n")
    own = document("new", "master")["public_key"]
    run("keys", "allow", "slave", KEY, "--role", "observe", "--role", "data")
    run("keys", "allow", "laptop", OTHER, "--role", "observe")
    run("keys", "revoke", "laptop")
    rows = [line.split() for line in run("keys", "show")[1].splitlines()]
    for name, key, here in (("master", own, "own"), ("slave", KEY, "observe, data"), ("laptop", OTHER, "revoked")):
        assert any({name, key, *here.split()} <= set(row) for row in rows), (name, rows)


def test_a_role_is_needed_and_one_of_three(folder: Path) -> None:
    code, _, err = run("keys", "allow", "slave", KEY)
    assert code == 2
    assert "--role" in err
    code, _, err = run("keys", "allow", "slave", KEY, "--role", "admin")
    assert code == 2
    assert "admin" in err
    assert not folder.exists()


@pytest.mark.parametrize("by", ["slave", KEY])
def test_a_key_is_revoked_for_ever_by_name_or_by_itself(folder: Path, by: str) -> None:
    run("keys", "allow", "slave", KEY, "--role", "data")
    code, out, _ = run("keys", "revoke", by)
    assert (code, out) == (0, f"the key {KEY} of slave is revoked\n")
    code, _, err = run("keys", "allow", "slave", KEY, "--role", "data")
    assert code == 2
    assert err == f"telenano: {KEY} was revoked permanently: create a new key on slave\n"
    run("keys", "allow", "slave", OTHER, "--role", "data")
    assert document("revoke", "slave") == {"name": "slave", "public_key": OTHER, "roles": ["data"], "revoked": True}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["new", "Master"], "'Master' is not a valid machine name"),
        (["allow", "slave", "abc", "--role", "data"], "is not a public key, which has 40 characters of Z85"),
        (["allow", "slave", "/nowhere/slave.key", "--role", "data"], "/nowhere/slave.key: cannot be read"),
        (["revoke", "slave"], "there is no key of slave, listed keys are none"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_an_exit_code(folder: Path, arguments: list[str], text: str) -> None:
    code, out, err = run("keys", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("telenano: ")
    assert text in err
    assert len(err.splitlines()) == 1
    code, out, _ = run("keys", *arguments, "--json")
    assert code == 2
    assert text in json.loads(out)["error"]


def test_a_file_without_a_public_key_is_named(tmp_path: Path, folder: Path) -> None:
    for content in (b"", b"\xff\xfe", b'public-key = "\xff"\n', b'public-key = "abc"\n'):
        file = tmp_path / "slave.key"
        file.write_bytes(content)
        code, _, err = run("keys", "allow", "slave", str(file), "--role", "data")
        assert code == 2
        assert "public key" in err


def test_a_damaged_key_is_named_when_keys_are_shown(folder: Path) -> None:
    run("keys", "new", "master")
    (folder / "master.key_secret").write_text("nothing")
    code, _, err = run("keys", "show")
    assert code == 2
    assert f"{folder / 'master.key_secret'}: contains no valid key pair" in err


def test_what_others_could_have_written_is_not_shown_as_what_is_trusted(folder: Path) -> None:
    run("keys", "new", "master")
    run("keys", "allow", "slave", KEY, "--role", "data")
    for path, mode, text in ((folder / "allowed.yaml", 0o666, "change it"), (folder, 0o777, "change the files in it")):
        before = path.stat().st_mode
        path.chmod(mode)
        code, out, err = run("keys", "show")
        assert (code, out) == (2, "")
        assert err.startswith(f"telenano: {path}: other users can {text} (mode {mode:o}): chmod ")
        path.chmod(before)
    assert run("keys", "show")[0] == 0


def test_a_pipe_that_is_named_like_a_key_does_not_hang(folder: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "slave.key")
    code, _, err = run("keys", "allow", "slave", str(tmp_path / "slave.key"), "--role", "data")
    assert code == 2
    assert err == f"telenano: {tmp_path / 'slave.key'}: is a folder, pipe, socket or device, must be a regular file\n"


def test_a_secret_under_the_name_of_another_machine_is_named(folder: Path) -> None:
    for name in ("master", "slave"):
        Keyring(folder).create(name)
    assert "warning" not in run("keys", "show")[2]
    # as somebody does who carries the wrong file to a machine
    (folder / "slave.key_secret").replace(folder / "master.key_secret")
    code, out, err = run("keys", "show")
    assert code == 0
    assert "master" in out
    text = f"{folder}/master.key_secret holds the secret of slave, and by its name it should be that of master"
    assert err == f"warning: {text}\n"
    assert document("show")["warnings"] == [text]


def test_a_secret_that_is_listed_as_that_of_another_machine_is_named(folder: Path) -> None:
    ring = Keyring(folder)
    pair = ring.create("master")
    ring.allow("slave", pair.public.decode(), ["data"])
    assert "lists as that of slave, and not of master" in run("keys", "show")[2]


def test_a_secret_beside_the_public_key_of_another_is_named(folder: Path) -> None:
    ring = Keyring(folder)
    ring.create("master")
    public = (folder / "master.key").read_text()
    ring.create("master", replace=True)
    (folder / "master.key").write_text(public)
    assert "master.key beside it hold different keys" in run("keys", "show")[2]


def test_a_last_day_goes_with_the_key_into_the_list_of_the_other_machine(tmp_path: Path, folder: Path) -> None:
    until = utc_today() + timedelta(30)
    assert document("new", "master", "--expires", "30d")["expires"] == str(until)
    other = str(tmp_path / "other")
    entry = document("allow", "master", str(folder / "master.key"), "--role", "data", "--dir", other)
    assert entry["expires"] == str(until)
    assert f"data until {until}" in run("keys", "show", "--dir", other)[1]
    # what is given on the command line comes first
    sooner = utc_today() + timedelta(3)
    entry = document(
        "allow", "master", str(folder / "master.key"), "--role", "data", "--expires", str(sooner), "--dir", other
    )
    assert entry["expires"] == str(sooner)
    assert f"warning: the key of master expires at the end of {sooner} (UTC)" in run("keys", "show", "--dir", other)[2]


@pytest.mark.parametrize("text", ["soon", "d", "2020-01-01", "-1d", "2027-13-01", "9999999999d"])
def test_a_last_day_that_is_none_or_over_is_refused(folder: Path, text: str) -> None:
    code, out, err = run("keys", "new", "master", f"--expires={text}")
    assert (code, out) == (2, "")
    assert "--expires: " in err
    assert Keyring(folder).names() == []
