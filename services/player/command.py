"""`telenano replay`: play recordings on the bus instead of some nodes, while the rest of the rig is live."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from services.player.node import PlayerNode, PlaySettings
from services.player.playback import Span
from services.player.run import ReplayRequest, run_replay
from telenano.cli.keyboard import RawKeyboard
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import (
    EndOption,
    ExcludeOption,
    JsonOption,
    SameSessionOption,
    SiteFileOption,
    StartOption,
    TopicsOption,
)
from telenano.cli.output import print_answer, report_errors, say
from telenano.recording.recorded_time import START
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.wire.errors import TelenanoError

_RATE_STEP = 1.25
_KEYS_TEXT = "space pause · . step · e next event · ← → 1 s · + - rate · a b loop points · l loop · q end"


class PlayerKeyBindings:
    """Maps keys to actions of a player, and shows its status line."""

    def __init__(self, keys: RawKeyboard) -> None:
        self._keys = keys
        self._note = ""

    def __call__(self, player: PlayerNode) -> None:
        for key in self._keys.pressed():
            try:
                self._note = self._press(player, key)
            except TelenanoError as error:
                self._note = str(error)
        self._keys.show(player.status() + (f" · {self._note}" if self._note else ""))

    def _press(self, player: PlayerNode, key: str) -> str:
        playback, rate = player.playback, player.playback_clock.rate
        actions: dict[str, Callable[[], Any]] = {
            "space": lambda: player.pause(not player.playback_clock.paused),
            ".": player.step,
            "e": player.seek_event,
            "right": lambda: player.seek(playback.time_s + 1.0),
            "left": lambda: player.seek(playback.time_s - 1.0),
            "+": lambda: player.set_rate(rate * _RATE_STEP),
            "-": lambda: player.set_rate(rate / _RATE_STEP),
            "a": lambda: playback.limit(start_ns=playback.position_ns),
            "b": lambda: playback.limit(end_ns=playback.position_ns + 1),
            "l": lambda: setattr(playback, "loop", not playback.loop),
            "q": player.end,
        }
        if key not in actions:
            return _KEYS_TEXT
        actions[key]()
        return ""


@rules(Void("--duration", "which says where to end", beside="--end"))
def replay(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Recordings (.mcap), the parts of one.")],
    nodes: Annotated[
        list[str] | None,
        typer.Option(
            "--nodes", metavar="NODE", help="Play the messages of this node (repeatable); default: of all nodes."
        ),
    ] = None,
    topics: TopicsOption = None,
    exclude: ExcludeOption = None,
    rate: Annotated[
        float, typer.Option("--rate", min=0.0, help="1 as recorded, 0 as fast as the slowest reader keeps up.")
    ] = 1.0,
    start: StartOption = None,
    end: EndOption = None,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="Duration from --start to the end [s].")
    ] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at --start when --end is reached.")] = False,
    paused: Annotated[
        bool, typer.Option("--paused", help="Wait for the space bar or a command before starting.")
    ] = False,
    wait: Annotated[
        float, typer.Option("--wait", min=0.0, metavar="S", help="Longest wait until all topics have a reader [s].")
    ] = 1.0,
    same_session: SameSessionOption = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Play a recording instead of nodes that do not run; only node/health shows that it is a replay.

    Keys: space pause, . step, e next event, arrows 1 s back and on, + and - rate, a and b the ends of a loop, l loop on
    and off, q end. The same by `telenano session set player.KEY=VALUE --target player`.
    """
    with report_errors(as_json):
        begin = start or START
        until = end if duration is None else begin.later(duration)
        request = ReplayRequest(
            files,
            site_file,
            nodes or (),
            topics or (),
            exclude or (),
            Span(begin, until, loop),
            PlaySettings(rate, paused, wait),
            same_session,
        )
        with RawKeyboard() as keys:
            done = run_replay(request, PlayerKeyBindings(keys), _warn)
        document = {"nodes": done.nodes, "messages": done.sent, "time_s": done.time_s, "warnings": done.warnings}
        text = f"played {done.sent} messages of {', '.join(done.nodes)} up to {done.time_s:.3f} s"
        print_answer(document, text, as_json=as_json)


def _warn(text: str) -> None:
    say(f"warning: {text}")
