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
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import msgpack
import zmq

from telenano.console.answers import Answer
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
from telenano.wire.nodes import DEVICES, HAND, LAUNCHERS, LINK, NODES, RECORDER, TIP, is_meant, name_of, site_of
from telenano.wire.sequence import run_at

_DEADLINE_S = 5.0
_RESEND_S = 0.05
# Time after which the answers of the other site are listened for, even if a device of this one is silent.
_NEAR_S = 1.0
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


# Nodes whose processes show that their site is on this machine; both endpoints of the link belong to the master's.
_OF_A_SITE = frozenset(row.key for row in NODES if row.part in ("rig", "launcher"))


class Reach(NamedTuple):
    """Ways to the target devices; each device that the site file has and the target means is in exactly one of them.

    `direct` devices take the stop at their own inlet here; `by_link` the link carries it to the instrument;
    `by_instrument` the instrument's answer carries it over the link to the hand; `by_console` only a console may reach
    them. `absent` devices belong to this machine and do not run. `unknown` devices were not found, but their process
    might not be visible from here. No way leads to `far` devices: nothing of their site, and no link, is here.
    """

    direct: tuple[str, ...] = ()
    by_link: tuple[str, ...] = ()
    by_instrument: tuple[str, ...] = ()
    by_console: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    far: tuple[str, ...] = ()

    @property
    def asked(self) -> tuple[str, ...]:
        """All target devices."""
        return tuple(device for way in self for device in way)

    @property
    def is_sent(self) -> bool:
        """Whether the stop is sent to a socket here."""
        return bool(self.direct or self.by_link)


class FarListener(Protocol):
    """Hears answers of devices at the other site, which come over the network."""

    def sockets(self) -> Sequence[Any]:
        """Return the sockets to wait for."""

    def answers(self, identifier: str) -> Iterator[Answer]:
        """Yield the answers to a stop that have arrived."""


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
        """Return the rig of the processes that were found in one folder, without its site file.

        It has both devices: one that does not run would have its socket in the same folder.
        """
        devices = {device: f"ipc://{holders[0].folder / device}" for device in DEVICES if holders}
        return cls({**devices, **{holder.node: f"ipc://{holder.path_from_here}" for holder in holders}}, seen)

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

    def state_of(self, node: str) -> Literal["runs", "absent", "unknown"]:
        """Return whether a node runs on this machine, is known not to, or may run elsewhere."""
        if node in self.endpoints and self._runs(node):
            return "runs"
        is_here = node in self.endpoints and node not in self._networked and self._is_home(site_of(node))
        return "absent" if is_here and not self.seen.blind else "unknown"

    @property
    def has_launcher_of_link(self) -> bool:
        """Whether a launcher that restarts the link runs here."""
        return self._has_launcher(site_of(_LINK))

    def is_at_home(self, device: str) -> bool:
        """Return whether other nodes of a device's site run on this machine."""
        return self._is_home(site_of(device))

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
        """Return the way to each target device, for a person at a site or, if `site` is empty, at an unknown one."""
        if self._given is None:
            # Look again, because a page uses the same object for hours.
            self.seen = look()
        ways: dict[str, list[str]] = {way: [] for way in Reach._fields}
        homes = {of for of in ("master", "slave") if self._is_home(of)}
        for device in (device for device in DEVICES if device in self.nodes and is_meant(device, target)):
            ways[self._way_to(device, target, site, homes)].append(device)
        return Reach(**{way: tuple(devices) for way, devices in ways.items()})

    def _way_to(self, device: str, target: str, site: str, homes: set[str]) -> str:
        """Return the way to a device, as a field of `Reach`; `homes` are the sites that run on this machine."""
        if self.has_inlet(device):
            return "direct"
        if device in self.endpoints and self._runs(device):
            # A node of an older version, or a program in its place.
            return "by_console"
        if device == TIP and self.has_inlet(_LINK):
            return "by_link"
        # A device with a network endpoint may be on another machine than the other nodes of its site.
        may_be_far = device in self._networked or device not in self.endpoints
        if site_of(device) in homes and (not may_be_far or self._has_launcher(site_of(device))):
            return "unknown" if self.seen.blind else "absent"
        # An instrument that obeys the stop carries it, also one that a launcher is about to start again.
        tip_obeys = self.has_inlet(TIP) or (site_of(TIP) in homes and self.is_supervised())
        if device == HAND and TIP in self.nodes and is_meant(TIP, target) and tip_obeys:
            return "by_instrument"
        if may_be_far or (device == TIP and site == "master"):
            return "by_console"
        # Nothing of its site is here. That says nothing about the device if the other site is, or if it is meant to be.
        if homes or site == ("slave" if device == HAND else "master"):
            return "far"
        return "unknown" if self.seen.blind else "absent"

    def _is_home(self, site: str) -> bool:
        """Return whether processes of a site run on this machine."""
        return any(self._runs(node) for node in self.endpoints if site_of(node) == site and node in _OF_A_SITE)

    def _has_launcher(self, site: str) -> bool:
        launcher = f"{name_of(LAUNCHERS[0])}@{site}"
        return launcher in self.endpoints and self._runs(launcher)

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
    rig: LocalRig,
    reach: Reach,
    target: str,
    on_answer: Callable[[Answer], None],
    by: str = "",
    listen: Callable[[], AbstractContextManager[FarListener]] | None = None,
) -> dict[str, Answer]:
    """Stop the devices that are reached from here, wait until all have answered, and return what became of each.

    The stop is also saved for the devices on this machine, including those that do not run; they obey it when they can.
    One that a launcher starts again is waited for like the others.

    Args:
        rig: The rig on this machine.
        reach: The way to each device.
        target: The target, as in a session/control.
        on_answer: Called with each answer of a device, at once.
        by: Name of the person who gave the command; empty if unknown.
        listen: Opens a listener for answers from the other site. It is opened once the devices here have answered,
            because that takes time.

    Returns:
        A row for each device of `reach`, by node.
    """
    awaited = {*reach.direct, *reach.by_link, *(reach.absent if rig.is_supervised() else ())}
    answers: dict[str, Answer] = {}
    # Random and without the time, so that ids of two senders differ whatever their clocks show.
    identifier = os.urandom(12).hex()
    signalled: dict[str, int] = {}
    if awaited:
        far = frozenset(reach.by_instrument if listen is not None else ())
        with ExitStack() as stack:
            signalled = _send(
                rig, reach, _Wanted(target, identifier, by, awaited, far), answers, on_answer, listen, stack
            )
    # Once more for those that have not answered, because an arming meanwhile may have removed the first copy.
    keepers = keep_stop(rig, reach, target, identifier, set(answers)) if set(reach.asked) - set(answers) else []
    for device in reach.asked:
        if device not in answers:
            answers[device] = _unanswered(rig, reach, device, keepers, signalled)
    return answers


