"""When hand and tip are not coupled, and what is said then."""

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from services.viz_node import commander as commander_module
from services.viz_node.requests import COMMANDS
from telenano.cli.commands import session as session_command
from telenano.cli.root import app
from telenano.console.coupling import couple
from telenano.runtime.loop.commands import Command
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import example
from telenano.wire.errors import RigError

HAND: dict[str, Any] = {
    "position_m": (0.0, 0.0, 0.0), "velocity_m_per_s": (0.0, 0.0, 0.0), "operator_force_n": (0.0, 0.0, 0.0),
    "motor_force_n": (0.0, 0.0, 0.0), "reference_m": (0.0, 0.0, 0.0), "mode": "position", "estop": False,
    "limited": False, "session_s": 1.0, "step_s": 1e-3, "device": "ok", "sample_age_s": 0.0,
    "armed": True,
}  # fmt: skip
TIP: dict[str, Any] = {
    "law": "passivity", "active": True, "position_m": (0.0, 0.0, 66e-9), "velocity_m_per_s": (0.0, 0.0, 0.0),
    "force_n": (0.0, 0.0, 0.0), "wave_sqrt_w": None, "energy_j": None, "separation_m": 0.0, "separation_valid": False,
    "in_contact": False,
}  # fmt: skip


class Told:
    """A rig that says what it is told to say; the tip obeys `stop` and `arm` where it `obeys`."""

    def __init__(self, **changes: Any) -> None:
        self.hand, self.tip = dict(HAND), dict(TIP)
        self.obeys, self.moves_m, self.answers = True, 0.0, {"stop": "the tip retracts", "arm": "armed"}
        for name, value in changes.items():
            place = next((part for part in (self.hand, self.tip) if name in part), None)
            if place is None:
                setattr(self, name, value)
            else:
                place[name] = value
        self.sent: list[str] = []
        self._t_ns = 10**9

    def look(self, duration_s: float) -> Iterator[Any]:
        for _ in range(4):
            self._t_ns += round(duration_s * 0.25e9)
            x, y, z = self.hand["position_m"]
            self.hand["position_m"] = (x, y, z + self.moves_m)
            for topic, source, fields in (
                ("haptic/state", "haptic_node@master", self.hand),
                ("teleop/backward", "controller@slave", self.tip),
            ):
                yield example(topic, t_ns=self._t_ns, src=source, **fields)

    def send(self, command: Command, retry_s: float = 0.0) -> str:
        self.sent.append(command.name)
        answer = self.answers[command.name]
        if isinstance(answer, Exception):
            raise answer
        if self.obeys:
            self.tip["active"] = command.name == "arm"
        return answer


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "emergency stop": ({"estop": True}, "a device is in emergency stop"),
    "hand that was never armed": ({"armed": False}, "the hand is not armed"),
    "lost device": ({"device": "lost"}, "the device of the hand is lost or refused"),
    "hand without force": ({"mode": "off"}, "the hand does not follow"),
    "contact": ({"in_contact": True}, "the tip touches the sample"),
    "pressing": ({"operator_force_n": (0.0, 0.0, -0.6)}, "the hand presses with 0.60 N"),
    "pulling": ({"operator_force_n": (0.0, 0.0, 0.6)}, "the hand presses with 0.60 N"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusal_says_why_and_moves_nothing(case: str) -> None:
    changes, text = REFUSED[case]
    rig = Told(**changes)
    with pytest.raises(RigError, match=f"nothing has moved: {text}"):
        couple(rig)
    assert rig.sent == []


# what goes wrong on the way, what was sent by then, and what is said
STUCK: dict[str, tuple[dict[str, Any], list[str], str]] = {
    "stop of the tip alone": (
        {"active": False, "answers": {"stop": "the tip is in emergency stop already"}},
        ["stop"],
        "the tip is in emergency stop already, which `telenano session arm` releases",
    ),
    "program": ({"obeys": False}, ["stop"], "s for the tip to be withdrawn"),
    "hand that moves": ({"moves_m": 2e-3}, ["stop"], "s for a hand at rest; the tip stays withdrawn"),
    "stop meanwhile": (
        {"answers": {"stop": "the tip retracts", "arm": RigError("arm is void: an emergency stop came")}},
        ["stop", "arm"],
        "arm is void: an emergency stop came; the tip stays withdrawn until it is armed",
    ),
}


@pytest.mark.parametrize("case", STUCK)
def test_what_cannot_be_completed_leaves_the_tip_withdrawn_and_says_so(case: str) -> None:
    changes, sent, text = STUCK[case]
    rig = Told(**changes)
    with pytest.raises(RigError, match=text):
        couple(rig)
    assert rig.sent == sent


@pytest.mark.parametrize("changes", [{}, {"active": False, "mode": "off"}], ids=["following", "withdrawn"])
def test_tip_is_withdrawn_and_armed_again(changes: dict[str, Any]) -> None:
    rig = Told(**changes)
    follow: Callable[..., str] = rig.send

    def send(command: Command, retry_s: float = 0.0) -> str:
        answer = follow(command, retry_s)
        rig.hand["mode"] = "position" if command.name == "arm" else "off"
        return answer

    rig.send = send  # type: ignore[method-assign]
    assert couple(rig) == ("hand and tip are coupled again: the tip went from -66.0 to -66.0 nm, for a hand at 0.00 mm")
    assert rig.sent == ["stop", "arm"]


def test_silent_rig_is_named() -> None:
    rig = Told()
    rig.look = lambda duration_s: iter(())  # type: ignore[method-assign]
    with pytest.raises(RigError, match="s for states of hand and tip: is `telenano up` running"):
        couple(rig)


def test_states_of_the_instrument_tell_where_the_base_is_and_that_it_is_stopped() -> None:
    rig = Told()
    state = example("afm/state", t_ns=2, src="afm_node@slave", mode="estop", base_position_m=(0.0, 0.0, 1e-9))
    follow = rig.look
    rig.look = lambda duration_s: iter([*follow(duration_s), state])  # type: ignore[method-assign]
    with pytest.raises(RigError, match="nothing has moved: a device is in emergency stop"):
        couple(rig)


def test_command_and_page_end_at_the_same_function(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: list[Path] = []

    def recouple(site_file: Path, *rest: Any, **options: Any) -> str:
        given.append(site_file)
        if len(given) > 2:
            raise RigError("not coupled, and nothing has moved: the hand presses with 1.00 N")
        return "hand and tip are coupled again"

    for module in (session_command, commander_module):
        monkeypatch.setattr(module, "recouple", recouple)
    file = tmp_path / "site.yaml"
    file.write_bytes(DEFAULT_SITE_FILE.read_bytes())
    run = partial(CliRunner().invoke, app)
    done = run(["session", "couple", "--site-file", str(file)])
    assert (done.exit_code, done.output) == (0, "hand and tip are coupled again\n")
    commander = commander_module.RigCommander(DEFAULT_SITE_FILE)
    answers = commander.send("couple", "*", {}, lambda: True, 0, "")
    assert answers == {"afm_node@slave": ("ack", "hand and tip are coupled again")}
    assert "couple" in COMMANDS
    refused = run(["session", "couple", "--json"])
    assert refused.exit_code == 1
    assert json.loads(refused.stdout) == {"error": "not coupled, and nothing has moved: the hand presses with 1.00 N"}
    assert given == [file, DEFAULT_SITE_FILE, DEFAULT_SITE_FILE]
    for wrong in (["a=1"], ["--target", "afm_node"], ["--site", "slave"]):
        assert "not with couple, which is for both" in run(["session", "couple", *wrong]).output
