"""Filter for the page of a participant: only the data listed here are sent to it, and nothing else on the bus.

A participant must not know the condition of a trial, and the developer tools of a browser show everything that it
received. So the server lists what may pass rather than what may not: a new topic, key or column is not passed on. The
picture, which is the tip and the image, can be delayed. It is delayed here, because a browser that is told a delay
knows a part of the condition.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from telenano_lab.experiments.experiment_file import LONGEST_PICTURE_DELAY_S
from telenano_lab.experiments.messages import CUE as CUE_TOPIC
from telenano_lab.experiments.messages import TRIAL as TRIAL_TOPIC

CUE = CUE_TOPIC.name
TRIAL = TRIAL_TOPIC.name
# Keys of messages for pages. A cue contains nothing of the condition; the trial is for experimenters.
CUE_KEYS = (
    "id", "stage", "title", "text", "remaining_s", "done", "total", "practice", "labels",
    "quantity", "band", "times_s", "target", "questions", "answered",
)  # fmt: skip
TRIAL_KEYS = (
    "participant",
    "session",
    "block",
    "index",
    "trials",
    "attempt",
    "phase",
    "task",
    "condition",
    "state",
    "text",
    "picture_delay_s",
)
# Data for the hand are never delayed: the spring of the page acts on them.
_HAND = {"hand": ("position", "force", "x", "y"), "command": ("tip_force",)}
_PICTURE = {"tip": ("base", "deflection", "force", "force_x", "force_y", "x", "y", "separation")}
# State of the instrument that the page of a participant receives.
_AFM = "afm/state/slave"
# Keys of that state that it receives.
_AFM_KEYS = ("in_contact", "meniscus")
# Greatest number of delayed pictures, ten seconds at thirty a second; the oldest are dropped.
_MOST_HELD = 300
_ACKNOWLEDGEMENTS = {True: "done", False: "not carried out: tell the experimenter"}

Changes = Mapping[str, Any]


class ParticipantPicture:
    """Converts the data for all pages into those for participants, with the picture delayed by `delay_s` [s]."""

    def __init__(self, streams: Sequence[Mapping[str, Any]]) -> None:
        """Begin with the streams that pages have: name, topic and columns of each."""
        self.delay_s = 0.0
        self._streams_of_pages = streams
        self._columns = _places(streams)
        self._held: deque[tuple[float, dict[str, Any]]] = deque(maxlen=_MOST_HELD)
        self._contact: dict[str, Any] = {}

    def take(self, changes: Changes, now_s: float) -> list[dict[str, Any]]:
        """Return the changes to send to participants now, each for a frame.

        Args:
            changes: Changes for the pages of operators; empty if there are none.
            now_s: Time on a monotonic clock [s].
        """
        state = changes.get("state", {})
        if TRIAL in state:
            self.delay_s = min(float(state[TRIAL]["picture_delay_s"]), LONGEST_PICTURE_DELAY_S)
        taken: list[dict[str, Any]] = []
        now: dict[str, Any] = {key: changes[key] for key in ("origin_ns",) if key in changes}
        if CUE in state:
            now["state"] = {CUE: state[CUE]}
        if streams := self._streams(changes, _HAND):
            now["streams"] = streams
        if now:
            taken.append(now)
        picture: dict[str, Any] = {}
        if streams := self._streams(changes, _PICTURE):
            picture["streams"] = streams
        if _AFM in state and (contact := {key: state[_AFM].get(key) for key in _AFM_KEYS}) != self._contact:
            self._contact = contact
            picture["state"] = {_AFM: contact}
        if lines := changes.get("lines"):
            picture["lines"] = lines
        if picture:
            self._held.append((now_s, picture))
        while self._held and now_s - self._held[0][0] >= self.delay_s:
            taken_s, picture = self._held.popleft()
            taken.append(_shown_at(picture, now_s - taken_s if self.delay_s > 0.0 else 0.0))
        return taken

    def snapshot(self, snapshot: Changes, *, hand: bool) -> dict[str, Any]:
        """Return the initial data of a participant's page, from those of an operator's."""
        state = snapshot.get("state", {})
        return {
            "k": "snapshot",
            "role": "participant",
            "commands": False,
            "hand": hand,
            "streams": [
                {
                    "name": each["name"],
                    "topic": "",
                    "columns": [each["columns"][i] for i in self._columns[each["name"]]],
                }
                for each in self._streams_of_pages
                if each["name"] in self._columns
            ],
            "forms": {},
            "source": {"kind": "live", "name": ""},
            "origin_ns": snapshot.get("origin_ns", 0),
            "state": {CUE: state[CUE]} if CUE in state else {},
            "nodes": {},
            "events": [],
            # An image from before the trial need not be delayed.
            "lines": snapshot.get("lines", []),
        }

    def acknowledgement(self, *, is_ok: bool) -> str:
        """Return a neutral answer to a request: the answer of a node may name the law."""
        return _ACKNOWLEDGEMENTS[is_ok]

    def _streams(self, changes: Changes, wanted: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
        streams = changes.get("streams", {})
        return {name: _of_columns(streams[name], self._columns[name]) for name in wanted if name in streams}


def _places(streams: Sequence[Mapping[str, Any]]) -> dict[str, list[int]]:
    """Return the indices of the permitted columns, by stream."""
    places = {}
    for stream in streams:
        if wanted := (_HAND | _PICTURE).get(stream["name"]):
            names = [column["name"] for column in stream["columns"]]
            places[stream["name"]] = [names.index(name) for name in wanted]
    return places


def _of_columns(stream: Mapping[str, Any], places: list[int]) -> dict[str, Any]:
    rows = np.frombuffer(stream["data"], "<f4").reshape(-1, stream["n"])
    kept = rows[[0, *(place + 1 for place in places)]]
    return {"n": stream["n"], "t0": stream["t0"], "data": kept.tobytes()}


def _shown_at(picture: dict[str, Any], late_s: float) -> dict[str, Any]:
    """Return a picture stamped with its display time: the times of its samples would reveal the delay."""
    streams = picture.get("streams", {})
    shown = {name: {**stream, "t0": stream["t0"] + late_s} for name, stream in streams.items()}
    return {**picture, "streams": shown} if shown else picture
