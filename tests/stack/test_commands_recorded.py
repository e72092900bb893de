"""Commands of consoles that come and go, each in a process or a socket of its own: the recording has every one.

The same with recorders that miss messages, and with answers of earlier versions, is drawn in
`tests/unit/recording/test_answered_commands.py`.
"""

import random
import time
from collections.abc import Collection

import pytest
from stack_rig import Rig

from telenano.console.send_commands import send_control
from telenano.recording.answered_commands import AnsweredCommands
from telenano.runtime.loop.commands import Command
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire.codec import fields_of
from telenano.wire.errors import TelenanoError
from telenano.wire.messages import SessionEvent


def a_command(draw: random.Random, number: int) -> Command:
    """Draw a command that leaves the rig as it is; some are refused."""
    return draw.choice(
        (
            lambda: Command("mark", "recorder", parameters={"note": f"command {number}"}),
            lambda: Command("set", "controller", parameters={"law": "virtual_impedance"}),
            lambda: Command("set", "controller@slave", parameters={"law": "no_such_law"}),
            lambda: Command("set", "delay_node", parameters={"forward.delay_s": 0.0}),
            lambda: Command("set", "afm_node", parameters={"program": "abort"}),
            lambda: Command("start", "afm_node", parameters={}),
        )
    )()


def given_to(rig: Rig, seed: int, count: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, Command]:
    """Give commands, each from a console that binds, waits for its answers and leaves; return them by id."""
    draw, given = random.Random(seed), {}
    for name in ("TELENANO_RUNTIME_DIR", "TELENANO_RIG"):
        monkeypatch.setenv(name, rig.environment.get(name, ""))
    for number in range(count):
        command = a_command(draw, number)
        answers: list[SessionEvent] = []
        try:
            send_control(command, DEFAULT_SITE_FILE, "master", answers.append, by="Ada")
        except TelenanoError:
            # A machine that stands still may answer later than a console waits.
            continue
        given |= {event.id: command for event in answers}
    return given


def recorded(rig: Rig, since_ns: int, ids: Collection[str]) -> AnsweredCommands:
    """Return what the recording has so far of the commands with these ids, and of their answers."""
    commands = AnsweredCommands()
    for topic in ("session/control", "session/event"):
        for message in rig.recording().messages(topic, since_ns):
            fields = fields_of(message.decode())
            if fields["id"] in ids:
                commands.add(topic, fields)
    return commands


@pytest.mark.parametrize(
    "count",
    [
        pytest.param(60, marks=pytest.mark.check("sixty consoles at a rig")),
        pytest.param(2000, marks=[pytest.mark.endurance, pytest.mark.timeout(1800)]),
    ],
)
def test_no_command_of_consoles_that_come_and_go_is_left_unsaid(
    shared_rig: Rig, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, since_ns = shared_rig, time.time_ns()
    given = given_to(rig, count, count, monkeypatch)
    assert len(given) > 0.9 * count
    rig.wait_until(lambda: recorded(rig, since_ns, given).answered == len(given), "the answers in the recording")
    assert recorded(rig, since_ns, given).missing() == ()
