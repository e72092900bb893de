"""The wheel with no extra, and with some: each command works, or says what to add. No network is asked for anything."""

import re
import shutil
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from installations import ROOT, SETTINGS, Installation, built, closure, wheel_of

# A study compiles first, which a busy machine lets wait.
pytestmark = [pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(1800)]


@pytest.fixture(
    scope="module",
    params=[(), ("haptic",), ("launcher",), ("launcher", "export"), ("studies", "instrument")],
    ids="+".join,
)
def installed(
    request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Installation]:
    installation = Installation(tmp_path_factory.mktemp("installation"), wheel, request.param)
    yield installation
    shutil.rmtree(installation.folder)


def test_the_same_source_gives_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    assert built(tmp_path).read_bytes() == wheel.read_bytes()


def test_the_packages_of_the_project_add_their_commands_and_formats_to_the_wheel(wheel: Path, tmp_path: Path) -> None:
    installation = Installation(tmp_path, wheel, ())
    bare = installation.telenano("bridge", "lsl").stderr
    assert "the command 'lsl' is in the package telenano-bridges: pip install 'telenano_bridges-" in bare
    folders = sorted(path.parent for path in ROOT.glob("packages/*/pyproject.toml"))
    made = [wheel_of(folder, tmp_path / folder.name) for folder in folders]
    # the hint names the file that is made here
    assert made[folders.index(ROOT / "packages" / "telenano-bridges")].name in bare
    for one in made:
        installation.add(one)
    listed = installation.telenano("--version").stdout.split()[1::2]
    assert listed == sorted(folder.name for folder in folders)
    said = installation.telenano("bridge", "--help").stdout
    assert all(name in said for name in ("foxglove", "lsl", "ros2"))
    # pylsl is not there, and the doctor says so
    assert "pylsl" in installation.telenano("doctor").stdout


# a command of every group that needs neither a rig nor a device, and the extras with which it works
VERBS = {
    "--version": "base",
    "--help": "base",
    "up --duration 1 --scenario no_such_scenario": "",
    "scenario list": "base",
    "scenario show fig12": "base",
    "param list controller": "base",
    "law list": "base",
    "law show wave": "base",
    "bag info REFERENCE": "base",
    "bag verify REFERENCE": "base",
    "bag export REFERENCE --to csv --out csv": "",
    "bag export REFERENCE --to parquet --out parquet": "",
    "bag export REFERENCE --to hdf5 --out h5": "",
    "bag export REFERENCE --to nexus --out s.nxs": "",
    "bag export REFERENCE --to mcap-json --out json.mcap": "base",
    "bag export REFERENCE --to ros2 --out ros2.mcap": "",
    "bag plot REFERENCE afm/state.tip_force_n.2 --out plot.png": "launcher studies",
    "report REFERENCE --out report": "launcher studies",
    "compare REFERENCE --paper --out compare": "launcher studies",
    "study transparency --law wave --delay 0 --out study": "",
    "curve --out curve": "",
    "sample --sample dots --out dots": "instrument",
    "scan --pixels 8 --lines 8 --out scan": "",
    "view REFERENCE --port 0": "",
    "bridge foxglove --duration 1": "",
    "bridge lsl --duration 1": "",
    "device list": "studies haptic",
    "keys show": "base",
    "new law my_law": "base",
    "doctor": "",
    "topic list": "",
    "status": "",
    "record --duration 1 --out record": "",
    "session arm": "",
    "estop": "",
}


def test_every_command_works_or_says_what_to_add(
    installed: Installation, request: pytest.FixtureRequest, recording_of: Callable[[str], Path]
) -> None:
    reference = str(recording_of("wave"))
    extras = request.node.callspec.params["installed"]
    wrong = {}
    for line, works_with in VERBS.items():
        done = installed.telenano(*(reference if word == "REFERENCE" else word for word in line.split()))
        says = re.search(r"pip install ('[^']+\[[a-z0-9,]+\]'|telenano_\w+-[0-9.]+-py3-none-any\.whl)", done.stderr)
        works = done.returncode in (0, 3)
        promised = {"base", *extras} & set(works_with.split())
        # without a rig, a device or a known scenario the last ones fail whatever is installed
        explained = bool(says) or not works_with
        if "Traceback" in done.stderr or not (works or (explained and not promised)):
            wrong[line] = (done.returncode, done.stderr[-600:])
    assert not wrong


LIBRARY = """
import sys, telenano
import telenano.wire.errors as telenano_errors
session = telenano.open(sys.argv[1])
print(len(session.table("afm/state")["time_s"]), session.summary["hold_ratio"], telenano.simulate("fig12").verdict)
assert "matplotlib" not in sys.modules
try:
    print(session.df("afm/state").shape)
except telenano_errors.ConfigError as error:
    print(error)
"""


