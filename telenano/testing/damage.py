"""Files that are damaged on purpose; the same seed gives the same damage."""

import random
import struct
from collections.abc import Iterator


def damaged(whole: bytes, seed: int, count: int) -> Iterator[bytes]:
    """Yield copies of a file with flipped bits or an extreme number, or cut, lengthened, zeroed or doubled in parts.

    A reader must return the valid content of each, or an error in a sentence.

    Args:
        whole: The undamaged file.
        seed: The seed of the damage.
        count: The number of files; the six kinds of damage take turns.
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
