"""Emergency stop of the devices of this machine, immediately and independent of other senders of commands.

The sender connects to the inlet that each device, the link and the recorders bind (ADR 0014), so it needs neither an
endpoint nor a lock. It imports no message models, which would take longer than everything else together. Before it
sends the stop it saves it in a file beside the inlet of each device, for a device that cannot read it now (ADR 0059).

If the file of a socket was removed, its process may still run. Devices are therefore also found by the locks that their
processes hold (`runtime/bus/holders.py`), and one whose inlet is not at its path is stopped by a signal. It binds its
inlet again within a second, where it receives the stop once more and answers it.
"""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import zmq

from telenano.runtime.bus.holders import Holder, Look, look
from telenano.runtime.bus.local_endpoint import (
    LONGEST_IPC_PATH,
    Peer,
    bound_by,
    estop_endpoint,
    kept_stop_path,
    local_endpoint,
    path_of,
)
from telenano.runtime.loop.kept_stop import keep
from telenano.timing.clock import SystemClock
from telenano.wire.errors import RigError
from telenano.wire.nodes import DEVICES, LAUNCHERS, LINK, NODES, RECORDER, TIP, is_meant, name_of, site_of
from telenano.wire.sequence import run_at

_DEADLINE_S = 5.0
_RESEND_S = 0.05
# A recorder also gets the stop, but the wait for it is shorter than for a device.
_RECORDERS_S = 1.0
_LINGER_MS = 200
_SUBSCRIBED = b"\x01session/control"
# Most subscriptions of an inlet that are read at a time.
_MOST_SUBSCRIPTIONS = 256
# The topics of commands and of their answers, as bytes.
_TOPIC = b"session/control"
_ANSWERS = b"session/event"
# Schema version of session/control.
_SCHEMA_VERSION = 1
_LINK = f"{LINK}@master"


class Answer(NamedTuple):
    """Answer of a node; `kind` is ack or refused."""

    node: str
    kind: str
    text: str


class Reach(NamedTuple):
    """Target devices by the path to them: directly to their inlet, through the link, or through a console.

    `absent` devices do not run. `unknown` devices were not found, but their process might not be visible from here.
    """

    direct: tuple[str, ...]
    by_link: tuple[str, ...]
    by_console: tuple[str, ...]
    absent: tuple[str, ...]
    unknown: tuple[str, ...] = ()


