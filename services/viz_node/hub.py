"""The hub of the open pages: it sends them the changes thirty times a second, and no page can block another."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Collection, Mapping
from functools import partial
from string import ascii_uppercase
from typing import Any

import msgpack

from services.viz_node.age_report import AgeReport
from services.viz_node.command_desk import Answers, CommandDesk, Commander, PageCommand
from services.viz_node.document import Document
from services.viz_node.feed import Feed
from services.viz_node.lease_desk import LeaseDesk, OwnRegister
from services.viz_node.metrics import MetricsText, metrics_text
from services.viz_node.page_hand import HAND_FRESH_S, TICK_S, HandOutlet, PageHand
from services.viz_node.page_session import REQUESTS_PER_S, Session
from services.viz_node.page_threads import in_thread
from services.viz_node.read_desk import ReadDesk
from services.viz_node.recording_files import RecordingFiles
from services.viz_node.requests import (
    CommandRequest,
    DocumentRequest,
    EstopRequest,
    HandRequest,
    HereRequest,
    LeaseRequest,
    PanelRequest,
    PartRequest,
    RecordingRequest,
    Request,
    TransportRequest,
)
from services.viz_node.source import AGE_TOPICS, Source
from services.viz_node.streams import described
from telenano.console.answers import MEANINGS
from telenano.console.lease import Party
from telenano.console.lease_register import LeaseRegister
from telenano.recording.messages import LeftOut
from telenano.serving.access import Role
from telenano.serving.panels import Asked, Picture, installed_panels
from telenano.serving.people import Person
from telenano.wire.errors import RefusedError, TelenanoError
from telenano.wire.nodes import TIP

# Period while no page is open, when only the state for later pages is collected [s].
IDLE_S = 0.25
# Period of the reports to a page whose hand is too slow [s].
_SLOW_REPORT_PERIOD_S = 0.5
# Longest time between two frames to a page [s].
_BEAT_S = 0.2
# Greatest size of the values of one request to a panel [bytes]: sixteen choices of 128 letters and their names.
_MOST_ASKED_BYTES = 4096
# A page that answers later than this was suspended, so the time is not used [s].
_LONGEST_WAY_S = 5.0
# Most open pages by role: each role has places that no other takes, so that pages which only look keep no operator out.
MOST_PAGES = {Role.OBSERVER: 24, Role.OPERATOR: 6, Role.PARTICIPANT: 2}
# Time in which a page that is told to end must have read so [s].
_END_S = 2.0
REVOKED = "this address was revoked, or has expired: ask for another where the rig runs"


class _PanelRig:
    """The access of a panel's desk to the rig."""

    def __init__(self, outlet: HandOutlet, state: Callable[[str], Mapping[str, Any]]) -> None:
        self.publish, self.now_ns, self.state = outlet.publish, outlet.now_ns, state


