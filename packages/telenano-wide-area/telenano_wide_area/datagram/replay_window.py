"""A replay window: the numbers of accepted datagrams, so that none is accepted twice (the scheme of RFC 6479)."""

_WORD_BITS = 64
_WORDS = 64
# The window covers twice two seconds of a thousand datagrams a second: a datagram that more than these have overtaken
# is of no use to a reader.
WINDOW = _WORD_BITS * (_WORDS - 1)


class ReplayWindow:
    """A ring of words, each bit of which stands for a number; as the newest number grows, whole words are cleared."""

    __slots__ = ("_words", "newest")

    def __init__(self) -> None:
        self.newest = -1
        self._words = [0] * _WORDS

    def is_new(self, number: int) -> bool:
        """Return whether a number may still be accepted: neither accepted before, nor older than the window."""
        if number > self.newest:
            return True
        if self.newest - number >= WINDOW:
            return False
        return not self._words[number // _WORD_BITS % _WORDS] >> number % _WORD_BITS & 1

    def record(self, number: int) -> None:
        """Record a number for which `is_new` holds, after its datagram was authenticated."""
        word = number // _WORD_BITS
        if number > self.newest:
            newest_word = self.newest // _WORD_BITS
            for passed in range(min(word - newest_word, _WORDS)):
                self._words[(word - passed) % _WORDS] = 0
            self.newest = number
        self._words[word % _WORDS] |= 1 << number % _WORD_BITS

    def has(self, number: int) -> bool:
        """Return whether a number within the window was recorded."""
        return 0 <= self.newest - number < WINDOW and not self.is_new(number)