class LocalRig:
    """The ipc endpoints of a site file, and the processes that hold them."""

    def __init__(self, nodes: Mapping[str, Any], seen: Look | None = None) -> None:
        """Read the unchecked section `nodes` of a site file; `seen` are the known processes, None to look for them."""
        entries = {node: entry if isinstance(entry, dict) else {"local": entry} for node, entry in nodes.items()}
        self.nodes = frozenset(entries)
        self._networked = {node for node, entry in entries.items() if "network" in entry}
        local = {node: str(entry.get("local")) for node, entry in entries.items()}
        self.endpoints = {node: local_endpoint(text) for node, text in local.items() if text.startswith("ipc://")}
        self._given = seen
        self.seen = look() if seen is None else seen

    @classmethod
    def packaged(cls, *, two_machines: bool, seen: Look | None = None) -> "LocalRig":
        """Return the rig of the project's own site files; reading their YAML would take as long as the stop."""
        network = {"network": ""} if two_machines else {}
        entries = {row.key: {"local": f"ipc://{{runtime}}/{row.key}"} for row in NODES}
        return cls(
            {node: entry | network if site_of(node) == "slave" else entry for node, entry in entries.items()}, seen
        )

    @classmethod
    def of_holders(cls, holders: Sequence[Holder], seen: Look) -> "LocalRig":
        """Return the rig of the processes that were found, without its site file."""
        return cls({holder.node: f"ipc://{holder.path_from_here}" for holder in holders}, seen)

    @classmethod
    def read(cls, site_file: Path, seen: Look | None = None) -> "LocalRig":
        """Read a site file; an invalid one yields a rig without nodes, and its errors are reported elsewhere."""
        from telenano.files.regular_files import read_regular
        from telenano.files.yaml_text import LARGEST_BYTES, yaml_value

        try:
            return cls(yaml_value(read_regular(site_file, LARGEST_BYTES).decode())["nodes"], seen)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return cls({}, seen)

    def holders_of(self, node: str) -> list[Holder]:
        """Return the processes that hold the endpoint of a node, even if the socket is not at its path."""
        return self.seen.at(str(path_of(self.endpoints[node]))) if node in self.endpoints else []

    def inlet_of(self, node: str) -> Peer | None:
        """Return the trusted process that bound the stop inlet at a node's path; None if there is none."""
        peer = bound_by(estop_endpoint(self.endpoints[node])) if node in self.endpoints else None
        return peer if peer is not None and peer.is_trusted else None

    def has_inlet(self, node: str) -> bool:
        """Return whether a node runs here and accepts emergency stops, at its path now or within a second.

        Without an inlet, a device proves this by its signal handler, which a player that replaces it lacks. Another
        node counts as accepting if its process runs and its socket is gone, because it may bind the inlet again.
        """
        if self.inlet_of(node) is not None:
            return True
        holders = self.holders_of(node)
        if node in DEVICES:
            return any(holder.takes_signal for holder in holders)
        return bool(holders) and bound_by(self.endpoints[node]) is None

    def is_supervised(self) -> bool:
        """Return whether a launcher runs here, which restarts a device that has ended."""
        return any(self._runs(node) for node in LAUNCHERS if node in self.endpoints)

    def strangers(self) -> list[str]:
        """Return a sentence for each socket of a device that another user holds and that is therefore ignored."""
        texts = []
        for node in sorted(set(DEVICES) & set(self.endpoints)):
            for endpoint in (self.endpoints[node], estop_endpoint(self.endpoints[node])):
                peer = bound_by(endpoint)
                if peer is not None and not peer.is_trusted:
                    who = f"process {peer.process} of user {peer.user}"
                    texts.append(f"{path_of(endpoint)} is held by {who}, and not by a rig of this user: it is ignored")
        return texts

    def is_ours(self, node: str) -> bool:
        """Return whether it is possible to connect at a node's path, and no other user can answer there."""
        path = path_of(self.endpoints[node])
        if len(os.fsencode(path_of(estop_endpoint(self.endpoints[node])))) > LONGEST_IPC_PATH:
            return False
        with suppress(OSError):
            if path.parent.stat().st_uid not in (os.geteuid(), 0):
                return False
        peers = map(bound_by, (self.endpoints[node], estop_endpoint(self.endpoints[node])))
        return all(peer is None or peer.is_trusted for peer in peers)

    def signal_stop(self, devices: Sequence[str]) -> dict[str, int]:
        """Stop devices whose inlet is not at its path by a signal, and return the process id of each.

        They belong to a rig whose folder was removed, or is now used by another rig, which then owns the path.
        """
        signalled = {}
        for device in devices:
            peer = self.inlet_of(device)
            for holder in self.holders_of(device):
                if (peer is None or peer.process not in (0, holder.process)) and holder.signal_stop():
                    signalled[device] = holder.process
        return signalled

    def reach(self, target: str, site: str) -> Reach:
        """Return the path to each target device from a site, or, if `site` is empty, from both at once."""
        if self._given is None:
            # Look again, because a page uses the same object for hours.
            self.seen = look()
        has_link = site != "slave" and self.has_inlet(_LINK)
        nodes_of: dict[str, list[str]] = {way: [] for way in Reach._fields}
        for device in (device for device in DEVICES if device in self.nodes and is_meant(device, target)):
            here = site in ("", site_of(device))
            # A device with a network endpoint may run on another machine.
            only_here = device in self.endpoints and device not in self._networked
            if here and self.has_inlet(device):
                nodes_of["direct"].append(device)
            elif has_link and site_of(device) == "slave" and not (here and only_here):
                nodes_of["by_link"].append(device)
            elif here and only_here and not self._runs(device):
                nodes_of["unknown" if self.seen.blind else "absent"].append(device)
            elif here or site == "master":
                nodes_of["by_console"].append(device)
        return Reach(**{way: tuple(devices) for way, devices in nodes_of.items()})

    def _runs(self, node: str) -> bool:
        peer = bound_by(self.endpoints[node])
        return (peer is not None and peer.is_trusted) or bool(self.holders_of(node))