class Hub:
    """Reads the source, informs the pages, and carries out their requests as far as their role permits."""

    def __init__(
        self,
        source: Source,
        commander: Commander | None = None,
        forms: Callable[[], Mapping[str, Any]] | None = None,
        open_hand: Callable[[], HandOutlet] | None = None,
        document: Document | None = None,
        register: LeaseRegister | None = None,
        recording: RecordingFiles | None = None,
    ) -> None:
        """Prepare to serve a source.

        Args:
            source: A running rig or a recording.
            commander: Sends commands to the rig; None if there is nothing to command.
            forms: Returns the JSON schemas of the settings, by node, which may take a second.
            open_hand: Opens the outlet for the page's force to the haptic node; None if there is none.
            document: The recording for pages to read; None for a running rig.
            register: The lease that the rig's processes share; None if these pages share it with no other process.
            recording: The files of the recording for operators to download; None if there are none here.
        """
        self.desk = LeaseDesk(register or OwnRegister())
        # Returns whether the address of a person is still valid.
        self.is_admitted: Callable[[Person], bool] = lambda person: True
        self.sessions: set[Session] = set()
        # The error that ended the hub, and the function that is called then.
        self.fault: BaseException | None = None
        self.on_end: Callable[[], None] = lambda: None
        self.on_tick: Callable[[], None] = lambda: None
        # Called with the new holder of control, None if it is free.
        self.on_lease: Callable[[Party | None], None] = lambda party: None
        self._source = source
        self.commands = CommandDesk(commander)
        self._make_forms = forms
        self._forms: Mapping[str, Any] = {}
        self.hand = PageHand(open_hand)
        self._reads = ReadDesk(document)
        self.recording = recording or RecordingFiles()
        # Times of the last transmission of changes to the pages, and to those of participants [s].
        self._sent_s = self._sent_to_guests_s = 0.0
        self._feed = Feed()
        self._withdrawing: asyncio.Task[None] | None = None
        self._about: Mapping[str, Any] = {}
        self.panels = installed_panels()
        self._desks = {row.id: row.desk() for row in self.panels.rows if row.desk is not None}
        guests = self.panels.of_guests
        self._guests_panel = "" if guests is None else guests.id
        make_picture = None if guests is None else guests.guest_picture
        self._picture: Picture = _NoPicture() if make_picture is None else make_picture(described())
        self.age = AgeReport()
        self._metrics = MetricsText()

    async def run(self) -> None:
        """Send the changes to the pages, until cancelled."""
        making = asyncio.create_task(self._prepare_forms())
        due_s = time.monotonic()
        try:
            while True:
                self.tick()
                period_s = TICK_S if self.sessions else IDLE_S
                due_s = max(due_s + period_s, time.monotonic())
                await asyncio.sleep(due_s - time.monotonic())
        finally:
            making.cancel()
            self.hand.close()

    def note_end(self, task: "asyncio.Task[None]") -> None:
        """Store the error that ended `run`, and end the server, because its pages would show old data."""
        self.fault = None if task.cancelled() else task.exception()
        if self.fault is not None:
            self.on_end()

    def close(self) -> None:
        """Wait for the emergency stops under way, and close the source."""
        self.commands.close()
        self._source.close()

    async def _prepare_forms(self) -> None:
        """Make the forms in a thread, and send them to the pages that have opened meanwhile."""
        if self._make_forms is None:
            return
        self._forms = await asyncio.wrap_future(in_thread(self._make_forms))
        for session in self._recipients():
            session.answer(_packed({"k": "forms", "forms": self._forms}))

    def tick(self) -> None:
        """Collect new messages, and queue the changes for every page."""
        self.on_tick()
        self.commands.note_alive(time.monotonic())
        restarted = self._source.take_restart()
        if restarted:
            self._feed = Feed()
        self._collect()
        for session in self.sessions if restarted else ():
            session.restart(self.snapshot(session))
        changes = self._feed.take()
        changes |= self._take_age()
        if (lease := self._look_at_lease()) is not None:
            changes["lease"] = lease
        about = self._source.about()
        if about != self._about:
            self._about = about
            changes["source"] = about
        self._hold()
        now_s = time.monotonic()
        # A page that gets nothing for longer than this knows that its line is silent, and not the rig.
        guests = self.sessions - self._recipients()
        pictures = list(self._picture.take(changes, now_s))
        for picture in pictures or ([{}] if now_s - self._sent_to_guests_s >= _BEAT_S else []):
            self._sent_to_guests_s = now_s
            self._offer({"at_s": now_s, **picture}, guests)
        if changes or now_s - self._sent_s >= _BEAT_S:
            self._sent_s = now_s
            self._offer({"at_s": now_s, **changes}, self._recipients())

    def _collect(self) -> None:
        """Record what the source has received."""
        for seen in self._source.poll(watched=bool(self.sessions)):
            self._feed.record(seen)
            if seen.topic in AGE_TOPICS and self.commands.commander is not None:
                self._feed.left_out.guard(self.age.record, seen)

    def _take_age(self) -> dict[str, Any]:
        """Once a second, return the parts of the loop's age for the pages, and send each page its round trip."""
        now_s = time.monotonic()
        if not self.age.take(now_s, is_watched=bool(self.sessions)):
            return {}
        for session in self._recipients():
            way_s = sorted(session.ways_s)[len(session.ways_s) // 2] if session.ways_s else None
            session.answer(_packed({"k": "way", "stamp_s": now_s, "way_s": way_s}))
        parts = self.age.parts
        return {"age": [[part.name, part.p50_s, part.p99_s] for part in parts]} if parts else {}

    def _look_at_lease(self) -> Mapping[str, Any] | None:
        """Return the facts on the lease for pages, or None if unchanged; release the hand of a page that lost control.

        The waiting commands of other pages are then cancelled. A page whose address was revoked is told so and ended.
        If a holder vanished while it pressed, the tip is withdrawn.
        """
        for session in [each for each in self.sessions if each.person and not self.is_admitted(each.person)]:
            self.desk.refused.note("revoked", f"{session.party.label}: the address was revoked, or has expired")
            self._dismiss(session, REVOKED)
        changes = self.desk.tick(self.sessions, time.monotonic())
        if changes is not None and self.hand.holder is not None and not self.desk.may_press(self.hand.holder):
            self.hand.holder.answer(_packed({"k": "hand", "held": False, "text": f"Let go: {self._who_has_it()}"}))
            self.hand.release()
        holder = self.desk.lease.holder
        if changes is not None:
            self.on_lease(holder)
        if changes is not None and holder is not None:
            self.commands.make_void(
                self._who_has_it(), lambda wish: wish.session.party.id != holder.id and wish.needs_lease
            )
        is_free = self._withdrawing is None or self._withdrawing.done()
        commander = self.commands.commander
        if self.desk.lease.withdraw and commander is not None and is_free:
            with contextlib.suppress(RuntimeError):
                self._withdrawing = asyncio.get_running_loop().create_task(self._withdraw(commander))
        return changes

    async def _withdraw(self, commander: Commander) -> None:
        """Withdraw the tip after its holder has vanished, as after a lost hand, unless another party has control."""
        number, lost = self.desk.lease.number, self.desk.lease.lost
        why = {"because": "who held control vanished while it pressed" if lost is None else lost.text}
        send = partial(commander.send, "stop", TIP, why, self.desk.is_to_withdraw, time.monotonic_ns(), "")
        with contextlib.suppress(TelenanoError):
            await asyncio.wrap_future(in_thread(send))
            self.desk.note_withdrawn(number)

    def _who_has_it(self) -> str:
        holder = self.desk.lease.holder
        return f"{holder.label} holds control now" if holder else "control is free now"

    def _recipients(self) -> set[Session]:
        """Return the pages that get all data: all except those of participants."""
        return {session for session in self.sessions if session.role is not Role.PARTICIPANT}

    def _offer(self, changes: Mapping[str, Any], sessions: Collection[Session]) -> None:
        frame = _packed({"k": "tick", **changes}) if sessions else b""
        for session in sessions:
            if not session.offer(frame):
                session.restart(self.snapshot(session))

    def join(self, role: Role, person: Person | None = None) -> Session:
        """Return the session of a new page, with a snapshot in its queue."""
        session = Session(role, person, self._free_window() if role is Role.OPERATOR and person is None else "")
        # Send pending changes to the open pages first; the snapshot contains them.
        self.tick()
        self.sessions.add(session)
        session.offer(self.snapshot(session))
        if role is Role.PARTICIPANT:
            # Open the outlet now: messages published before readers have connected are lost.
            with contextlib.suppress(TelenanoError):
                self.hand.outlet()
        return session

    def make_room(self, role: Role) -> str:
        """Make room for a page of a role; return a sentence if there is none.

        At the limit the page of that role which has done nothing for longest goes, unless it holds control or presses.
        """
        most, pages = MOST_PAGES[role], [each for each in self.sessions if each.role is role]
        if len(pages) < most:
            return ""
        idle = [each for each in pages if not self.desk.has(each) and each is not self.hand.holder]
        if not idle:
            return f"{len(pages)} pages of this kind are open, which is the most allowed"
        longest = min(idle, key=lambda each: each.acted_s)
        self.desk.refused.note("room", f"{longest.party.label}: closed, because {most} pages of this kind were open")
        self._dismiss(longest, f"this page made room for another one: {most} of its kind were open; load it again")
        return ""

    def _dismiss(self, session: Session, text: str) -> None:
        """End a page with a sentence, and drop its connection if it does not read it."""
        self.leave(session)
        session.end(_packed({"k": "refused", "text": text}))
        with contextlib.suppress(RuntimeError):
            asyncio.get_running_loop().call_later(_END_S, session.drop)

    def _free_window(self) -> str:
        """Return the first letter that no window has, on this server or in the lease, which servers share."""
        lease = self.desk.lease
        parties = [each.party for each in self.sessions] + [each.party for each in lease.asking]
        taken = {each.window for each in [*parties, lease.holder] if each is not None}
        letters = (first + second for first in ("", *ascii_uppercase) for second in ascii_uppercase)
        return next((letter for letter in letters if letter not in taken), "")

    def leave(self, session: Session) -> None:
        """Remove a page that has closed, and cancel its waiting commands."""
        self.sessions.discard(session)
        self.commands.make_void("its page was closed", lambda wish: wish.session is session)
        self.desk.leave(session)
        if session is self.hand.holder:
            self.hand.release()

    @property
    def left_out(self) -> LeftOut:
        """The numbers of messages that could not be shown, by reason."""
        return self._feed.left_out

    def metrics(self, now_ns: int) -> str:
        """Return the newest reports of all nodes for a monitoring system; now_ns, the time on the rig's clock [ns].

        The text is made at most once a second, because making it takes time from the pages.
        """
        return self._metrics.at(now_ns, lambda: metrics_text(self._feed.snapshot()["nodes"], now_ns, self.age.parts))

    def snapshot(self, session: Session) -> bytes:
        """Return the first frame of a page with the whole state; for a participant only the part it may know."""
        if session.role is Role.PARTICIPANT:
            return _packed(self._picture.snapshot(self._feed.snapshot(), hand=self.hand.exists))
        return _packed(
            {
                "k": "snapshot",
                "at_s": time.monotonic(),
                "role": session.role,
                "commands": self.commands.commander is not None,
                "hand": self.hand.exists,
                "streams": described(),
                "forms": self._forms,
                "source": self._source.about(),
                "me": session.party.id,
                "window": session.party.window,
                "panels": [row.about() for row in self.panels.rows],
                "problems": list(self.panels.problems),
                "lease": self.desk.facts(),
                **self._feed.snapshot(),
            }
        )

    async def handle(self, session: Session, request: Request, arrived_s: float) -> None:
        """Carry out a request that arrived at a time [s], if the role permits it, and queue the answer."""
        session.heard_s = time.monotonic()
        if isinstance(request, HereRequest):
            way_s = session.heard_s - request.stamp_s - request.waited_s
            if request.stamp_s and 0.0 <= way_s < _LONGEST_WAY_S:
                session.ways_s.append(way_s)
                session.way_at_s = session.heard_s
            return
        session.acted_s = session.heard_s
        # A request that was read before the page ended must not give it the hand.
        if session.ended or (session not in self.sessions and isinstance(request, HandRequest | LeaseRequest)):
            return
        if isinstance(request, HandRequest):
            self._push(session, request)
            return
        is_guest = session.role is Role.PARTICIPANT
        if isinstance(request, DocumentRequest | PartRequest | RecordingRequest) and not is_guest:
            session.answer(_packed(await self._read(session, request)))
            return
        identifier = getattr(request, "id", "")
        is_refused = True
        try:
            answers = await self._carried_out(session, request, arrived_s)
            is_ok = bool(answers) and all(kind == "ack" for kind, _ in answers.values())
            text = "; ".join(_row(node, kind, text, is_ok) for node, (kind, text) in sorted(answers.items()))
            is_refused = not answers or any(kind == "refused" for kind, _ in answers.values())
        except TelenanoError as error:
            is_ok, text = False, str(error)
        except Exception as error:  # noqa: BLE001
            # A page that requested an emergency stop must learn of any error that prevented it.
            is_ok, text = False, f"not carried out: {type(error).__name__}: {error}"
        if session.role is Role.PARTICIPANT:
            text = self._picture.acknowledgement(is_ok=is_ok)
        lease = {"lease": self.desk.facts()} if is_ok and isinstance(request, LeaseRequest) else {}
        # Nodes may also be absent or out of reach, which a page does not call a refusal.
        why = {} if is_ok or is_refused or session.role is Role.PARTICIPANT else {"refused": False}
        session.answer(_packed({"k": "answer", "id": identifier, "ok": is_ok, "text": text, **why, **lease}))

    async def _read(
        self, session: Session, request: DocumentRequest | PartRequest | RecordingRequest
    ) -> Mapping[str, Any]:
        """Return the answer to a page that reads a recording: the data, or the reason for a refusal."""
        try:
            if not session.may_ask(time.monotonic()):
                raise RefusedError(f"this page sends more than {REQUESTS_PER_S} requests per second")
            if isinstance(request, RecordingRequest):
                self._check_may_download(session)
                answer = await self.recording.answer(session, request.name)
            else:
                answer = await self._reads.read(request)
        except TelenanoError as error:
            return {"k": "answer", "id": request.id, "ok": False, "text": str(error)}
        return {"k": "answer", "id": request.id, "ok": True, "text": "", "found": answer}

    def _check_may_download(self, session: Session) -> None:
        """Raise RefusedError for a page that is not an operator's.

        A recording contains the site file and the scenario, which no page shows to an observer.
        """
        if session.role is not Role.OPERATOR:
            self.desk.refused.note("role", f"{session.party.label}: the file of the recording")
            raise RefusedError("only the page of an operator gets the file of the recording")

    def may_have(self, session: Session) -> bool:
        """Return whether the address of a page's person is still valid."""
        return session.person is None or self.is_admitted(session.person)

    async def _carried_out(self, session: Session, request: Request, arrived_s: float) -> Answers:
        if not session.may_ask(time.monotonic()):
            raise RefusedError(f"this page sends more than {REQUESTS_PER_S} requests per second")
        if isinstance(request, PanelRequest) and session.role is not Role.OBSERVER:
            return await self._ask_desk(session, request)
        if session.role in (Role.OBSERVER, Role.PARTICIPANT) and not isinstance(request, EstopRequest):
            whose = "an observer, who may look" if session.role is Role.OBSERVER else "a participant, who may answer"
            self.desk.refused.note("role", f"{session.party.label}: {type(request).__name__}")
            raise RefusedError(f"this page was opened with the token of {whose} and stop, and not command")
        if isinstance(request, TransportRequest):
            return {"transport": ("ack", self._source.transport(request.action, request.value))}
        if self.commands.commander is None:
            raise RefusedError("a recording cannot be commanded")
        if isinstance(request, EstopRequest):
            return await self.commands.stop(session.party.name)
        if isinstance(request, LeaseRequest):
            # Open the outlet first: that may take as long as a silent holder keeps the lease.
            with contextlib.suppress(TelenanoError):
                self.hand.outlet()
            text = self.desk.ask_for(session, request)
            # The former holder must release the hand before the answer.
            self.tick()
            return {"lease": ("ack", text)}
        if isinstance(request, CommandRequest):
            return await self._command(session, request, arrived_s)
        raise RefusedError("a page may say hello only once")

    async def _ask_desk(self, session: Session, request: PanelRequest) -> Answers:
        """Let the desk of a panel carry out a page's request; a participant may only use the panel for guests."""
        is_guest = session.role is Role.PARTICIPANT
        desk = self._desks.get(request.panel)
        if desk is None or (is_guest and request.panel != self._guests_panel):
            raise RefusedError(f"{request.panel[:80]!r}: no panel of this name can be asked")
        if (size := len(_packed(request.values))) > _MOST_ASKED_BYTES:
            raise RefusedError(f"an answer has {size} bytes, {_MOST_ASKED_BYTES} are allowed")
        rig = _PanelRig(self.hand.outlet(), self._feed.state)
        asked = Asked(request.id, session.party.id, session.role.value, request.values, rig)
        return {request.panel: ("ack", await desk.ask(asked))}

    async def _command(self, session: Session, request: CommandRequest, arrived_s: float) -> Answers:
        """Send a command in its turn, unless it is cancelled or too old by then; return the answers of the nodes."""
        if session not in self.sessions:
            raise RefusedError(f"{request.command} was cancelled: its page was closed")
        self.commands.check_arrival(session, request.command)
        wish = PageCommand(session, request, arrived_s)
        if wish.needs_lease:
            self.desk.act(session, request.lease)
        try:
            return await self.commands.send(wish)
        finally:
            self._end_act(session)

    def _push(self, session: Session, request: HandRequest) -> None:
        """Publish the force of a page, if it holds the hand or may take it; one page at a time holds it."""
        if not session.may_ask(time.monotonic()):
            return
        # A release counts at any age and in any order.
        if not request.held:
            session.hand.number = max(session.hand.number, request.number)
            if session is self.hand.holder:
                self.hand.release()
            if self.desk.has(session):
                self._end_act(session)
            return
        try:
            if not self.hand.exists or session.role is Role.OBSERVER:
                self.desk.refused.note("role", f"{session.party.label}: the force of a hand")
                raise RefusedError("this page cannot hold the hand")
            if self._is_old(session, request):
                return
            if session is not self.hand.holder or request.lease not in (0, self.desk.lease.number):
                self.desk.act(session, request.lease, presses=True)
                if self.hand.holder not in (None, session):
                    raise RefusedError("another page holds the hand")
            self.hand.press(session, request.force_n, (request.across_x_n, request.across_y_n))
            self._answer_force(session, request)
        except TelenanoError as error:
            session.answer(_packed({"k": "hand", "held": False, "text": str(error)}))

    def _answer_force(self, session: Session, request: HandRequest) -> None:
        """Answer a force that counts with the newest one that is felt, its age, and the stamp of the frame answered."""
        if not request.stamp_s or session.role is not Role.OPERATOR:
            return
        self._collect()
        if self._feed.felt is not None:
            force_n, sent_ns = self._feed.felt
            felt = {"force_n": force_n, "age_s": (self.hand.outlet().now_ns() - sent_ns) * 1e-9}
            session.answer(_packed({"k": "felt", **felt, "number": request.number, "stamp_s": request.stamp_s}))

    def _is_old(self, session: Session, request: HandRequest) -> bool:
        """Return whether a force is late or was overtaken by a newer one; if so, tell its page how late it is."""
        late_s, hand = session.hand_late_s(request.stamp_s, time.monotonic()), session.hand
        is_old = late_s > HAND_FRESH_S or 0 < request.number <= hand.number
        hand.number = max(hand.number, request.number)
        if is_old:
            self.desk.refused.note("late", f"{session.party.label}: a force that is {late_s:.2f} s late")
            self._tell_slow(session, late_s)
        return is_old

    def _tell_slow(self, session: Session, late_s: float) -> None:
        """Tell a page how late its hand is [s], at most twice a second; 0 tells it once that it is no longer late."""
        reported_s, now_s = session.slow_reported_s, time.monotonic()
        if late_s > 0.0 and (reported_s is None or now_s - reported_s >= _SLOW_REPORT_PERIOD_S):
            session.slow_reported_s = now_s
        elif late_s > 0.0 or reported_s is None or now_s - reported_s < _SLOW_REPORT_PERIOD_S:
            return
        else:
            session.slow_reported_s = None
        session.answer(_packed({"k": "hand", "held": True, "text": "", "late_s": late_s}))

    def _end_act(self, session: Session) -> None:
        """End the control of a page with its last act, unless it has taken control."""
        if session is not self.hand.holder and not self.commands.waiting(session):
            with contextlib.suppress(TelenanoError):
                self.desk.ended(session)

    def _hold(self) -> None:
        """Repeat the force of the page that presses, and tell it how late its hand is."""
        holder, late_s = self.hand.holder, self.hand.look()
        if holder is not None and late_s is not None:
            self._tell_slow(holder, late_s if late_s > HAND_FRESH_S else 0.0)
            self.hand.repeat()


class _NoPicture:
    """The frames for participants if no package has a page for them: only a refusal."""

    def take(self, changes: Mapping[str, Any], now_s: float) -> list[dict[str, Any]]:
        return []

    def snapshot(self, snapshot: Mapping[str, Any], *, hand: bool) -> dict[str, Any]:
        return {"k": "refused", "text": "no installed package has a page for this address"}

    def acknowledgement(self, *, is_ok: bool) -> str:
        return "done" if is_ok else "not carried out"


def _row(node: str, kind: str, text: str, is_ok: bool) -> str:
    """Return what became of a command at a node; unless all have acknowledged it, with the kind in words."""
    words = {str(name): meaning.partition(":")[0] for name, meaning in MEANINGS.items()}
    return f"{node}: {text}" if is_ok else f"{node} {words.get(kind, kind)}: {text}"


def _packed(fields: Mapping[str, Any]) -> bytes:
    packed: bytes = msgpack.packb(fields)
    return packed
