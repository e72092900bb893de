"""Advisers, which watch a running session and warn the person who runs it.

    def my_adviser(session: AdvisedSession) -> Adviser | None: ...

An entry of `telenano.advisers` is such a function. The launcher calls it once at the start of a rig, passes copies of
the nodes' messages to the adviser, and publishes its advice. Advice never acts on a device, and no session depends on
it: an adviser that fails is no longer called, and the log says so.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from telenano.wire.messages import Message, Scalar

# Key that marks an adviser's warning in the data of the launcher's event; a page shows it beside the link.
ADVICE = "advice"


class Advice(NamedTuple):
    """A warning in sentences, and its facts for programs; the fact `law` names the law concerned, if any."""

    text: str
    facts: Mapping[str, Scalar]


class AdvisedSession(NamedTuple):
    """Facts on the session that an adviser gets at the start of a rig.

    Attributes:
        controller: The section of the controller, `telenano.sections.ControllerConfig`.
        now_ns: Function that returns the monotonic time [ns].
        absent_laws: The laws of packages that are not installed, each with a sentence on where to find it.
    """

    controller: Any
    now_ns: Callable[[], int]
    absent_laws: Mapping[str, str] = {}


class Adviser(Protocol):
    """Watches the sessions of a rig.

    Attributes:
        inputs: The topics that it needs.
    """

    inputs: Sequence[str]

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        """Return a warning that is due, or None; called about twenty times a second.

        Args:
            messages: The newest messages since the last call, of these topics and of others.
            runs: Whether a session is running.
        """
