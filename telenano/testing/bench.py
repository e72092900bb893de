"""Nodes in virtual time, each alone on a bench, and what a package gives to one: drivers and programs."""

from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.timing.clock import VirtualClock as VirtualClock
from telenano.wire import TOPICS, compose, encode
from telenano.wire.messages import Message
from telenano.wire.nodes import HAND, TIP, module_of, name_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

if TYPE_CHECKING:
    from telenano.extend.programs import Inputs, Program, ProgramSettings

# the period of an instrument [s]
_PERIOD_S = 1e-3


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


def afm_config(section: Any = None) -> Any:
    """Return the settings of a section `afm_node`, validated; ValueError names what is wrong."""
    from telenano.sections.afm_section import AfmConfig

    return section if isinstance(section, AfmConfig) else AfmConfig.model_validate(section or {})


def instrument_of(section: Any = None) -> Any:
    """Return the driver of a section `afm_node`, not yet open: the simulated instrument where it names none."""
    from telenano.devices.afm.instrument import driver_of

    return driver_of(afm_config(section))


def afm_node(bench: NodeBench, driver: Any, section: Any = None) -> Any:
    """Return the node with a driver of a package, opened, whatever the section names as its driver.

    Raises:
        DeviceError: The driver refuses to open.
    """
    process = import_module(f"{module_of(name_of(TIP))}.node")
    return process.AfmNode(bench.context, afm_config(section), driver)


def haptic_config(section: Any = None) -> Any:
    """Return the settings of a section `haptic_node`, validated; ValueError names what is wrong."""
    from telenano.sections.hand_section import HapticConfig

    return section if isinstance(section, HapticConfig) else HapticConfig.model_validate(section or {})


def haptic_device_of(section: Any = None) -> Any:
    """Return the driver of a section `haptic_node`, not yet open: the simulated device where it names none."""
    process = import_module(f"{module_of(name_of(HAND))}.__main__")
    return process.device_of(haptic_config(section))


def haptic_node(bench: NodeBench, driver: Any, section: Any = None) -> Any:
    """Return the node with a driver of a haptic device, opened, whatever the section names as its driver.

    Raises:
        DeviceError: The driver refuses to open.
    """
    process = import_module(f"{module_of(name_of(HAND))}.node")
    return process.HapticNode(bench.context, haptic_config(section), driver)


def _pass_ms(line: Any, duration_ms: int) -> None:
    """Let the time of what is behind a node pass; a test may replace `pass_ms` of it meanwhile."""
    if hasattr(line, "pass_ms"):
        line.pass_ms(duration_ms)


class InstrumentRig:
    """An AFM node on a bench, over a wire (`RequestLine`) or with any driver, which a test commands as a law does.

    Args:
        bench: The bench of the node.
        driver: The driver, or what has it as its attribute `driver` and lets its own time pass in `pass_ms`.
        section: The section `afm_node`.
    """

    def __init__(self, bench: NodeBench, driver: Any, section: Any = None) -> None:
        self.bench, self.line = bench, driver
        self.node = afm_node(bench, getattr(driver, "driver", driver), section)

    def tick(self, count: int = 1, x_s_m: float = 0.0, place: tuple[float, float] = (0.0, 0.0)) -> None:
        """Command a base and a place over the sample, once a millisecond.

        Args:
            count: How often.
            x_s_m: Where the base is wanted, towards the sample [m].
            place: Where over the sample the tip is wanted [m].
        """
        for _ in range(count):
            self.bench.advance_ms(1)
            _pass_ms(self.line, 1)
            fields = {"mode": "position", "base_position_m": (*place, 0.0 - x_s_m), "hand_seq": 7, "hand_armed": True}
            fields["hand_t_ns"] = self.bench.clock.now_ns()
            self.node.on_message(self.bench.received("afm/command", "controller@slave", **fields))

    def control(self, command: str, **parameters: Any) -> str:
        """Give the node a command, and return what it refuses it with; empty where it does not."""
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": parameters}
        return str(self.node.on_control(self.bench.make("session/control", "console@slave", **fields)))


class HandRig:
    """A haptic node on a bench, over a wire or with any driver, which a test commands as a law does.

    Args:
        bench: The bench of the node.
        driver: The driver, or what has it as its attribute `driver` and lets its own time pass in `pass_ms`.
        section: The section `haptic_node`.
    """

    def __init__(self, bench: NodeBench, driver: Any, section: Any = None) -> None:
        self.bench, self.line = bench, driver
        self.node = haptic_node(bench, getattr(driver, "driver", driver), section)
        # where the device is wanted, on the axis of the paper [m]
        self.x_m = 0.0

    def tick(self, count: int = 1) -> None:
        """Command the place `x_m` and let the node take its turn, once a millisecond, `count` times."""
        for _ in range(count):
            now_ns = self.bench.clock.now_ns()
            command = {"mode": "position", "position_m": (0.0, 0.0, -self.x_m), "velocity_m_per_s": (0.0, 0.0, 0.0)}
            stamps = {"force_n": (0.0, 0.0, 0.0), "hand_seq": 0, "hand_t_ns": now_ns}
            self.node.on_message(self.bench.received("haptic/command", "controller@master", **command, **stamps))
            before_ns = self.bench.clock.monotonic_ns()
            self.bench.clock.advance_ns(max(0, self.node.deadline_ns() - before_ns))
            _pass_ms(self.line, 1)
            self.node.on_deadline(self.bench.clock.monotonic_ns())


def handed_over(one: Any, other: Any) -> Any:
    """Return another node that goes on from the state of one, as a re-run from the middle of a journal does."""
    from telenano.wire.node_state import pack, restore

    restore(other, pack(one), lambda *_: b"")
    return other


def refused_program(driver: str, program: str) -> str:
    """Return why a program cannot run on a driver of the instrument; empty where it can."""
    from telenano.devices.afm.capabilities import refusal

    return refusal(driver, program)


def refused_laws(driver: str) -> dict[str, str]:
    """Return the laws that cannot be used with a driver of the instrument, and why, by their names."""
    from telenano.launcher import plan

    return plan.refused_laws(driver)


def trial(
    program: "Program[Any, Any, Any]",
    settings: "ProgramSettings",
    stiffness_n_per_m: float = 40.0,
    most_s: float = 60.0,
) -> "Iterator[Inputs]":
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
    from telenano.extend.programs import Inputs, Instrument
    from telenano.extend.samples import Oscillation
    from telenano.extend.stage import Place, moved
    from telenano.sections.afm_section import AfmConfig

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