class _Wanted(NamedTuple):
    """A stop to send: target, id, name of its giver, the devices here that have to answer, and those beyond them."""

    target: str
    identifier: str
    by: str
    near: set[str]
    far: frozenset[str]


def _send(
    rig: LocalRig,
    reach: Reach,
    wanted: _Wanted,
    answers: dict[str, Answer],
    on_answer: Callable[[Answer], None],
    listen: Callable[[], AbstractContextManager[FarListener]] | None,
    stack: ExitStack,
) -> dict[str, int]:
    """Send a stop until the awaited devices have answered; return the processes that were stopped by a signal."""
    context = stack.enter_context(zmq.Context[zmq.Socket[bytes]]())
    reader = stack.enter_context(closing(context.socket(zmq.SUB)))
    reader.set(zmq.LINGER, 0)
    reader.subscribe(_ANSWERS)
    signalled = rig.signal_stop(reach.direct)
    stopped_at = [node for node in _stopped_at(reach, wanted.near) if rig.is_ours(node)]
    for node in stopped_at:
        reader.connect(rig.endpoints[node])
    keep_stop(rig, reach, wanted.target, wanted.identifier)
    recorders = [node for node in rig.endpoints if name_of(node) == name_of(RECORDER) and rig.has_inlet(node)]
    senders = []
    for site in sorted({site_of(node) for node in stopped_at}):
        nodes = [node for node in stopped_at if site_of(node) == site]
        opened = [_Inlet(context, rig.endpoints[node], whole=node in recorders) for node in (*nodes, *recorders)]
        inlets = [stack.enter_context(closing(inlet)) for inlet in opened]
        senders.append(_Sender(site, wanted.identifier, wanted.target, inlets, wanted.by))
    inlets = [inlet for sender in senders for inlet in sender.inlets]
    listener: FarListener | None = None

    def note(answer: Answer | None) -> None:
        if answer is not None and answer.node in reach.asked and answer.node not in answers:
            answers[answer.node] = answer
            on_answer(answer)

    begun_s = next_s = now_s = time.monotonic()
    while now_s - begun_s < _DEADLINE_S:
        near, due = wanted.near <= set(answers), now_s >= next_s
        answered = near and wanted.far <= set(answers)
        for sender in senders:
            sender.send(again=due and not answered)
        if answered and (all(inlet.ready for inlet in inlets) or now_s - begun_s >= _RECORDERS_S):
            break
        next_s = now_s + _RESEND_S if due else next_s
        if listener is None and listen is not None and wanted.far and (near or now_s - begun_s >= _NEAR_S):
            listener = stack.enter_context(listen())
        sockets = [reader, *(inlet.socket for inlet in inlets), *(() if listener is None else listener.sockets())]
        zmq.select(sockets, [], [], max(0.0, next_s - time.monotonic()))
        # A flood of other events must not delay the repetition of the stop.
        while time.monotonic() < next_s and reader.poll(0):
            note(_answer(reader.recv_multipart(), wanted.identifier))
        for answer in () if listener is None else listener.answers(wanted.identifier):
            note(answer)
        now_s = time.monotonic()
    return signalled


