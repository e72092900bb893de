"""What the tests of a package put around their code: messages of a rig, and nodes in virtual time."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from telenano.extend.laws import longest_pause_periods as longest_pause_periods
from telenano.extend.laws import paced as paced
from telenano.extend.programs import Inputs, Instrument, Program, ProgramSettings
from telenano.extend.samples import Oscillation
from telenano.extend.stage import Place, moved
from telenano.recording import RecordedMessage, recorded
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.settings.config import merge as merge
from telenano.settings.config import validate as validate
from telenano.timing.clock import VirtualClock as VirtualClock
from telenano.wire import TOPICS, compose, encode, example
from telenano.wire.errors import RefusedError as RefusedError
from telenano.wire.messages import Message
from telenano.wire.nodes import TIP, module_of, name_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

_MS = 1_000_000
# the period of an instrument [s]
_PERIOD_S = 1e-3
# when the message with the number 0 was sent [ns since 1970]; each is sent a millisecond after the one before
EPOCH_NS = 1_750_000_000_000_000_000


def __getattr__(name: str) -> Any:
    """Return what an installed package brings for tests, by its entry point of the group `telenano.testing`."""
    for entry in entry_points(group="telenano.testing", name=name):
        return entry.load()
    raise AttributeError(f"telenano.testing has no {name}, and no installed package brings it")


def numbered(topic: str, seq: int, **changes: Any) -> Message:
    """Return an example of a message with this number and its time of sending, with some fields changed."""
    return example(topic, **({"seq": seq, "t_ns": EPOCH_NS + seq * _MS} | changes))


def hand_state(seq: int, **changes: Any) -> Message:
    """Return a numbered `haptic/state`, whose place and force are others with every number."""
    fields = {"position_m": (0.0, 0.0, -1e-3 * seq), "operator_force_n": (0.1, 0.2, -0.5 - seq)}
    return numbered("haptic/state", seq, **({"src": "haptic_node@master", "limited": seq % 2 == 1} | fields | changes))


def received(topic: str, message: Message, number: int, site: str = "") -> RecordedMessage:
    """Return a message as received `number` milliseconds after `EPOCH_NS`; for `site` see `messages.recorded`."""
    return recorded(topic, message, EPOCH_NS + number * _MS, site)


class NodeBench:
    """The world of one node in virtual time: what it publishes is kept, what it receives is made here.

    Args:
        key: The node and its site, such as `afm_node@slave`.
    """

    def __init__(self, key: str) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.sent: list[tuple[str, Message]] = []
        self._sequence: dict[tuple[str, str], int] = {}
        self.context = NodeContext(key, self.clock, self, StructuredLog(key))

    def publish(self, topic: str, **fields: Any) -> Message:
        message = self.make(topic, self.context.key, **fields)
        self.sent.append((topic, message))
        return message

    def receive(self) -> Iterator[Received]:
        return iter(())

    def run_deferred(self) -> None:
        """Run the tasks that the node has deferred."""
        while (task := self.context.deferred.take_turn()) is not None:
            task()

    def wait(self, deadline_ns: int) -> None:
        self.clock.advance_ns(max(0, deadline_ns - self.clock.monotonic_ns()))

    def make(self, topic: str, src: str, **fields: Any) -> Message:
        """Build a message with the next number of its source."""
        seq = self._sequence.get((topic, src), 0)
        self._sequence[topic, src] = seq + 1
        model = TOPICS[topic].model
        header = {"seq": seq, "t_ns": self.clock.now_ns(), "src": src, "v": model.version}
        return compose(topic, {**header, **fields})[0]

    def received(self, topic: str, src: str, **fields: Any) -> Received:
        """Return a message of another node as the node would receive it now."""
        message = self.make(topic, src, **fields)
        return Received(topic, message, encode(message), self.clock.now_ns(), Arrival.NEXT)

    def link_delay(self, direction: str, delay_ns: int) -> Received:
        """Return what the link tells a reader of its delay."""
        src = "delay_node@" + self.context.key.partition("@")[2]
        unknown = {"hand_t_ns": 0, "transit_ns": 0, "clock_ahead_ns": 0}
        return self.received("link/delay", src, direction=direction, delay_ns=delay_ns, **unknown)

    def take(self, topic: str) -> list[Any]:
        """Return and remove what was published on a topic."""
        taken = [message for name, message in self.sent if name == topic]
        self.sent = [(name, message) for name, message in self.sent if name != topic]
        return taken

    def advance_ms(self, duration_ms: float) -> None:
        self.clock.advance_ns(round(duration_ms * 1e6))


def afm_config(section: Mapping[str, Any] | None = None) -> Any:
    """Return the settings of a section `afm_node`, validated; ValueError names what is wrong."""
    from telenano.afm.config import AfmConfig

    return AfmConfig.model_validate(section or {})


def instrument_of(section: Mapping[str, Any] | None = None) -> Any:
    """Return the driver of a section `afm_node`, not yet open: the simulated instrument where it names none."""
    from telenano.devices.afm.instrument import driver_of

    return driver_of(afm_config(section))


def afm_node(bench: NodeBench, driver: Any, section: Mapping[str, Any] | None = None) -> Any:
    """Return the node with a driver of a package, opened, whatever the section names as its driver.

    Raises:
        DeviceError: The driver refuses to open.
    """
    process = import_module(f"{module_of(name_of(TIP))}.node")
    return process.AfmNode(bench.context, afm_config(section), driver)


def refused_laws(driver: str) -> dict[str, str]:
    """Return the laws that cannot be used with a driver of the instrument, and why, by their names."""
    from telenano.launcher import plan

    return plan.refused_laws(driver)


def trial(
    program: Program[Any, Any, Any], settings: ProgramSettings, stiffness_n_per_m: float = 40.0, most_s: float = 60.0
) -> Iterator[Inputs]:
    """Yield what a program is given at each step until it is done, on an instrument as shipped over a linear spring.

    The base goes where the program wants it to be, and the stage no faster than it can; nothing guards the tip.

    Args:
        program: The program to run.
        settings: Its settings.
        stiffness_n_per_m: Force on the tip for each metre of the base beyond the surface at `rest_distance_m` [N/m].
        most_s: The time after which a program that is not done is given up [s].

    Raises:
        RefusedError: The program refuses its settings.
        TimeoutError: It is not done within most_s.
    """
    # it holds the settings of every program, and so imports the packages that import this
    from telenano.afm.config import AfmConfig

    config = AfmConfig()
    limits, lateral = config.to_params().safety, config.to_lateral_params()
    k = config.cantilever.stiffness_n_per_m
    instrument = Instrument(limits, lateral, config.sample_sides_m(), k, _PERIOD_S)
    base_m, place = limits.retract_position_m, Place(0.0, 0.0)
    plan, state, *_ = program.begin(settings, instrument, place)
    for _ in range(round(most_s / _PERIOD_S)):
        force_n = stiffness_n_per_m * max(base_m - config.rest_distance_m, 0.0)
        inputs = Inputs(base_m, place, force_n, (0.0, 0.0), Oscillation(0.0, 0.0), Place(0.0, 0.0))
        yield inputs
        wanted = program.step(plan, state, inputs, _PERIOD_S)
        if wanted.is_done:
            return
        state, base_m = wanted.state, wanted.base_m
        place = moved(lateral, place, wanted.place, _PERIOD_S)[0]
    raise TimeoutError(f"the program is not done within {most_s:g} s")
