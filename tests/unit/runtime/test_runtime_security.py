"""Keys on disk: who can read them, what is refused of them, and what becomes of a list of other machines' keys."""

import os
from datetime import date
from pathlib import Path

import pytest
import yaml
import zmq
from zmq.utils import z85

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import AllowedKey, KeyPair, Keyring, key_text, keys_directory, this_machine
from telenano.wire.errors import ConfigError, RigError


def secret_key(number: int) -> bytes:
    """Return a key that is the same at each collection: keys stand in the names of tests, which workers agree on."""
    return z85.encode(bytes([number]) * 32)


def public_key(number: int) -> str:
    return zmq.curve_public(secret_key(number)).decode()


KEY, OTHER = public_key(1), public_key(2)


@pytest.fixture
def ring(tmp_path: Path) -> Keyring:
    return Keyring(tmp_path / "keys")


def refusal_of(call: object, *arguments: object, **more: object) -> str:
    with pytest.raises(ConfigError) as caught:
        call(*arguments, **more)
    return str(caught.value)


def listed(ring: Keyring) -> list[tuple[str, str, tuple[str, ...], bool]]:
    return [(key.name, key.public_key, key.roles, key.revoked) for key in ring.allowed().keys]


def secret_file(ring: Keyring, name: str = "master") -> Path:
    return ring.folder / f"{name}.key_secret"


# --- the own key ---


def test_a_key_pair_is_made_for_this_user_alone(ring: Keyring) -> None:
    before = os.umask(0)
    try:
        pair = ring.create("master")
    finally:
        assert os.umask(before) == 0
    assert zmq.curve_public(pair.secret) == pair.public
    assert ring.own("master") == pair
    assert ring.names() == ["master"]
    assert ring.folder.stat().st_mode & 0o777 == 0o700
    assert {path.name: path.stat().st_mode & 0o777 for path in ring.folder.iterdir()} == {
        "allowed.yaml.lock": 0o600,
        "master.key": 0o600,
        "master.key_secret": 0o600,
    }
    assert pair.secret not in (ring.folder / "master.key").read_bytes()


def test_a_key_is_replaced_only_when_that_is_wanted(ring: Keyring) -> None:
    pair = ring.create("master")
    text = refusal_of(ring.create, "master")
    assert text == (
        f"{secret_file(ring)} already exists: --replace creates a new key, which the other machines must allow"
    )
    assert ring.own("master") == pair
    assert ring.create("master", replace=True) != pair
    assert ring.create("slave", replace=True) == ring.own("slave")
    assert ring.names() == ["master", "slave"]


def test_a_key_that_looks_like_an_option_is_not_given_out(ring: Keyring, monkeypatch: pytest.MonkeyPatch) -> None:
    real, pairs = zmq.curve_keypair, []
    while len(pairs) < 2:
        pair = real()
        if pair[0].startswith(b"-") == (not pairs):
            pairs.append(pair)
    coming = iter(pairs)
    monkeypatch.setattr(zmq, "curve_keypair", lambda: next(coming))
    assert ring.create("master") == KeyPair(*pairs[1])


def test_a_missing_key_says_how_to_make_one(ring: Keyring) -> None:
    text = f"{secret_file(ring)}: there is no key for the machine master: `telenano keys new master` creates one"
    assert refusal_of(ring.own, "master") == text
    assert ring.names() == []
    ring.create("slave")
    assert refusal_of(ring.own, "master") == text


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_a_secret_that_others_can_read_is_refused(ring: Keyring, mode: int) -> None:
    ring.create("master")
    secret_file(ring).chmod(mode)
    text = refusal_of(ring.own, "master")
    assert text == (
        f"{secret_file(ring)}: other users can read this secret key (mode {mode:o}): chmod 600 {secret_file(ring)}"
    )


