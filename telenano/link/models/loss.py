"""Loss with memory: the four-state Markov chain and Gilbert-Elliott."""

from telenano.link.random_streams import Draw
from telenano.settings.link_settings import GilbertElliott, MarkovLoss

# The states of the Markov chain, with the indices of its probabilities p_ij.
_RECEIVED = 1
_RECEIVED_IN_BURST = 2
_LOST_IN_BURST = 3
_LOST_ALONE = 4


class MarkovLossChain:
    """Four states: 1 received, 2 received inside a burst, 3 lost inside a burst, 4 lost alone.

    The chain steps once for each message, and the new state decides. Transitions: 1->3 (p13), 1->4 (p14), 3->1 (p31),
    3->2 (p32), 2->3 (p23), 4->1 always; otherwise the state stays. With D = 1 + p14 + p13/p31 (1 + p32/p23) the loss
    rate is (p14 + p13/p31) / D.
    """

    __slots__ = ("_draw", "_settings", "state")

    def __init__(self, settings: MarkovLoss, draw: Draw) -> None:
        self._settings = settings
        self._draw = draw
        self.state = _RECEIVED

    def __call__(self) -> bool:
        """Step to the next message and return whether it is lost."""
        s, u = self._settings, self._draw()
        if self.state == _RECEIVED:
            self.state = _LOST_ALONE if u < s.p14 else _LOST_IN_BURST if u < s.p14 + s.p13 else _RECEIVED
        elif self.state == _RECEIVED_IN_BURST:
            self.state = _LOST_IN_BURST if u < s.p23 else _RECEIVED_IN_BURST
        elif self.state == _LOST_IN_BURST:
            self.state = _RECEIVED_IN_BURST if u < s.p32 else _RECEIVED if u < s.p32 + s.p31 else _LOST_IN_BURST
        else:
            self.state = _RECEIVED
        return self.state >= _LOST_IN_BURST


class GilbertElliottChain:
    """Two states, each with its own loss probability; the chain starts in the good one.

    The state decides about the message (loss probability 1 - k in the good state, 1 - h in the bad one), then the chain
    steps (good->bad p, bad->good r). The share of the bad state is p/(p + r), the loss rate
    ((1 - k) r + (1 - h) p)/(p + r), and for h = 0, k = 1 the mean burst is 1/r messages.
    """

    __slots__ = ("_decide", "_settings", "_step", "state")

    def __init__(self, settings: GilbertElliott, step: Draw, decide: Draw) -> None:
        self._settings = settings
        self._step = step
        self._decide = decide
        # True while the channel is in the bad state.
        self.state = False

    def __call__(self) -> bool:
        """Return whether the next message is lost, then step."""
        s = self._settings
        lost = self._decide() < (s.loss_in_bad if self.state else s.loss_in_good)
        if self._step() < (s.r if self.state else s.p):
            self.state = not self.state
        return lost
