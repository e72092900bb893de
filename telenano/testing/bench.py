"""Test benches for single nodes in virtual time, and for the drivers and programs that packages add to them."""

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

# Period of an instrument [s].
_PERIOD_S = 1e-3


class NodeBench:
    """The surroundings of one node in virtual time: stores its published messages, and makes those that it receives.

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
        """Return a message with the next number of its source."""
        seq = self._sequence.get((topic, src), 0)
        self._sequence[topic, src] = seq + 1
        model = TOPICS[topic].model
        header = {"seq": seq, "t_ns": self.clock.now_ns(), "src": src, "v": model.version}
        return compose(topic, {**header, **fields})[0]

    def received(self, topic: str, src: str, **fields: Any) -> Received:
        """Return a message of another node, as received by the node now."""
        message = self.make(topic, src, **fields)
        return Received(topic, message, encode(message), self.clock.now_ns(), Arrival.NEXT)

    def link_delay(self, direction: str, delay_ns: int) -> Received:
        """Return a message of the link about its delay in a direction [ns]."""
        src = "delay_node@" + self.context.key.partition("@")[2]
        unknown = {"hand_t_ns": 0, "transit_ns": 0, "clock_ahead_ns": 0}
        return self.received("link/delay", src, direction=direction, delay_ns=delay_ns, **unknown)

    def take(self, topic: str) -> list[Any]:
        """Return and remove the messages published on a topic."""
        taken = [message for name, message in self.sent if name == topic]
        self.sent = [(name, message) for name, message in self.sent if name != topic]
        return taken

    def advance_ms(self, duration_ms: float) -> None:
        self.clock.advance_ns(round(duration_ms * 1e6))


def afm_config(section: Any = None) -> Any:
    """Return the validated settings of a section `afm_node`; raise ValueError if they are wrong."""
    from telenano.sections.afm_section import AfmConfig

    return section if isinstance(section, AfmConfig) else AfmConfig.model_validate(section or {})


def instrument_of(section: Any = None) -> Any:
    """Return the driver of a section `afm_node`, not yet opened; by default the simulated instrument."""
    from telenano.devices.afm.instrument import driver_of

    return driver_of(afm_config(section))


def afm_node(bench: NodeBench, driver: Any, section: Any = None) -> Any:
    """Return the AFM node with an opened driver, instead of the driver that the section names.

    Raises:
        DeviceError: The driver refuses to open.
    """
    process = import_module(f"{module_of(name_of(TIP))}.node")
    return process.AfmNode(bench.context, afm_config(section), driver)


def haptic_config(section: Any = None) -> Any:
    """Return the validated settings of a section `haptic_node`; raise ValueError if they are wrong."""
    from telenano.sections.hand_section import HapticConfig

    return section if isinstance(section, HapticConfig) else HapticConfig.model_validate(section or {})


def haptic_device_of(section: Any = None) -> Any:
    """Return the driver of a section `haptic_node`, not yet opened; by default the simulated device."""
    process = import_module(f"{module_of(name_of(HAND))}.__main__")
    return process.device_of(haptic_config(section))


def haptic_node(bench: NodeBench, driver: Any, section: Any = None) -> Any:
    """Return the haptic node on this driver, which the node opens, instead of the driver that the section names.

    Raises:
        DeviceError: The driver refuses to open.
    """
    process = import_module(f"{module_of(name_of(HAND))}.node")
    return process.HapticNode(bench.context, haptic_config(section), driver)


def _pass_ms(line: Any, duration_ms: int) -> None:
    """Let time pass for the device behind a node, by its `pass_ms`, which a test may replace at any time."""
    if hasattr(line, "pass_ms"):
        line.pass_ms(duration_ms)


class InstrumentRig:
    """An AFM node on a bench, over a wire (`RequestLine`) or with any driver, which a test commands like a law.

    Args:
        bench: The bench of the node.
        driver: The driver, or an object with the driver as attribute `driver` and a method `pass_ms` for its time.
        section: The section `afm_node`.
    """

    def __init__(self, bench: NodeBench, driver: Any, section: Any = None) -> None:
        self.bench, self.line = bench, driver
        self.node = afm_node(bench, getattr(driver, "driver", driver), section)

    def tick(self, count: int = 1, x_s_m: float = 0.0, place: tuple[float, float] = (0.0, 0.0)) -> None:
        """Command a base position and a place over the sample, once per millisecond.

        Args:
            count: The number of commands.
            x_s_m: The position of the base, towards the sample [m].
            place: The place of the tip over the sample [m].
        """
        for _ in range(count):
            self.bench.advance_ms(1)
            _pass_ms(self.line, 1)
            fields = {"mode": "position", "base_position_m": (*place, 0.0 - x_s_m), "hand_seq": 7, "hand_armed": True}
            fields["hand_t_ns"] = self.bench.clock.now_ns()
            self.node.on_message(self.bench.received("afm/command", "controller@slave", **fields))

    def control(self, command: str, **parameters: Any) -> str:
        """Send the node a command, and return the sentence with which it carries it out; RefusedError if refused."""
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": parameters}
        return str(self.node.on_control(self.bench.make("session/control", "console@slave", **fields)))


class HandRig:
    """A haptic node on a bench, over a wire or with any driver, which a test commands like a law.

    Args:
        bench: The bench of the node.
        driver: The driver, or an object with the driver as attribute `driver` and a method `pass_ms` for its time.
        section: The section `haptic_node`.
    """

    def __init__(self, bench: NodeBench, driver: Any, section: Any = None) -> None:
        self.bench, self.line = bench, driver
        self.node = haptic_node(bench, getattr(driver, "driver", driver), section)
        # Commanded position of the device, on the axis of the paper [m].
        self.x_m = 0.0

    def tick(self, count: int = 1) -> None:
        """Command the position `x_m` and let the node step, `count` times, once per period of the node."""
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
    """Return the node `other` after it has restored the state of `one`, as in a re-run from the middle of a journal."""
    from telenano.wire.node_state import pack, restore

    restore(other, pack(one), lambda *_: b"")
    return other


def refused_program(driver: str, program: str) -> str:
    """Return the reason why a program cannot run on a driver of the instrument; empty if it can."""
    from telenano.devices.afm.capabilities import refusal

    return refusal(driver, program)


def refused_laws(driver: str) -> dict[str, str]:
    """Return the laws that cannot be used with a driver of the instrument, by name, with the reasons."""
    from telenano.launcher import plan

    return plan.refused_laws(driver)


def trial(
    program: "Program[Any, Any, Any]",
    settings: "ProgramSettings",
    stiffness_n_per_m: float = 40.0,
    most_s: float = 60.0,
) -> "Iterator[Inputs]":
    """Run a program on the default instrument over a linear spring; yield its inputs at each step until it is done.

    The base moves at once to the position that the program requests, and the stage at its limited speed; nothing guards
    the tip.

    Args:
        program: The program to run.
        settings: Its settings.
        stiffness_n_per_m: Force on the tip per metre of the base beyond the surface at `rest_distance_m` [N/m].
        most_s: The time after which an unfinished program is ended [s].

    Raises:
        RefusedError: The program refuses its settings.
        TimeoutError: The program is not done within most_s.
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