class _Inlet:
    """The connection to the inlet of one node."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str, *, whole: bool) -> None:
        """Connect to the inlet beside an endpoint; `whole` for a recorder, which also gets the earlier messages."""
        self.ready = False
        self._whole = whole
        self._taken = 0
        self.socket = context.socket(zmq.XPUB)
        self.socket.set(zmq.LINGER, _LINGER_MS)
        self.socket.connect(estop_endpoint(endpoint))

    def close(self) -> None:
        self.socket.close()

    def read_subscription(self, sent: int) -> bool:
        """Return whether a device or the link became ready only now, so that none of `sent` messages reached it."""
        was_ready = self.ready
        for _ in range(_MOST_SUBSCRIPTIONS):
            if not self.socket.poll(0):
                break
            self.ready = self.socket.recv() == _SUBSCRIBED or self.ready
        if was_ready or not self.ready:
            return False
        self._taken = 0 if self._whole else sent
        return not self._whole

    def send(self, messages: Sequence[bytes]) -> None:
        """Send the messages that the node has not received yet."""
        for payload in messages[self._taken :] if self.ready else ():
            self.socket.send_multipart([_TOPIC, payload])
            self._taken += 1


class _Sender:
    """Sends the stop to the inlets, as the sender of one site."""

    def __init__(self, site: str, identifier: str, target: str, inlets: Sequence[_Inlet], by: str = "") -> None:
        self._fields = {"src": f"estop@{site}", "v": _SCHEMA_VERSION, "id": identifier, "command": "estop"}
        self._fields |= {"target": target, "parameters": {}}
        if by:
            self._fields["by"] = by
        self._clock = SystemClock()
        self._run = run_at(self._clock.now_ns())
        self._messages: list[bytes] = []
        self.inlets = inlets

    def send(self, *, again: bool) -> None:
        """Send the stop to nodes that became ready only now; with `again` also to those that were ready before."""
        new = [inlet.read_subscription(len(self._messages)) for inlet in self.inlets]
        if any(new) or (again and self._messages):
            self._messages.append(self.message())
        for inlet in self.inlets:
            inlet.send(self._messages)

    def message(self) -> bytes:
        """Return the packed stop with the next sequence number and the present time."""
        header = {"seq": len(self._messages), "t_ns": self._clock.now_ns(), "run": self._run}
        packed: bytes = msgpack.packb({**header, **self._fields})
        return packed


def emergency_stop(
    rig: LocalRig, reach: Reach, target: str, on_answer: Callable[[Answer], None], by: str = ""
) -> dict[str, Answer]:
    """Stop the devices that are reached directly or through the link, and wait until all have answered.

    The stop is also saved for the devices on this machine, including those that do not run; they obey it when they can.

    Args:
        rig: The rig on this machine.
        reach: The path to each device.
        target: The target, as in a session/control.
        on_answer: Called with each answer.
        by: Name of the person who gave the command; empty if unknown.

    Returns:
        The answers by node.

    Raises:
        RigError: Devices did not answer; the message names them.
    """
    expected = {*reach.direct, *reach.by_link}
    answers: dict[str, Answer] = {}
    with ExitStack() as stack:
        context = stack.enter_context(zmq.Context[zmq.Socket[bytes]]())
        reader = stack.enter_context(closing(context.socket(zmq.SUB)))
        reader.set(zmq.LINGER, 0)
        reader.subscribe(_ANSWERS)
        signalled = rig.signal_stop(reach.direct)
        stopped_at = [node for node in _stopped_at(reach) if rig.is_ours(node)]
        for node in stopped_at:
            reader.connect(rig.endpoints[node])
        # Random and without the time, so that ids of two senders differ whatever their clocks show.
        identifier = os.urandom(12).hex()
        keep_stop(rig, reach, target, identifier)
        recorders = [node for node in rig.endpoints if name_of(node) == name_of(RECORDER) and rig.has_inlet(node)]
        senders = []
        for site in sorted({site_of(node) for node in stopped_at}):
            nodes = [node for node in stopped_at if site_of(node) == site]
            opened = [_Inlet(context, rig.endpoints[node], whole=node in recorders) for node in (*nodes, *recorders)]
            inlets = [stack.enter_context(closing(inlet)) for inlet in opened]
            senders.append(_Sender(site, identifier, target, inlets, by))
        inlets = [inlet for sender in senders for inlet in sender.inlets]
        begun_s = next_s = now_s = time.monotonic()
        while now_s - begun_s < _DEADLINE_S:
            answered, due = expected <= set(answers), now_s >= next_s
            for sender in senders:
                sender.send(again=due and not answered)
            if answered and (all(inlet.ready for inlet in inlets) or now_s - begun_s >= _RECORDERS_S):
                break
            next_s = now_s + _RESEND_S if due else next_s
            zmq.select([reader, *(inlet.socket for inlet in inlets)], [], [], max(0.0, next_s - time.monotonic()))
            # A flood of other events must not delay the repetition of the stop.
            while time.monotonic() < next_s and reader.poll(0):
                answer = _answer(reader.recv_multipart(), identifier)
                if answer is not None and answer.node not in answers:
                    answers[answer.node] = answer
                    on_answer(answer)
            now_s = time.monotonic()
    missing = sorted(expected - set(answers))
    if missing:
        # Save the stop once more, because an arming meanwhile may have removed the first copy.
        keepers = keep_stop(rig, reach, target, identifier)
        later = [
            f"{device} will stop as soon as it continues or is started again" for device in keepers if device in missing
        ]
        if _LINK in keepers and TIP in missing:
            later.append(f"the link sends it to {TIP} until that has obeyed it, and no sample of the hand before")
        text = f"{', '.join(missing)} did not answer estop within {_DEADLINE_S:g} s"
        raise RigError(
            ": ".join([text, *(["; ".join(later)] if later else [])])
            + "".join(_of_signalled(rig, node, signalled[node]) for node in missing if node in signalled)
        )
    return answers


def keep_stop(rig: LocalRig, reach: Reach, target: str, identifier: str) -> list[str]:
    """Save a stop in a file for each target device of this machine, including those that a launcher will restart.

    The folder is made again if it was removed, because a device that is being started again has no other way to learn
    of the stop: no socket of it is open yet.

    Returns:
        The devices for which it is saved. An error of writing is ignored, because the stop is sent anyway.
    """
    absent = (*reach.absent, *reach.unknown) if reach.direct or reach.by_link or rig.is_supervised() else ()
    # For a device of the other site the file is for the link, which a launcher may be about to restart.
    is_far = TIP in (*reach.by_link, *reach.by_console)
    link = (_LINK,) if is_far and _LINK in rig.endpoints and (reach.by_link or rig.is_supervised()) else ()
    devices = [device for device in (*reach.direct, *absent, *link) if rig.is_ours(device)]
    messages = {device: _Sender(site_of(device), identifier, target, ()).message() for device in devices}
    paths = {device: kept_stop_path(rig.endpoints[device]) for device in devices}
    for folder in {path.parent for path in paths.values()}:
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return [device for device, message in messages.items() if not keep(paths[device], message)]


def _of_signalled(rig: LocalRig, node: str, process: int) -> str:
    """Return a sentence on a device that was stopped by a signal and did not answer."""
    if not any(holder.process == process for holder in look().at(str(path_of(rig.endpoints[node])))):
        return f"; process {process} of {node} got the stop by a signal and has ended since"
    socket = f"its socket {path_of(rig.endpoints[node])} is not there for its answer"
    return f"; process {process} of {node} got the stop by a signal, which it obeys at once, and {socket}"


def _stopped_at(reach: Reach) -> list[str]:
    """Return the nodes to which the stop is sent."""
    return [*reach.direct, *([_LINK] if reach.by_link else [])]


def _answer(frames: list[bytes], identifier: str) -> Answer | None:
    """Return the answer in the frames of a session/event; None if it does not answer this stop."""
    try:
        fields = msgpack.unpackb(frames[-1])
        answer = Answer(str(fields["src"]), str(fields["kind"]), str(fields["text"]))
        return answer if fields["id"] == identifier and answer.kind in ("ack", "refused") else None
    except (ValueError, TypeError, KeyError, msgpack.exceptions.UnpackException):
        return None