def _unanswered(
    rig: LocalRig, reach: Reach, device: str, keepers: Sequence[str], signalled: Mapping[str, int]
) -> Answer:
    """Return what became of a stop at a device that has not answered."""
    silent = f"did not answer estop within {_DEADLINE_S:g} s"
    if device in reach.by_link:
        if _LINK not in keepers:
            return Answer(device, "unreached", f"{silent}, and the link cannot keep the stop")
        later = f"the link sends it to {device} until that has obeyed it, and no sample of the hand before"
        return Answer(device, "kept", f"{silent}: {later}")
    if device in reach.direct:
        by_signal = _of_signalled(rig, device, signalled[device]) if device in signalled else ""
        if device in keepers:
            return Answer(
                device, "kept", f"{silent}: it will stop as soon as it continues or is started again{by_signal}"
            )
        return Answer(device, "unreached", f"{silent}, and the stop cannot be kept for it{by_signal}")
    if device in reach.by_instrument:
        text = (
            "runs at the other site, to which the stop goes by the instrument and the link: no answer came from there"
        )
        return Answer(device, "unreached", text)
    if device in reach.far:
        return Answer(device, "unreached", "belongs to the other site, and no way leads there from this machine")
    if device in reach.by_console:
        return Answer(device, "unreached", "takes no stop from this machine but that of a console")
    if device in reach.unknown:
        return Answer(device, "unreached", f"was not found, and whether it runs is not known here: {rig.seen.blind}")
    if device in keepers:
        return Answer(device, "kept", "is not running: the stop is kept, and it will start in emergency stop")
    return Answer(device, "absent", "is not running")


def keep_stop(rig: LocalRig, reach: Reach, target: str, identifier: str, answered: Collection[str] = ()) -> list[str]:
    """Save a stop in a file for each target device of this machine, including those that a launcher will restart.

    The folder is made again if it was removed, because a device that is being started again has no other way to learn
    of the stop: no socket of it is open yet.

    Args:
        rig: The rig on this machine.
        reach: The way to each device.
        target: The target, as in a session/control.
        identifier: The id of the stop.
        answered: Devices that have obeyed the stop, and for which it is not saved.

    Returns:
        The devices for which it is saved. An error of writing is ignored, because the stop is sent anyway.
    """
    absent = (*reach.absent, *reach.unknown) if reach.is_sent or rig.is_supervised() else ()
    # For a device of the other site the file is for the link, which a launcher may be about to restart.
    is_far = TIP in (*reach.by_link, *reach.by_console, *reach.far)
    link = (_LINK,) if is_far and _LINK in rig.endpoints and (reach.by_link or rig.has_launcher_of_link) else ()
    # An instrument of this machine that is being started again finds it before the link reaches it.
    started = tuple(device for device in reach.by_link if rig.is_at_home(device))
    keepers = [node for node in (*reach.direct, *absent, *started, *link) if node not in answered]
    devices = [node for node in keepers if rig.is_ours(node)]
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


def _stopped_at(reach: Reach, awaited: Collection[str]) -> list[str]:
    """Return the nodes to which the stop is sent: the awaited devices, and the link if it carries the stop."""
    return [
        *(node for node in reach.asked if node in awaited and node not in reach.by_link),
        *([_LINK] if reach.by_link else []),
    ]


def _answer(frames: list[bytes], identifier: str) -> Answer | None:
    """Return the answer in the frames of a session/event; None if it does not answer this stop."""
    try:
        fields = msgpack.unpackb(frames[-1])
        answer = Answer(str(fields["src"]), str(fields["kind"]), str(fields["text"]))
        return answer if fields["id"] == identifier and answer.kind in ("ack", "refused") else None
    except (ValueError, TypeError, KeyError, msgpack.exceptions.UnpackException):
        return None
