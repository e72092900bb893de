"""The hand of a page over a long line whose queue grows: how old the force is that reaches the device.

    python tests/stack/page_over_cable.py [--delay-ms 150] [--loss 0.02] [--queue-bytes 512000]

The server of the page runs in one network namespace and a page, without a browser, in another, with the cable of
tun_cable.py between them. The page says its own time as the force of its hand, so that what reaches the device tells
how old it is. For two seconds of eight another transfer fills the queue of the line. It needs root.
"""

import argparse
import asyncio
import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from lone_page_server import LonePageServer
from two_sites import MASTER
from wide_area_cable import WideAreaCable

from telenano.serving.access import Access

PORT = 8650
TOKEN = "operator-token-0123"
DURATION_S, FLOOD_S = 8.0, (3.0, 5.0)
RATE_BIT_PER_S = 4e6
_PERIOD_S, _HERE_S = 1.0 / 60.0, 0.25


def say(document: Any) -> None:
    """Print a document on a line at once."""
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


def serve() -> None:
    """Serve the page, and print each force that reaches the device: when, the share in force, and its age [s]."""

    def push(force_n: float, across_n: tuple[float, float]) -> None:
        # The page says its time as the force down, and 1 N across, of which the share in force is left.
        if (share := across_n[0]) > 0.0:
            now_s = time.monotonic()
            say([now_s, share, now_s - force_n / share])

    def drain() -> None:
        """Take what another transfer sends."""
        with socket.create_server((MASTER, PORT + 1)) as listener:
            taken, _ = listener.accept()
            while taken.recv(1 << 16):
                pass

    threading.Thread(target=drain, daemon=True).start()
    access = Access(TOKEN, "observer-token-0123", hosts=(MASTER,), networks=("10.0.0.0/8",))
    server = LonePageServer(push, access, host=MASTER, port=PORT)
    threading.Timer(DURATION_S + 6.0, server.end).start()
    server.run()
    say(server.hub.desk.refused.rejected)


async def page() -> None:
    """Press with a hand for some seconds, and print how late the server says that it is."""
    import msgpack
    from websockets.asyncio.client import connect

    from services.viz_node.requests import PROTOCOL

    def packed(**fields: Any) -> bytes:
        return bytes(msgpack.packb(fields))

    async with connect(f"ws://{MASTER}:{PORT}/bus", origin=f"http://{MASTER}:{PORT}", max_size=None) as bus:
        await bus.send(packed(k="hello", token=TOKEN, protocol=PROTOCOL))
        told: list[float] = []

        async def listen() -> None:
            async for frame in bus:
                fields = msgpack.unpackb(frame)
                if fields["k"] == "way":
                    await bus.send(packed(k="here", stamp_s=fields["stamp_s"], waited_s=0.0))
                if fields["k"] == "hand" and "late_s" in fields:
                    told.append(fields["late_s"])

        def flood() -> None:
            with socket.create_connection((MASTER, PORT + 1)) as other:
                time.sleep(FLOOD_S[0])
                other.settimeout(0.2)
                while time.monotonic() < begin_s + FLOOD_S[1]:
                    try:
                        other.send(bytes(1 << 16))
                    except TimeoutError:
                        continue

        listening = asyncio.create_task(listen())
        begin_s = time.monotonic()
        # A thread, because a full transfer must not hold up the page.
        threading.Thread(target=flood, daemon=True).start()
        number, here_s = 0, begin_s
        while (now_s := time.monotonic()) < begin_s + DURATION_S:
            number += 1
            hand = {"force_n": now_s, "across_x_n": 1.0, "held": True, "number": number, "stamp_s": now_s + 1e4}
            await bus.send(packed(k="hand", **hand))
            if now_s - here_s >= _HERE_S:
                here_s = now_s
                await bus.send(packed(k="here", stamp_s=0.0, waited_s=0.0))
            await asyncio.sleep(_PERIOD_S)
        await bus.send(packed(k="hand", force_n=0.0, held=False))
        await asyncio.sleep(1.0)
        listening.cancel()
    say(told)


def session(delay_s: float, loss: float, queue_bytes: int) -> dict[str, Any]:
    """Run a session and return what reached the device.

    `pushed`: rows of time [s], share in force and age [s]; `dropped`: frames that were too old; `told`: how late the
    page was told to be [s].
    """
    cable = WideAreaCable(delay_s, loss)
    try:
        cable.change(rate_bit_per_s=RATE_BIT_PER_S, queue_bytes=queue_bytes)
        serving, pressing = (
            subprocess.Popen(
                cable.inside(site, [sys.executable, str(Path(__file__)), "--role", role]),
                stdout=subprocess.PIPE,
                text=True,
                cwd=Path(__file__).parents[2],
            )
            for site, role in (("master", "serve"), ("slave", "wait-and-press"))
        )
        said, _ = pressing.communicate(timeout=60.0)
        rows, _ = serving.communicate(timeout=60.0)
        *pushed, refused = [json.loads(line) for line in rows.splitlines()]
        return {"pushed": pushed, "dropped": refused.get("late", 0), "told": json.loads(said)}
    finally:
        cable.close()


def main() -> None:
    """Run a session, or one of its two processes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--delay-ms", type=float, default=150.0)
    parser.add_argument("--loss", type=float, default=0.02)
    parser.add_argument("--queue-bytes", type=int, default=512_000)
    parser.add_argument("--role", choices=["serve", "wait-and-press"])
    given = parser.parse_args()
    if given.role == "serve":
        serve()
    elif given.role == "wait-and-press":
        time.sleep(4.0)
        asyncio.run(page())
    else:
        found = session(given.delay_ms * 1e-3, given.loss, given.queue_bytes)
        whole = [age_s for _, share, age_s in found["pushed"] if share == 1.0]
        ages = [age_s for _, _, age_s in found["pushed"]]
        shown = {"forces": len(ages), "least_s": min(ages), "oldest_s": max(ages), "oldest_whole_s": max(whole)}
        sys.stdout.write(json.dumps({**shown, "dropped": found["dropped"], "told": found["told"]}) + "\n")


if __name__ == "__main__":
    main()
