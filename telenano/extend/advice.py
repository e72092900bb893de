"""What watches a running session and advises the person who runs it.

    def my_adviser(session: AdvisedSession) -> Adviser | None: ...

An entry of `telenano.advisers` is such a function. The launcher calls it once at the start of a rig, gives the adviser
a copy of what the nodes publish, and tells its advice. Advice never acts on a device, and no session depends on it: an
adviser that fails is left out from then on, with a line in the log.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from telenano.wire.messages import Message, Scalar

# In the facts of its event the launcher marks with this key what an adviser said; a page shows it beside the link.
ADVICE = "advice"


class Advice(NamedTuple):
    """A warning in sentences, and its facts for a program: `law` is the law that it is of, if it is of one."""

    text: str
    facts: Mapping[str, Scalar]


class AdvisedSession(NamedTuple):
    """What an adviser is given at the start of a rig.

    Attributes:
        controller: The section of the controller, `telenano.sections.ControllerConfig`.
        now_ns: Returns the time on the monotonic clock [ns].
        absent_laws: The laws of packages that are not installed, each with a sentence that says where it is.
    """

    controller: Any
    now_ns: Callable[[], int]
    absent_laws: Mapping[str, str] = {}


class Adviser(Protocol):
    """Watches the sessions of a rig.

    Attributes:
        inputs: The topics that it looks at.
    """

    inputs: Sequence[str]

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        """Return a warning that is due, some twenty times a second.

        Args:
            messages: The newest messages since the last look, of these topics and of others.
            runs: Whether a session runs.
        """
