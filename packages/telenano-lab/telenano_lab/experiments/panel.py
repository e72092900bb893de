"""The panels of an experiment: the experimenter's on the page of a rig, the participant's page, and their answers."""

import asyncio
import time
from pathlib import Path

from telenano.serving import Asked, Panel
from telenano.wire import RefusedError
from telenano_lab.experiments.messages import ANSWER
from telenano_lab.experiments.participant import CUE, CUE_KEYS, TRIAL, TRIAL_KEYS, ParticipantPicture

# An answer is repeated at this interval until the experiment has taken it [s].
_ANSWER_EVERY_S = 0.2
# An answer is given up after this time [s].
_ANSWER_DEADLINE_S = 5.0
# Polling interval of the experiment's cue [s].
_LOOK_S = 1.0 / 30.0
_LONGEST_SHOWN_S = 1e6
# Prefix of answered questions in a request, which also has cue and shown_s.
_ANSWER_PREFIX = "answer."


class AnswerDesk:
    """Publishes an answer until a cue of the experiment confirms it."""

    def __init__(self) -> None:
        self._answering: set[str] = set()

    async def ask(self, asked: Asked) -> str:
        """Send an answer; RefusedError if no experiment takes it.

        A page can have only one answer under way, because each is repeated; a participant must answer the current cue.
        """
        if asked.page in self._answering:
            raise RefusedError("the answer before this one has not been taken yet: wait for it")
        rig, cue, shown_s = asked.rig, asked.values.get("cue"), asked.values.get("shown_s")
        if not isinstance(cue, str) or not isinstance(shown_s, int | float) or isinstance(shown_s, bool):
            raise RefusedError(
                "an answer needs cue, the id of the cue, and shown_s, the time for which it was shown [s]"
            )
        values = {
            name.removeprefix(_ANSWER_PREFIX): value
            for name, value in asked.values.items()
            if name.startswith(_ANSWER_PREFIX)
        }
        is_own = asked.role == "participant"
        given_ns, end_s = rig.now_ns(), time.monotonic() + _ANSWER_DEADLINE_S
        self._answering.add(asked.page)
        try:
            while time.monotonic() < end_s:
                if is_own and cue != rig.state(CUE).get("id"):
                    raise RefusedError(f"cue {cue} is no longer shown: answer the one that is")
                rig.publish(
                    ANSWER.name,
                    id=asked.id,
                    cue=cue,
                    role="participant" if is_own else "experimenter",
                    values=values,
                    given_ns=given_ns,
                    shown_s=min(max(0.0, float(shown_s)), _LONGEST_SHOWN_S),
                )
                for _ in range(round(_ANSWER_EVERY_S / _LOOK_S)):
                    await asyncio.sleep(_LOOK_S)
                    if asked.id in rig.state(CUE).get("answered", ()):
                        return "taken"
        finally:
            self._answering.discard(asked.page)
        raise RefusedError("no experiment received the answer: check that one is running")


PANEL = Panel(
    "experiment",
    "Experiment",
    "watch",
    Path(__file__).with_name("web") / "panel.js",
    topics={CUE: CUE_KEYS, TRIAL: TRIAL_KEYS},
    shows=CUE,
    desk=AnswerDesk,
    guest_page="participant.html",
    guest_picture=ParticipantPicture,
)
