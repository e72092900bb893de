"""Recordings for tests: of a session of both sites in virtual time, made once for all tests that read it."""

import fcntl
import json
from collections.abc import Callable, Sequence
from pathlib import Path


def record_fig12(
    folder: Path,
    law: str = "virtual_impedance",
    settings: Sequence[str] = (),
    *,
    delay_s: float = 0.004,
    seed: int = 1,
    programme_s: float = 1.1,
    duration_s: float = 2.0,
) -> Path:
    """Record the beginning of Fig. 12 in virtual time: real nodes of both sites, the link and the recorder.

    Args:
        folder: The folder of the recording, which is made.
        law: The law.
        settings: What else of the scenario is changed, as `--set` takes it.
        delay_s: The delay of the link in either direction [s].
        seed: The seed of all delays on the sites.
        programme_s: After how long the programme of the hand ends [s]; the whole takes 8 s.
        duration_s: How long the nodes run, of which 0.3 s lie before the programme [s].

    Returns:
        The path of the recording.
    """
    from telenano.settings import find_scenario, read_yaml
    from telenano.virtual import record_session

    scenario = read_yaml(find_scenario("fig12")) | {"duration_s": programme_s}
    link = json.dumps({"delay_s": delay_s})
    ways = [f"delay_node.{way}={link}" for way in ("forward", "backward")]
    folder.mkdir(parents=True, exist_ok=True)
    return record_session(folder, seed, [f"controller.law={law}", *ways, *settings], duration_s, scenario)


def recording_with(folder: Path, name: str, make: Callable[[Path], Path]) -> Path:
    """Return a recording that is made when it is first asked for, by whichever process of a test run comes first.

    Args:
        folder: The folder of all recordings of the run.
        name: The name of its own folder.
        make: Makes the recording in the folder that it is given.
    """
    path = folder / name / "session.mcap"
    folder.mkdir(exist_ok=True)
    with (folder / f"{name}.lock").open("w") as lock:
        # another worker may be making it
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            made = folder / f"{name}.made"
            make(made)
            made.rename(path.parent)
    return path
