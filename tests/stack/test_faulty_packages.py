"""Code of packages that fails in a running rig: tip and hand are safe, and somebody says whose code it was."""

import itertools
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from ledger import record
from stack_rig import ROOT, Rig

from telenano.cli.new_package import new_package
from telenano.recording.multi_file import open_recordings
from telenano.testing import describe_package

pytestmark = pytest.mark.stack

# after three seconds of the loop, once: the process that comes after it goes on
_FAULT = """
import os, sys, time
from pathlib import Path
_calls = 0
def fault():
    global _calls
    _calls += 1
    mark = Path(os.environ["FAULT_MARK"])
    if _calls != 3000 or mark.exists():
        return 0.0
    mark.touch()
    {what}
    return 0.0
"""
FAULTS = {
    "raises": 'raise ZeroDivisionError("the fault")',
    "exits": "sys.exit(0)",
    "exits at once": "os._exit(0)",
    "gives no number": 'return float("nan")',
    "never returns": "while True: pass",
    "blocks": "time.sleep(4.0)",
}
# kind: name, what is changed in its template, and what chooses it
PLACES = {
    "law": ("faulty_law", "received = p.force_scale * signal.force_n", "controller.law=faulty_law"),
    "operator": ("faulty_hand", "force = params.force_n * min(t / params.rise_s, 1.0)",
                 "haptic_node.operator={kind: faulty_hand}"),
    "sample": ("faulty_gel", "depth = inputs.base_m - params.rest_distance_m", "afm_node.environment=faulty_gel"),
    "device": ("faulty_handle", "time.monotonic() - self._sampled_s",
               "haptic_node.driver=faulty_handle"),
}  # fmt: skip


# Where what hangs holds the device of its site as well, one case is in `make check`.
CHECKED = ("site", "law", "never returns")
CASES = [
    pytest.param(*case, marks=() if case == CHECKED else pytest.mark.endurance)
    for case in itertools.product(("node", "site"), sorted(PLACES), sorted(FAULTS))
]


def install(folder: Path, kind: str, what: str) -> str:
    """Put a package with a fault where Python finds it; return the setting that chooses it."""
    name, line, setting = PLACES[kind]
    new_package(kind, name, folder / "source")
    site, module = folder / "site", f"telenano_{name}"
    shutil.copytree(folder / "source" / module, site / module)
    source = (site / module / "__init__.py").read_text()
    assert line in source
    source = source.replace(line, f"{line} + fault()").replace(
        "from telenano.", f"from {module}.fault import fault\nfrom telenano.", 1
    )
    (site / module / "__init__.py").write_text(source)
    (site / module / "fault.py").write_text(_FAULT.format(what=what))
    describe_package(site, module, {f"{kind}s": {name: f"{module}:{name.upper()}"}}, "0.1.0")
    return setting


@pytest.mark.parametrize(("processes", "kind", "fault"), CASES, indirect=["processes"])
def test_code_of_a_package_that_fails_leaves_hand_and_tip_safe(rig: Rig, kind: str, fault: str) -> None:
    setting = install(rig.folder, kind, FAULTS[fault])
    rig.environment |= {
        "PYTHONPATH": os.pathsep.join((str(rig.folder / "site"), str(ROOT))),
        "FAULT_MARK": str(rig.folder / "mark"),
        "XDG_CACHE_HOME": str(rig.folder / "cache"),
    }
    # the fault comes in the 3000th call
    rig.start("--duration", "8", "--set", setting, rate=())
    code, _, err = rig.finish()
    assert (rig.folder / "mark").exists(), rig.logs()
    assert code in (0, 1, 3), err + rig.logs()
    failed = {"law": "controller@master", "sample": "afm_node@slave"}.get(kind, "haptic_node@master")
    recording = open_recordings(sorted(rig.out.glob("session*.mcap")))
    events = [message.fields() for message in recording.messages(["session/event"])]
    said = [event["text"] for event in events]
    # What waits takes no processor, and is left alone where it is in a process of its own, as a real device always is.
    is_ended = fault != "blocks" or (rig.processes == "site" and kind != "device")
    assert is_ended == any(text.startswith(f"{failed} ") and "it is started again" in text for text in said), said
    if fault in ("raises", "exits"):
        assert any(text.startswith(f"the package telenano_{PLACES[kind][0]} 0.1.0 failed (") for text in said), said
    hand, tip = (modes_of(recording, topic) for topic in ("haptic/state", "afm/state"))
    assert "position" in hand and "off" in hand[hand.index("position") :], hand
    assert kind == "sample" or hand[-1] == "off", hand
    # it was withdrawn, and waits to be armed
    assert "follow" in tip and tip[-1] == "retracted", tip
    if (kind, fault) == ("law", "never returns"):
        way = " in a process of several" if rig.processes == "site" else ""
        text = f"hand off {let_go_s(recording):.1f} s after the last coupled sample"
        record(f"a law of a package never returns{way}", text)


def let_go_s(recording: Any) -> float:
    """Return the time from the last state of the hand that was coupled to the first that was not [s]."""
    found = [(message.publish_ns, message.fields()["mode"]) for message in recording.messages(["haptic/state"])]
    last = max(number for number, (_, mode) in enumerate(found) if mode == "position")
    return (found[last + 1][0] - found[last][0]) * 1e-9


def modes_of(recording: Any, topic: str) -> list[str]:
    """Return the modes of a device in the order in which it had them."""
    modes: list[str] = []
    for message in recording.messages([topic]):
        mode = message.fields()["mode"]
        if not modes or modes[-1] != mode:
            modes.append(mode)
    return modes
