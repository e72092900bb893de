"""What the documents show step by step is done as it stands there: packages, keys, devices, certificates."""

import contextlib
import json
import os
import random
import re
import shlex
import shutil
import socket
import ssl
import subprocess
import sys
import time
from pathlib import Path

import msgpack
import pytest
from documented_lines import lines
from documents import (
    DOCS,
    HOWTO,
    LONGEST_S,
    PATIENCE_S,
    ROOT,
    block_of,
    environment_of,
    line_of,
    lines_of,
    place,
    run,
    shell,
    shims,
    started,
)  # fmt: skip
from stack_rig import Rig, judged
from websockets.sync.client import connect

from services.viz_node.requests import PROTOCOL
from telenano.recording.reader import Recording
from telenano.serving.serve import missing_for_view

pytestmark = [pytest.mark.stack, pytest.mark.endurance]
__all__ = ["place"]


@pytest.mark.timeout(LONGEST_S)
def test_the_demo_is_a_session_with_its_picture(rig: Rig, tmp_path: Path) -> None:
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    done = run(["make", "demo", f"OUT={tmp_path / 'fig12'}"], ROOT, environment)
    assert done.returncode == 0, done.stderr
    assert {"session.mcap", "fig12.png", "summary.json"} <= {path.name for path in (tmp_path / "fig12").iterdir()}
    # no table stands between the session and what a person reads last
    assert "│" not in done.stdout
    happened, picture, then = done.stdout.splitlines()[-3:]
    assert happened.startswith("fig12 with virtual_impedance: stable; the hand held 1.05")
    assert picture.startswith(f"picture: {tmp_path / 'fig12' / 'fig12.png'}")
    assert then.startswith("next: `.venv/bin/telenano view ")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
def test_the_units_of_systemd_are_sound(tmp_path: Path) -> None:
    for unit in sorted((ROOT / "deploy").glob("*.service")):
        program = shutil.which("true") or ""
        text = re.sub(r"^ExecStart=\S+", f"ExecStart={program}", unit.read_text(), flags=re.MULTILINE)
        # systemd looks whether the program is there
        (tmp_path / unit.name).write_text(text)
        done = run(["systemd-analyze", "verify", "--man=no", str(tmp_path / unit.name)], tmp_path)
        assert (done.returncode, done.stderr) == (0, "")


