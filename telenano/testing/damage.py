"""Files that are damaged on purpose, in the same way with the same seed."""

import random
import struct
from collections.abc import Iterator


def damaged(whole: bytes, seed: int, count: int) -> Iterator[bytes]:
    """Yield a file with bits flipped, a number at its end, or cut, lengthened, zeroed or doubled in parts.

    Each reader of files has to answer each of them with what is right in it, or with a sentence.

    Args:
        whole: The file as it should be.
        seed: The seed of the damage.
        count: How many files to yield; each sixth of them is damaged in one way.
    """
    dice = random.Random(seed)
    for number in range(count):
        content = bytearray(whole)
        at = dice.randrange(len(content))
        match number % 6:
            case 0:
                for _ in range(dice.randint(1, 5)):
                    content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
            case 1:
                content[at : at + 4] = struct.pack("<I", dice.choice((0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0)))
            case 2:
                del content[at:]
            case 3:
                content += dice.randbytes(at + 1)
            case 4:
                content[at : at + 40] = bytes(40)
            case _:
                content[at:at] = content[at : at + 64]
        yield bytes(content)
