"""The advisers that packages bring, a few times a second beside the loop.

They read a copy of what the nodes publish from a socket of the launcher's own, which wakes no process: the newest of
each topic is taken at every tick.
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

# A reader takes at most 256 messages in a turn, and five times as much as comes in a tick.
_MOST_TURNS = 4


class Advisers:
    """The advisers of a rig, by name, and what they read."""

    def __init__(self, log: StructuredLog, advisers: Mapping[str, Adviser], readers: Sequence[Subscriber] = ()) -> None:
        """Prepare to look.

        Args:
            log: Where the failure of an adviser is written.
            advisers: The advisers, by name.
            readers: What is read at each look.
        """
        self._log, self._advisers, self._readers = log, dict(advisers), readers

    def look(self, *, runs: bool) -> list[Advice]:
        """Read what has come, and return the warnings that are due."""
        messages = list(self._received())
        found = []
        for name, adviser in list(self._advisers.items()):
            try:
                if (advice := adviser.look(messages, runs=runs)) is not None:
                    found.append(advice)
            # whatever is wrong with the advice, the session continues
            except Exception as error:  # noqa: BLE001
                del self._advisers[name]
                self._log.warning(f"adviser {name} failed, and advises no more in this rig: {error!r}")
        return found

    def _received(self) -> Iterator[Message]:
        for reader in self._readers:
            for _ in range(_MOST_TURNS):
                yield from (received.message for received in reader.receive())
                if reader.drained:
                    break


def advisers_for(session: AdvisedSession, log: StructuredLog) -> dict[str, Adviser]:
    """Return the advisers of installed packages that have something to say of a session, by name."""
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
        # No rig depends on advice.
        except TelenanoError as error:
            log.warning(f"adviser {name} is left out: {error}")
        else:
            made[name] = adviser
    return made


def absent_laws() -> dict[str, str]:
    """Return the laws of this project's packages that are not installed, each with where it is."""
    return {law: where_it_is(f"law {law}") for law in known_of("law") if law not in LAWS}
