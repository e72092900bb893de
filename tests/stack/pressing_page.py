"""A page that has the hand and presses, as a process of its own that can be stopped and killed: `... ADDRESS`.

It prints what it is told of the lease, a line of JSON each time, and ends when its connection does.
"""

import asyncio
import json
import sys
from typing import Any
from urllib.parse import urlsplit

import msgpack
import websockets

FORCE_N = 1.0


def say(fields: Any) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


async def main(address: str) -> None:
    parts = urlsplit(address)
    origin: Any = f"http://{parts.netloc}"
    async with websockets.connect(f"ws://{parts.netloc}/bus", origin=origin, max_size=None) as page:
        await page.send(msgpack.packb({"k": "hello", "protocol": 1, "token": parts.fragment}))
        me, number = "", 0

        async def press() -> None:
            while True:
                # as the page's worker does, whether it is heard or not
                frame = {"k": "hand", "force_n": FORCE_N, "held": True, "lease": number}
                await page.send(msgpack.packb(frame if number else {"k": "here"}))
                await asyncio.sleep(1 / 60)

        pressing = None
        async for data in page:
            frame = msgpack.unpackb(data, strict_map_key=False)
            if frame["k"] == "snapshot":
                me = frame["me"]
                await page.send(msgpack.packb({"k": "lease", "id": "take", "action": "take"}))
            if frame["k"] in ("answer", "hand", "refused"):
                say(frame)
            if lease := frame.get("lease"):
                number = lease["number"] if lease["holder"] == me else 0
                say({"mine": bool(number), **lease})
            pressing = pressing or asyncio.create_task(press())


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1]))
    except (websockets.ConnectionClosed, OSError) as error:
        say({"closed": str(error)})