def test_the_library_reads_a_recording_and_simulates_without_any_extra(
    installed: Installation, recording_of: Callable[[str], Path]
) -> None:
    done = installed.run(str(installed.python), "-c", LIBRARY, str(recording_of("wave")))
    assert done.returncode == 0, done.stderr
    read, frame = done.stdout.splitlines()
    assert int(read.split()[0]) > 100
    assert read.split()[-1] == "stable"
    assert frame.startswith("(") or re.search(r"pandas is not installed: pip install '[^']+\[export\]'", frame)


# what each extra is for, done with that extra alone: a command, or a program
ALONE = {
    "haptic": "device list",
    "afm": "-c import telenano.devices.afm.modbus_driver",
    "recorder": "-c import services.recorder.__main__",
    "instrument": "sample --sample dots --out dots",
    "export": "-c import pandas, xarray, telenano; telenano.simulate(law='wave').df('afm/state')",
    "viz": "bag plot REFERENCE afm/state.tip_force_n.2 --out plot.png",
    "view": "-c import services.viz_node.server",
    "launcher": "report REFERENCE --out report",
    "studies": "-c import control, scipy, telenano; telenano.simulate(law='wave')",
    "rig": "sample --sample dots --out dots",
    "dask": "-c import dask.distributed",
    "peers": "-c import zenoh, iceoryx2",
    "notebooks": "-c import ipykernel, nbconvert, telenano; telenano.simulate('fig12').df('afm/state')",
    "site": "-c import mkdocstrings, zensical",
    # all that the tests need: the environment in which they run
    "dev": "",
}


def test_each_extra_has_what_it_is_for() -> None:
    assert set(ALONE) == set(SETTINGS["project"]["optional-dependencies"])


@pytest.mark.parametrize("extra", [extra for extra, line in ALONE.items() if line])
def test_an_extra_alone_does_what_it_is_for(
    extra: str, wheel: Path, tmp_path: Path, recording_of: Callable[[str], Path]
) -> None:
    try:
        closure((extra,))
    except PackageNotFoundError as error:
        pytest.skip(f"{error} of the extra {extra} is not in the environment of the tests")
    installation = Installation(tmp_path, wheel, (extra,))
    first, _, program = ALONE[extra].partition(" ")
    if first == "-c":
        done = installation.run(str(installation.python), "-c", program)
    else:
        reference = str(recording_of("wave"))
        done = installation.telenano(*(reference if word == "REFERENCE" else word for word in ALONE[extra].split()))
    assert done.returncode == 0, done.stderr


def test_a_study_runs_with_its_extra_and_its_package_which_the_wheel_names(wheel: Path, tmp_path: Path) -> None:
    installation = Installation(tmp_path, wheel, ("studies",))
    study = ("study", "transparency", "--law", "wave", "--delay", "0", "--out", "study")
    assert "is in the package telenano-lab: pip install telenano_lab-" in installation.telenano(*study).stderr
    for name in ("telenano-lab", "telenano-laws", "telenano-devices"):
        installation.add(wheel_of(ROOT / "packages" / name, tmp_path / name))
    done = installation.telenano(*study)
    assert done.returncode == 0, done.stderr


def test_the_driver_of_the_inverse3_is_in_its_package_which_the_wheel_names(wheel: Path, tmp_path: Path) -> None:
    installation = Installation(tmp_path, wheel, ())
    probe = ("device", "probe", "--device", "haply")
    probed, simulated = installation.telenano(*probe), installation.telenano("device", "simulate", "haply")
    hint = "is in the package telenano-devices: pip install telenano_devices-"
    assert f"the command 'probe' {hint}" in probed.stderr
    assert f"the command 'simulate haply' {hint}" in simulated.stderr
    installation.add(wheel_of(ROOT / "packages" / "telenano-devices", tmp_path / "package"))
    nowhere = "haptic_node.haply.service=ws://127.0.0.1:1"
    probed = installation.telenano(*probe, "--set", nowhere)
    simulated = installation.telenano("device", "simulate", "haply", "--host", "no.such.host.invalid")
    for done in (probed, simulated):
        assert done.returncode not in (0, 3)
        assert "Traceback" not in done.stderr
    # what the package depends on is not there
    assert "the Haply Inverse3 needs websockets: pip install 'websockets>=15'" in probed.stderr
    assert "the emulated Inverse Service needs websockets: pip install 'websockets>=15'" in simulated.stderr