def test_a_link_in_the_place_of_a_key_is_replaced_and_its_target_left_alone(ring: Keyring, tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("of somebody else")
    target.chmod(0o644)
    ring.folder.mkdir(mode=0o700)
    for name in ("master.key_secret", "master.key", "allowed.yaml"):
        (ring.folder / name).symlink_to(target)
    pair = ring.create("master", replace=True)
    (ring.folder / "allowed.yaml").unlink()
    (ring.folder / "allowed.yaml").symlink_to(tmp_path / "absent")
    ring.allow("slave", KEY, ["data"])
    assert (target.read_text(), target.stat().st_mode & 0o777) == ("of somebody else", 0o644)
    assert not (tmp_path / "absent").exists()
    assert ring.own("master") == pair
    assert sorted(path.name for path in ring.folder.iterdir()) == [
        "allowed.yaml",
        "allowed.yaml.lock",
        "master.key",
        "master.key_secret",
    ]
    assert not [path for path in ring.folder.iterdir() if path.is_symlink() or path.stat().st_mode & 0o077]


def test_a_key_that_cannot_be_put_in_place_leaves_the_old_one(ring: Keyring, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = ring.create("master")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        text = refusal_of(ring.create, "master", replace=True)
    assert text == f"{ring.folder}: cannot be written: No space left on device"
    assert ring.own("master") == pair
    assert sorted(path.name for path in ring.folder.iterdir() if path.suffix != ".lock") == [
        "master.key",
        "master.key_secret",
    ]


def test_a_pipe_in_the_place_of_a_file_is_refused_and_not_waited_for(ring: Keyring) -> None:
    ring.folder.mkdir(mode=0o700)
    for path, read in ((secret_file(ring), lambda: ring.own("master")), (ring.allowed_path, ring.allowed)):
        os.mkfifo(path, 0o600)
        assert refusal_of(read) == f"{path}: is a folder, pipe, socket or device, must be a regular file"


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_list_that_others_can_change_is_refused(ring: Keyring, mode: int) -> None:
    ring.create("master")
    ring.allow("slave", KEY, ["data"])
    ring.allowed_path.chmod(mode)
    text = f"{ring.allowed_path}: other users can change it (mode {mode:o}): chmod 600 {ring.allowed_path}"
    book = AddressBook(nodes={"afm_node@slave": "tcp://127.0.0.1:5712"})
    assert refusal_of(ring.allowed) == refusal_of(ring.allow, "laptop", OTHER, ["data"]) == text
    assert refusal_of(AccessControl, "master", ring, requires_keys=book.requires_keys) == text
    ring.allowed_path.chmod(0o644)
    assert [key.name for key in ring.allowed().keys] == ["slave"]


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_a_folder_of_keys_that_others_can_change_is_refused(ring: Keyring, mode: int) -> None:
    ring.create("master")
    ring.allow("slave", KEY, ["data"])
    ring.folder.chmod(mode)
    text = f"{ring.folder}: other users can change the files in it (mode {mode:o}): chmod 700 {ring.folder}"
    assert refusal_of(ring.own, "master") == refusal_of(ring.allowed) == text
    # and nothing is written to it
    before = sorted(ring.folder.iterdir())
    ring.allowed_path.unlink()
    assert refusal_of(ring.create, "slave") == refusal_of(ring.allow, "slave", KEY, ["data"]) == text
    assert sorted(ring.folder.iterdir()) == [path for path in before if path != ring.allowed_path]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
def test_files_of_another_user_are_not_trusted(ring: Keyring) -> None:
    ring.create("master")
    ring.allow("slave", KEY, ["data"])
    for path, read in (
        (secret_file(ring), lambda: ring.own("master")),
        (ring.allowed_path, ring.allowed),
        (ring.folder, ring.allowed),
    ):
        os.chown(path, 65534, -1)
        text = f"{path}: belongs to user 65534, who can change it: chown {os.geteuid()} {path}"
        assert refusal_of(read) == text
        os.chown(path, os.geteuid(), -1)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\xff\xfe",
        b"curve\n",
        b'    public-key = "%b"\n' % KEY.encode(),
        b'    public-key = "abc"\n    secret-key = "abc"\n',
        b'    public-key = "%b"\n    secret-key = "%b"\n' % (KEY.encode(), b"#" * 40),
        b'    public-key = "%b"\n    secret-key = "\xff%b"\n' % (KEY.encode(), b"a" * 39),
        # two halves of different pairs
        b'    public-key = "%b"\n    secret-key = "%b"\n' % (KEY.encode(), secret_key(2)),
    ],
)
def test_a_file_without_a_key_pair_is_refused(ring: Keyring, content: bytes) -> None:
    ring.create("master")
    secret_file(ring).write_bytes(content)
    text = refusal_of(ring.own, "master")
    assert text.startswith(f"{secret_file(ring)}: contains no ")
    assert text.endswith("`telenano keys new master --replace` creates one")


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    ring = Keyring(tmp_path / "file" / "keys")
    assert refusal_of(ring.create, "master") == f"{ring.folder}: cannot be written: Not a directory"
    assert refusal_of(ring.own, "master").endswith("master.key_secret: cannot be read: Not a directory")
    assert ring.names() == []


