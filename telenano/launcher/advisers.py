"""Advisers from packages, which examine the messages of a running session and warn the person who runs it.

They run in the launcher, not in the loop. The launcher reads their topics from subscribers of its own at every tick,
the newest messages only, so no message wakes the process.
"""

from collections.abc import Iterator, Mapping, Sequence

from telenano.extend.advice import Advice, AdvisedSession, Adviser
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.loop.log import StructuredLog
from telenano.sections.controller_section import LAWS
from telenano.settings.known_packages import known_of, where_it_is
from telenano.settings.package_topics import topics_by_name
from telenano.settings.plugins import code_of, installed, load
from telenano.wire.errors import ConfigError, TelenanoError
from telenano.wire.messages import Message
from telenano.wire.topics import OWN_TOPICS

# Reads per subscriber and tick; a read takes at most 256 messages, and all reads five times those of a tick.
_MOST_TURNS = 4


class Advisers:
    """The advisers of a rig, by name, and the subscribers to the topics that they read."""

    def __init__(self, log: StructuredLog, advisers: Mapping[str, Adviser], readers: Sequence[Subscriber] = ()) -> None:
        """Keep the advisers and the subscribers; nothing is read yet.

        Args:
            log: The log for failures of advisers.
            advisers: The advisers, by name.
            readers: The subscribers that each `look` reads.
        """
        self._log, self._advisers, self._readers = log, dict(advisers), readers

    def look(self, *, runs: bool) -> list[Advice]:
        """Read the messages received since the last call, pass them to each adviser, and return its warnings.

        An adviser that raises is logged and dropped for the rest of the rig. `runs`: whether a session is running.
        """
        messages = list(self._received())
        found = []
        for name, adviser in list(self._advisers.items()):
            try:
                if (advice := adviser.look(messages, runs=runs)) is not None:
                    found.append(advice)
            # An adviser is code of a package and may raise anything; the session continues without it.
            except Exception as error:  # noqa: BLE001
                del self._advisers[name]
                self._log.warning(f"adviser {name} failed and is not asked again in this rig: {error!r}")
        return found

    def _received(self) -> Iterator[Message]:
        for reader in self._readers:
            for _ in range(_MOST_TURNS):
                yield from (received.message for received in reader.receive())
                if reader.drained:
                    break


def advisers_for(session: AdvisedSession, log: StructuredLog) -> dict[str, Adviser]:
    """Return the advisers of installed packages for a session, by name.

    A package may decline by returning None; an adviser that cannot be made is logged and left out.
    """
    made: dict[str, Adviser] = {}
    loaded = load("advisers")
    for name, problem in loaded.problems.items():
        log.warning(f"adviser {name} is left out: {problem}")
    for name, make in loaded.found.items():
        try:
            with code_of(installed("advisers")[name].package):
                if (adviser := make(session)) is None:
                    continue
                if unknown := sorted({*adviser.inputs} - {*OWN_TOPICS, *topics_by_name()}):
                    raise ConfigError(f"it looks at {', '.join(unknown)}, and there are no such topics")
        # Advice is optional, so a broken adviser does not prevent the start of a rig.
        except TelenanoError as error:
            log.warning(f"adviser {name} is left out: {error}")
        else:
            made[name] = adviser
    return made


def absent_laws() -> dict[str, str]:
    """Return the laws of this project's packages that are not installed, each with its package in words."""
    return {law: where_it_is(f"law {law}") for law in known_of("law") if law not in LAWS}
