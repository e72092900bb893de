"""A simulated participant in place of a page: it pushes the stylus of a running rig through `operator/force`."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import zmq

from telenano.console import RigHand
from telenano.runtime import AddressBook, Participant
from telenano.sections import ControllerConfig
from telenano.wire import LINK, HapticState, RigError, TeleopBackward
from telenano_lab.assembly import Hand, hand_moves
from telenano_lab.experiments.nodes import HAND
from telenano_lab.experiments.operators import PRESSES

# A page sends a force thirty times a second; an arm is faster.
_PERIOD_MS = 5


class PageHand:
    """The page's connection to a rig, used by a simulated hand.

    Args:
        site_file: The site file of the rig.

    Raises:
        EndpointError: Another process has that connection, such as `telenano view`.
    """

    def __init__(self, site_file: Path) -> None:
        self._hand, self._book = RigHand(site_file), AddressBook.load(site_file)

    def close(self) -> None:
        """Close the connection."""
        self._hand.close()

    @contextlib.contextmanager
    def pushing(
        self, steers: Callable[[float], Hand], controller: ControllerConfig, arm_n_per_m: float
    ) -> Iterator[None]:
        """Push while the block runs and the session clock of the hand counts.

        Args:
            steers: Makes the hand, from the period [s].
            controller: The settings of the controller, in rate mode.
            arm_n_per_m: The spring of the arm that pushes the stylus [N/m].

        Raises:
            RigError: The hand has failed meanwhile.
        """
        over, faults = threading.Event(), list[Exception]()

        def run() -> None:
            try:
                # It subscribes only while it pushes: unread messages would fill the queues of the nodes.
                with Participant.observing(self._book) as participant:
                    self._push(over, _HandInputs(participant), steers(controller.period_s), controller, arm_n_per_m)
            except Exception as error:  # noqa: BLE001
                faults.append(error)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
        if faults:
            raise RigError(f"the simulated hand has failed: {faults[0]}") from faults[0]

    def _push(
        self,
        over: threading.Event,
        inputs: "_HandInputs",
        hand: Hand,
        controller: ControllerConfig,
        arm_n_per_m: float,
    ) -> None:
        motion = controller.lateral_params().motion
        ticks, neutral_m, speed = 0, None, (0.0, 0.0)
        while not over.is_set():
            state = inputs.newest(hand)
            if state is None or state.session_s < 0.0:
                continue
            # The hand takes hold of the stylus at its current place.
            place_m, shown_n = state.position_m[:2], state.motor_force_n[:2]
            neutral_m = neutral_m or place_m
            newest = round(state.session_s / controller.period_s)
            for tick in range(ticks, newest + 1):
                speed = hand_moves(hand, tick)
            ticks = max(ticks, newest + 1)
            across_n = motion.steering_force_n(arm_n_per_m, place_m, neutral_m, shown_n, speed)
            self._hand.push(float(np.interp(state.session_s, *PRESSES)), across_n)
        self._hand.push(0.0)


class _HandInputs:
    """The perception of the hand: the newest states of the stylus, and the answers over the link."""

    def __init__(self, participant: Participant) -> None:
        heard = {HAND: ["haptic/state"], f"{LINK}@master": ["teleop/backward"]}
        self._subscribers, self._network = participant.subscribers(heard, newest_only=True), participant.network

    def newest(self, hand: Hand) -> HapticState | None:
        """Return the newest state of the stylus, or None; store an answer from the link in the hand."""
        zmq.select([subscriber.socket for subscriber in self._subscribers], [], [], _PERIOD_MS * 1e-3)
        self._network.process_events()
        state = None
        for received in (one for subscriber in self._subscribers for one in subscriber.receive()):
            message = received.message
            if isinstance(message, HapticState):
                state = message
            elif isinstance(message, TeleopBackward):
                hand.seen[:] = *message.position_m[:2], *message.force_n[:2]
        return state