@pytest.mark.parametrize("name", ["", "Master", "1st", "a b", "a" * 33, "../master", "master\n", "ä"])
def test_a_wrong_name_is_refused(ring: Keyring, name: str) -> None:
    for text in (refusal_of(ring.create, name), refusal_of(ring.allow, name, KEY, ["data"])):
        wanted = "lower-case letters, digits and _, a letter first, 32 at most"
        assert text == f"{name!r} is not a valid machine name: {wanted}"
    assert not ring.folder.exists()


def test_the_folder_is_named_or_in_the_configuration_of_the_user(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TELENANO_KEYS_DIR", "/run/keys")
    monkeypatch.setenv("XDG_CONFIG_HOME", "/etc/me")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert keys_directory() == Keyring().folder == Path("/run/keys")
    monkeypatch.delenv("TELENANO_KEYS_DIR")
    assert keys_directory() == Path("/etc/me/telenano/keys")
    monkeypatch.delenv("XDG_CONFIG_HOME")
    assert keys_directory() == tmp_path / ".config" / "telenano" / "keys"


# --- the keys of others ---


def test_nobody_is_allowed_before_somebody_is(ring: Keyring) -> None:
    assert ring.allowed().keys == ()
    assert ring.stamp() is None


def test_a_key_is_allowed_with_its_roles(ring: Keyring) -> None:
    entry = ring.allow("slave", KEY, ["control", "data", "control"])
    assert entry == AllowedKey(name="slave", public_key=KEY, roles=("control", "data"))
    assert listed(ring) == [("slave", KEY, ("control", "data"), False)]
    assert ring.allowed().of_machine("slave") == ring.allowed().of_key(KEY) == entry
    assert ring.allowed().of_machine("master") is ring.allowed().of_key(OTHER) is None
    assert ring.allowed_path.stat().st_mode & 0o777 == 0o600


def test_roles_change_when_a_key_is_allowed_again(ring: Keyring) -> None:
    ring.allow("slave", KEY, ["data", "control"])
    ring.allow("laptop", OTHER, ["observe"])
    ring.allow("slave", KEY, ["observe"])
    assert listed(ring) == [("laptop", OTHER, ("observe",), False), ("slave", KEY, ("observe",), False)]


def test_a_machine_has_one_key_and_a_key_one_machine(ring: Keyring) -> None:
    ring.allow("slave", KEY, ["data"])
    assert refusal_of(ring.allow, "slave", OTHER, ["data"]) == (
        "slave is already listed with another key: run `telenano keys revoke slave` first"
    )
    assert refusal_of(ring.allow, "laptop", KEY, ["data"]) == f"{KEY} is already allowed, as slave"
    assert listed(ring) == [("slave", KEY, ("data",), False)]


def test_a_revoked_key_stays_so_and_a_new_one_takes_its_place(ring: Keyring) -> None:
    ring.allow("slave", KEY, ["data"])
    assert ring.revoke("slave") == AllowedKey(name="slave", public_key=KEY, roles=("data",), revoked=True)
    assert ring.allowed().of_machine("slave") is None
    assert ring.allowed().of_key(KEY).revoked
    for name in ("slave", "laptop"):
        text = refusal_of(ring.allow, name, KEY, ["data"])
        assert text == f"{KEY} was revoked permanently: create a new key on {name}"
    ring.allow("slave", OTHER, ["control"])
    assert sorted(listed(ring)) == sorted(
        [("slave", KEY, ("data",), True), ("slave", OTHER, ("control",), False)],
    )
    # the valid key is meant by the name, the old one can be named by itself, and again
    assert ring.revoke(KEY).public_key == KEY
    assert ring.allowed().of_machine("slave").public_key == OTHER
    assert ring.revoke("slave").public_key == OTHER
    assert [key.revoked for key in ring.allowed().keys] == [True, True]


def test_who_is_not_listed_cannot_be_revoked(ring: Keyring) -> None:
    assert refusal_of(ring.revoke, "slave") == (f"{ring.allowed_path}: there is no key of slave, listed keys are none")
    ring.allow("laptop", KEY, ["data"])
    ring.allow("tablet", OTHER, ["data"])
    ring.revoke("tablet")
    assert refusal_of(ring.revoke, "slave").endswith("listed keys are laptop")
    assert refusal_of(ring.revoke, "tablet").endswith("listed keys are laptop")


@pytest.mark.parametrize("key", ["", "abc", "~" * 40, "ä" * 40, "a" * 45, KEY + "\n", "#" * 40, KEY[:39] + "'"])
def test_what_is_no_key_is_refused(ring: Keyring, key: str) -> None:
    assert refusal_of(ring.allow, "slave", key, ["data"]) == (
        "key of slave: public_key: is not a public key, which has 40 characters of Z85 (`telenano keys show`), "
        f"got {key!r}"
    )
    assert not ring.allowed_path.exists()


def test_a_key_without_a_role_is_of_no_use(ring: Keyring) -> None:
    assert "roles" in refusal_of(ring.allow, "slave", KEY, [])
    assert "data', 'control', 'observe' or 'relay', got 'admin'" in refusal_of(ring.allow, "slave", KEY, ["admin"])


@pytest.mark.check("takes 1.3 s")
def test_every_key_survives_the_file(ring: Keyring) -> None:
    keys = {f"m{number}": public_key(number + 3) for number in range(50)}
    # signs that mean something to YAML, at the beginning of a key
    keys |= {f"s{ord(sign)}": f"{sign}0000{KEY[5:]}" for sign in "-:?[]{}&*!%@>=^/.0"}
    for name, key in keys.items():
        ring.allow(name, key, ["data"])
    assert {name: key for name, key, _, _ in listed(ring)} == keys


def test_the_list_is_replaced_whole_and_leaves_nothing_beside_it(
    ring: Keyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    ring.allow("slave", KEY, ["data"])
    before, stamp = ring.allowed_path.read_bytes(), ring.stamp()
    assert sorted(path.name for path in ring.folder.iterdir()) == ["allowed.yaml", "allowed.yaml.lock"]

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fail)
        with pytest.raises(RigError) as caught:
            ring.allow("laptop", OTHER, ["data"])
    assert str(caught.value) == f"{ring.allowed_path}: cannot be changed: No space left on device"
    assert ring.allowed_path.read_bytes() == before
    assert ring.stamp() == stamp
    ring.allow("laptop", OTHER, ["data"])
    assert sorted(path.name for path in ring.folder.iterdir()) == ["allowed.yaml", "allowed.yaml.lock"]
    assert ring.stamp() != stamp


@pytest.mark.parametrize(
    ("document", "text"),
    [
        ("[]", "contains a list, must contain a mapping of keys"),
        ("keys: [", "is not valid YAML"),
        ("kesy: []", "kesy: unknown key, did you mean keys? Known are keys"),
        ("keys: {}", "keys: Input should be a valid array"),
        ("keys: [{name: slave}]", "keys.0.public_key: is missing"),
        (f"keys: [{{name: slave, public_key: '{KEY}', roles: [read]}}]", "keys.0.roles.0: Input should be 'data'"),
        (f"keys: [{{name: Slave, public_key: '{KEY}', roles: [data]}}]", "keys.0.name: String should match"),
        ("keys: [{name: slave, public_key: abc, roles: [data]}]", "keys.0.public_key: is not a public key"),
        (f"keys: [{{name: slave, public_key: '{KEY}', roles: [data], revoked: 1}}]", "keys.0.revoked: "),
    ],
)
def test_a_malformed_list_names_file_and_key(ring: Keyring, document: str, text: str) -> None:
    ring.folder.mkdir()
    ring.allowed_path.write_text(document)
    assert refusal_of(ring.allowed).startswith(f"{ring.allowed_path}: {text}")
    # and is not written over
    for change in (lambda: ring.allow("x", OTHER, ["data"]), lambda: ring.revoke("slave")):
        assert str(ring.allowed_path) in refusal_of(change)
    assert ring.allowed_path.read_text() == document


@pytest.mark.parametrize(
    ("second", "what"),
    [
        ({"name": "laptop", "public_key": KEY}, f"public_key {KEY}"),
        ({"name": "laptop", "public_key": KEY, "revoked": True}, f"public_key {KEY}"),
        ({"name": "slave", "public_key": OTHER}, "name slave"),
    ],
)
def test_nothing_is_listed_twice(ring: Keyring, second: dict[str, object], what: str) -> None:
    first = {"name": "slave", "public_key": KEY, "roles": ["data"]}
    ring.folder.mkdir()
    ring.allowed_path.write_text(yaml.safe_dump({"keys": [first, {**second, "roles": ["data"]}]}))
    assert refusal_of(ring.allowed) == f"{ring.allowed_path}: keys: {what} is given twice"


def test_a_list_that_cannot_be_read_is_not_an_empty_one(ring: Keyring) -> None:
    ring.allowed_path.mkdir(parents=True)
    assert refusal_of(ring.allowed).startswith(f"{ring.allowed_path}: is a folder, ")


def test_a_list_out_of_reach_is_not_an_empty_one(ring: Keyring, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "stat", fail)
    monkeypatch.setattr(os, "open", fail)
    assert ring.stamp() == (13, 0)
    assert refusal_of(ring.allowed) == f"{ring.allowed_path}: cannot be read: Permission denied"


# --- which machine this is ---


def test_this_machine_is_named_or_the_one_whose_key_is_here(ring: Keyring, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TELENANO_MACHINE", raising=False)
    assert this_machine(ring) == "master"
    ring.create("slave")
    assert this_machine(ring) == "slave"
    ring.create("laptop")
    assert this_machine(ring) == "master"
    monkeypatch.setenv("TELENANO_MACHINE", "laptop")
    assert this_machine(ring) == "laptop"
    monkeypatch.setenv("TELENANO_MACHINE", "Laptop 1")
    assert refusal_of(this_machine, ring) == (
        "environment variable TELENANO_MACHINE is 'Laptop 1', must be a name such as master"
    )


def test_a_key_as_text() -> None:
    # the example of the specification of Z85
    assert key_text(bytes.fromhex("864FD26FB559F75B") * 4) == "HelloWorld" * 4


# --- what a process believes ---


@pytest.fixture
def access(ring: Keyring) -> AccessControl:
    ring.create("master")
    ring.allow("slave", KEY, ["data", "control"])
    return AccessControl("master", ring, requires_keys=True)


def test_verdicts_on_keys(access: AccessControl, ring: Keyring) -> None:
    own = ring.own("master").public.decode()
    assert access.public_key == own
    assert access.authorize(own) == ("master", "")
    assert access.authorize(KEY) == ("slave", "")
    assert access.authorize(OTHER) == ("", "unlisted")
    assert [access.roles(machine) for machine in ("slave", "laptop", "master")] == [
        ("data", "control"),
        (),
        ("data", "control", "observe"),
    ]
    assert [access.server_key(machine) for machine in ("slave", "laptop", "master")] == [
        KEY.encode(),
        None,
        own.encode(),
    ]


def test_the_list_is_read_again_when_it_has_changed(access: AccessControl, ring: Keyring) -> None:
    assert not access.reload()
    ring.revoke("slave")
    # nothing changes behind the back of a process
    assert access.authorize(KEY) == ("slave", "")
    assert access.reload()
    assert access.authorize(KEY) == ("slave", "revoked")
    assert (access.roles("slave"), access.server_key("slave")) == ((), None)
    ring.allow("slave", OTHER, ["observe"])
    assert access.reload()
    assert (access.authorize(OTHER), access.roles("slave")) == (("slave", ""), ("observe",))
    assert access.authorize(KEY) == ("slave", "revoked")
    assert not access.reload()


@pytest.mark.parametrize("harm", ["gone", "broken", "folder gone"])
def test_a_list_that_breaks_leaves_the_old_one_in_force_and_is_reported_once(
    access: AccessControl, ring: Keyring, harm: str
) -> None:
    good = ring.allowed_path.read_bytes()
    if harm == "broken":
        ring.allowed_path.write_text("keys: [")
    elif harm == "gone":
        ring.allowed_path.unlink()
    else:
        ring.folder.rename(ring.folder.with_name("elsewhere"))
    assert str(ring.allowed_path) in refusal_of(access.reload)
    for _ in range(3):
        assert not access.reload()
    assert access.authorize(KEY) == ("slave", "")
    ring.folder.mkdir(exist_ok=True)
    ring.allowed_path.write_bytes(good)
    assert access.reload()
    assert access.authorize(KEY) == ("slave", "")


def test_a_list_that_comes_later_is_read(ring: Keyring) -> None:
    ring.create("master")
    access = AccessControl("master", ring, requires_keys=True)
    assert not access.reload()
    assert access.authorize(KEY) == ("", "unlisted")
    ring.allow("slave", KEY, ["data"])
    assert access.reload()
    assert access.authorize(KEY) == ("slave", "")


def test_without_locks_nothing_is_read_and_everybody_may_everything(tmp_path: Path) -> None:
    access = AccessControl("master", Keyring(tmp_path / "none"), requires_keys=False)
    assert not access.reload()
    assert (access.public_key, access.own, access.server_key("slave")) == ("", None, None)
    assert access.roles("slave") == ("data", "control", "observe")


def test_a_locked_rig_needs_the_own_key_and_a_list_in_order(ring: Keyring) -> None:
    assert "`telenano keys new master` creates one" in refusal_of(AccessControl, "master", ring, requires_keys=True)
    ring.create("master")
    ring.allowed_path.write_text("keys: 1")
    assert refusal_of(AccessControl, "master", ring, requires_keys=True).startswith(f"{ring.allowed_path}: keys: ")


class Today:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.day = date(2027, 3, 1)

    def __call__(self) -> date:
        return self.day


def test_a_key_expires_at_the_end_of_its_last_day_while_a_process_runs(tmp_path: Path) -> None:
    today = Today()
    ring = Keyring(tmp_path / "keys", today)
    ring.create("master")
    ring.allow("slave", KEY, ["data", "control"], date(2027, 3, 2))
    ring.allow("desk", OTHER, ["observe"])
    access = AccessControl("master", ring, requires_keys=True)
    today.day = date(2027, 3, 2)
    assert not access.reload()
    assert (access.authorize(KEY), access.server_key("slave")) == (("slave", ""), KEY.encode())
    today.day = date(2027, 3, 3)
    # the handlers of the network act on it as on a key that was revoked
    assert access.reload()
    assert (access.authorize(KEY), access.roles("slave"), access.server_key("slave")) == (
        ("slave", "expired"),
        (),
        None,
    )
    assert "expired at the end of 2027-03-02 (UTC)" in access.why_not("slave")
    assert not access.reload()
    assert access.authorize(OTHER) == ("desk", "")
    # a list with a new last day is taken at once
    ring.allow("slave", KEY, ["data"], date(2027, 4, 1))
    assert access.reload()
    assert (access.authorize(KEY), access.roles("slave")) == (("slave", ""), ("data",))


def test_the_own_key_is_used_to_its_last_day_and_then_names_the_command(tmp_path: Path) -> None:
    today = Today()
    ring = Keyring(tmp_path / "keys", today)
    pair = ring.create("master", expires=date(2027, 3, 20))
    assert pair.expires == ring.own("master").expires == date(2027, 3, 20)
    assert ring.expiring() == []
    today.day = date(2027, 3, 6)
    assert ring.expiring() == ["the key of this machine, master, expires at the end of 2027-03-20 (UTC)"]
    today.day = date(2027, 3, 20)
    assert AccessControl("master", ring, requires_keys=True).own == pair
    today.day = date(2027, 3, 21)
    assert ring.expiring() == ["the key of this machine, master, expired at the end of 2027-03-20 (UTC)"]
    text = refusal_of(AccessControl, "master", ring, requires_keys=True)
    assert str(ring.folder / "master.key_secret") in text
    assert "`telenano keys new master --replace`" in text
    # what shows keys still can
    assert ring.own("master") == pair


def test_a_new_key_takes_the_place_of_one_that_has_expired(tmp_path: Path) -> None:
    today = Today()
    ring = Keyring(tmp_path / "keys", today)
    ring.allow("slave", KEY, ["data"], date(2027, 3, 1))
    assert "already listed with another key" in refusal_of(ring.allow, "slave", OTHER, ["data"])
    today.day = date(2027, 3, 2)
    ring.allow("slave", OTHER, ["data"])
    assert [(key.public_key, key.expires) for key in ring.allowed().keys] == [(OTHER, None)]


def test_lists_and_keys_of_before_are_read_and_written_as_before(ring: Keyring) -> None:
    ring.create("master")
    ring.allow("slave", KEY, ["data"])
    assert "expires" not in ring.allowed_path.read_text() + (ring.folder / "master.key_secret").read_text()
    assert ring.own("master").expires is None
    assert ring.expiring() == []


def test_a_day_that_is_none_names_the_file(ring: Keyring) -> None:
    ring.create("master")
    path = ring.folder / "master.key_secret"
    path.write_text(path.read_text() + '    expires = "soon"\n')
    assert f"{path}: expires" in refusal_of(ring.own, "master")
    ring.allow("slave", KEY, ["data"])
    ring.allowed_path.write_text(ring.allowed_path.read_text() + "  expires: tomorrow\n")
    assert "tomorrow is not a date such as 2027-06-30" in refusal_of(ring.allowed)


def test_a_relay_is_listed_without_a_right_to_read(access: AccessControl, ring: Keyring) -> None:
    ring.allow("relay", OTHER, ["relay"])
    assert access.reload()
    # whoever carries what is sealed cannot subscribe to it
    assert access.authorize(OTHER) == ("relay", "relay")
    ring.allow("relay", OTHER, ["relay", "observe"])
    assert access.reload()
    assert access.authorize(OTHER) == ("relay", "")