def test_old_sessions_are_removed_and_no_others(tmp_path: Path) -> None:
    (line,) = [line for line in lines() if line.text.startswith("find /var/lib/telenano/sessions")]
    for name, days in (("old", 91.5), ("new", 89.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "session.mcap").touch()
        os.utime(tmp_path / name, (time.time() - days * 86400.0,) * 2)
    done = shell(line.text.replace("/var/lib/telenano/sessions", str(tmp_path)), environment_of(), tmp_path)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


def test_the_log_of_ping_is_a_network_by_the_letter(rig: Rig, tmp_path: Path) -> None:
    draw = random.Random(1)
    said = "; ".join(
        f"echo '[17000{n:05}.5] 64 bytes from 10.0.0.1: icmp_seq={n} ttl=64 time={20 + draw.randrange(7)}.3 ms'"
        for n in range(1, 400)
    )
    environment = {**shims(tmp_path / "bin", ping=said), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    (tmp_path / "out").mkdir()
    found = [line.text for line in lines_of("docs/howto.md") if "out/ping.txt" in line.text or "out/line" in line.text]
    # the study takes minutes, and its network is tried in test_network_presets.py
    found = [text for text in found if "study advise" not in text]
    assert [text.split()[0] for text in found] == ["ping", "telenano", "telenano"]
    for text in found:
        done = shell(text + (" --duration 2.5 --json" if "telenano up" in text else ""), environment, tmp_path)
        assert done.returncode in (0, 3), done.stderr
    # the whole round trip, which is 20 to 26 ms, and not the half of it
    assert 0.018 < json.loads(done.stdout)["loop_age_ms"]["p50"] * 1e-3 < 0.08


@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl")
def test_the_certificate_of_the_page_by_the_letter(tmp_path: Path) -> None:
    make, serve = [line for line in lines_of("docs/view.md") if "view.key" in line.text]
    done = shell(make.text, environment_of(), tmp_path)
    assert done.returncode == 0, done.stderr
    command = [sys.executable, "-m", "telenano", *serve.words, "--port", "0"]
    with started(command, environment_of(), tmp_path) as process:
        assert process.stdout is not None
        file = Path([process.stdout.readline() for _ in range(2)][-1].split()[-1])
        port = int(re.findall(r"https://rig\.local:(\d+)", file.read_text())[0])
        context = ssl.create_default_context(cafile=str(tmp_path / "view.pem"))
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as line:
            context.wrap_socket(line, server_hostname="rig.local").close()


def test_the_emulated_devices_by_the_letter(rig: Rig, tmp_path: Path) -> None:
    page = lines_of("packages/telenano-devices/docs/devices.md")
    found = [line for line in page if "handle.yaml" in line.text or "stage.yaml" in line.text]
    found += [line for line in page if "probe --port" in line.text]
    link, environment = tmp_path / "port", {**environment_of(), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    # a name and a port that no other rig of this machine has
    own = {"handle": ("--link", str(link)), "t7": ("--port", port)}
    with contextlib.ExitStack() as emulators:
        for line in found:
            words = line.words
            if words[:2] == ["device", "simulate"] and words[2] in own and "--fast-path" not in words:
                command = [sys.executable, "-m", "telenano", *words, *own[words[2]]]
                # it has no end of its own, so that it tells an interruption from one
                emulators.enter_context(started(command, environment, tmp_path, 130))
        rig.wait_until(lambda: link.is_symlink() and (tmp_path / "stage.yaml").exists(), "both devices")
        ran = []
        for line in found:
            words = [word.replace("/tmp/telenano-handle", str(link)) for word in line.words]
            if words[:2] in (["device", "probe"], ["device", "monitor"]) or "haptic_node.driver=serial" in words:
                more = ["--duration", "3", "--json"] if words[0] == "up" else []
                done = run([sys.executable, "-m", "telenano", *words, *more], tmp_path, environment)
                assert done.returncode in (0, 3), (words, done.stderr)
                ran.append(" ".join(words[:2]))
    assert sorted(ran) == ["device monitor", "device probe", "device probe", "up fig12"]


@pytest.mark.skipif(bool(missing_for_view()), reason=missing_for_view() or "the page is there")
def test_the_page_of_a_recording_is_served(place: Path) -> None:
    command = [sys.executable, "-m", "telenano", *line_of(HOWTO, "view "), "--port", "0"]
    with started(command, environment_of(), place) as process:
        assert process.stdout is not None
        # the token is not written to a pipe: the second line names the file that has it
        file = Path([process.stdout.readline() for _ in range(2)][-1].split()[-1])
        address, _, token = file.read_text().split()[1].partition("#")
        bare = address.partition("//")[2].strip("/")
        with connect(f"ws://{bare}/bus", origin=f"http://{bare}") as page:  # type: ignore[arg-type]
            page.send(msgpack.packb({"k": "hello", "token": token, "protocol": PROTOCOL}))
            shown = msgpack.unpackb(page.recv(timeout=PATIENCE_S))
            # it plays
            while msgpack.unpackb(page.recv(timeout=PATIENCE_S))["k"] != "tick":
                pass
    assert shown["k"] == "snapshot"
    assert shown["source"]["kind"] == "recording"


def test_the_hand_of_a_recording_is_replayed_into_the_rig_that_the_page_names(rig: Rig, place: Path) -> None:
    (line,) = [line for line in lines_of(HOWTO) if line.words[:1] == ["replay"]]
    words, without = line.words, shlex.split(line.text.partition("started with")[2])
    assert without[0] == "--without"
    rig.start(*without, "--duration", "3")
    rig.wait_until(lambda: rig.log_has("controller@master", "ready"), "a rig that waits for its hand")
    environment = {**environment_of(), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    with started([sys.executable, "-m", "telenano", *words], environment, place):
        code, _, err = rig.finish()
    assert code in (0, 3), err
    recorded = Recording(place / words[1])
    played = Recording(rig.out / "session.mcap")
    hand = [[message.payload for message in one.messages(["haptic/state"])] for one in (recorded, played)]
    # the very bytes of the recorded hand, and a law and an instrument that are live
    assert len(hand[1]) > 1000
    assert set(hand[1]) <= set(hand[0])
    # three seconds at 250 Hz
    assert len(list(played.messages(["afm/state"]))) > 500


def test_two_sites_run_on_one_machine_as_the_page_of_deployment_says(rig: Rig, tmp_path: Path) -> None:
    environment = {**shims(tmp_path / "bin"), "HOME": str(tmp_path), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    for name in ("TELENANO_KEYS_DIR", "XDG_CONFIG_HOME", "TELENANO_HOST_MASTER", "TELENANO_HOST_SLAVE"):
        environment.pop(name, None)
    sites = {}
    for line in block_of("docs/deployment.md", "allow master ~/.config/telenano"):
        if line.words[:2] == ["up", "--site"]:
            sites[line.words[2]] = line.words
        else:
            done = shell(line.text, environment, tmp_path)
            assert done.returncode == 0, (line, done.stderr)
    assert sites.keys() == {"master", "slave"}
    command = [sys.executable, "-m", "telenano"]
    with started([*command, *sites["slave"]], environment, tmp_path):
        done = subprocess.run(
            [*command, *sites["master"], "--duration", "3", "--json"],
            env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=140,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["completeness"]["teleop/backward@master"] > 0.5
    assert summary["verdict"] != "no_data", summary["reason"]
    # each side has a recording of its own
    for site in ("master", "slave"):
        assert (tmp_path / "out" / site / "session.mcap").stat().st_size > 0


class Bench:
    """A folder with a .venv of its own, on what is installed here, as somebody has who writes a package."""

    def __init__(self, folder: Path, sockets: Path) -> None:
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / ".venv")], check=True, timeout=120)
        self.folder, commands = folder, folder / ".venv" / "bin"
        (site,) = (folder / ".venv" / "lib").glob("python*/site-packages")
        # Packages that are installed for editing have path files of their own, which `addsitedir` reads.
        found = [path for path in sys.path if "site-packages" in path]
        lines = (str(ROOT), *(f"import site; site.addsitedir({path!r})" for path in found))
        (site / "tests.pth").write_text("\n".join(lines))
        for name in ("telenano", "pip"):
            (commands / name).write_text(f'#!/bin/sh\nexec "{commands}/python" -m {name} "$@"\n')
            (commands / name).chmod(0o755)
        # no index is asked: everything that the package needs is here
        quiet = {"PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_NO_DEPS": "1", "PIP_QUIET": "1"}
        self.environment = {**os.environ, **quiet, "MPLBACKEND": "agg", "TELENANO_RUNTIME_DIR": str(sockets)}
        self.environment.pop("PYTHONPATH", None)
        self.environment["PATH"] = f"{commands}{os.pathsep}{self.environment['PATH']}"

    def type(self, line: str, more: str = "") -> str:
        """Run a line of a page, and return what it prints."""
        done = shell(f"{line.partition('#')[0].strip()} {more}", self.environment, self.folder)
        assert done.returncode == 0, (line, done.stderr)
        return done.stdout


@pytest.mark.timeout(LONGEST_S)
def test_a_law_of_ones_own_is_made_installed_and_run_by_the_letter(rig: Rig, tmp_path: Path) -> None:
    bench = Bench(tmp_path, rig.sockets)
    begins = ("telenano new law my_law", "telenano law check")
    first = [line for line in lines_of(HOWTO) if line.text.startswith(begins)]
    # the first two lines of the block are those of docs/howto.md
    block = block_of("docs/extending.md", "pip install -e telenano-my-law")[2:]
    printed = {}
    for line in (*first, *block):
        text = line.text.partition("#")[0]
        key = " ".join(text.split()[1:3])
        printed[key] = bench.type(text, "--duration 2.5 --json" if "telenano up" in text else "")
    assert json.loads(printed["up fig12"])["law"] == ["my_law"]
    assert "telenano-my-law" in printed["law list"]
    assert (tmp_path / "out" / "my_law" / "stability.html").exists()


@pytest.mark.timeout(LONGEST_S)
def test_the_law_of_the_tutorial_by_the_letter(rig: Rig, tmp_path: Path) -> None:
    bench = Bench(tmp_path, rig.sockets)
    made, edited = (
        block_of("docs/tutorial.md", part) for part in ("telenano new law my_law", "telenano law check my_law")
    )
    for line in made:
        bench.type(line.text)
    law = tmp_path / "telenano-my-law" / "telenano_my_law" / "__init__.py"
    there, instead = re.findall(r"^```py\n(.*?)^```", (DOCS / "tutorial.md").read_text(), re.DOTALL | re.MULTILINE)
    assert law.read_text().count(there) == 1
    law.write_text(law.read_text().replace(there, instead))
    printed = {line.words[0]: bench.type(line.text, "--json" if line.words[0] != "law" else "") for line in edited}
    summary = json.loads(printed["up"])
    is_struck = any(fact["kind"] == "struck" for hold in summary["holds"] for fact in hold["facts"])
    rests = summary["verdict"] == "stable" and is_struck
    assert rests or not judged(summary, "the law of the tutorial"), summary["reason"]
    found = json.loads(printed["study"])["critical_delay_ms"]
    (stated,) = re.findall(
        r"stable up to ([0-9]+[.][0-9]) ms instead of ([0-9]+[.][0-9])", (DOCS / "tutorial.md").read_text()
    )
    assert tuple(f"{found[law]['20']:.1f}" for law in ("my_law", "position_force")) == stated
