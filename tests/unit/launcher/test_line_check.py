"""What the line between two sites carries decides whether a session begins, and what is recorded where."""

from typing import Any

import msgspec
import pytest
from launcher_bench import SECOND_NS, TICK_NS, Rig
from telenano_wide_area.line_check import FULL_BIT_PER_S, LEAST_BIT_PER_S
from telenano_wide_area.transport import DATAGRAM

from telenano.testing.filled_messages import examples
from telenano.wire import TOPICS, LinkNetwork

MASTER = ("recorder@master", "delay_node@master", "controller@master", "haptic_node@master")
SLAVE = ("afm_node@slave", "controller@slave")
SITES: dict[str, Any] = {"own": MASTER, "others": SLAVE, "site": "master", "other_site": "slave"}
WIDE = 100_000_000
EXAMPLE = examples(TOPICS["link/network"])["ordinary"]


def report(direction: str, **line: Any) -> LinkNetwork:
    """Give a report of a direction, with what is known of its line."""
    changes = {"direction": direction, "line": "free", "limit_bit_per_s": 6_000_000, **line}
    return msgspec.structs.replace(EXAMPLE, **changes)  # type: ignore[return-value]


def begun(forward: int | None, backward: int | None, seconds: float = 1.0, **line: Any) -> Rig:
    """Give a rig whose nodes are ready, after some seconds of reports on a line of these capacities [bit/s]."""
    rig = Rig(30.0, **SITES, line_check=DATAGRAM.line_check)
    for _ in range(round(seconds * SECOND_NS / TICK_NS)):
        for direction, carries in (("forward", forward), ("backward", backward)):
            rig.receive(report(direction, capacity_bit_per_s=carries, **line), "link/network")
        rig.tick_alive(1)
    return rig


def test_a_wide_line_is_no_matter() -> None:
    rig = begun(WIDE, WIDE)
    assert rig.session.phase in ("arming", "running") and not any("Mbit/s" in text for text in rig.reports)


@pytest.mark.parametrize(("forward", "backward"), [(LEAST_BIT_PER_S - 1, WIDE), (WIDE, 256_000)])
def test_a_line_without_room_for_a_session_is_refused_with_the_numbers(forward: int, backward: int) -> None:
    rig = begun(forward, backward, 5.0)
    # what else crosses it at the start may make it seem so
    assert rig.session.phase == "starting"
    rig = begun(forward, backward, 11.0)
    assert rig.session.phase in ("ending", "over")
    assert "carries 0.5 Mbit/s" in rig.session.failure or "carries 0.26 Mbit/s" in rig.session.failure
    assert f"needs {LEAST_BIT_PER_S * 1e-6:g} Mbit/s each way" in rig.session.failure


def test_a_line_that_only_seemed_narrow_is_taken() -> None:
    rig = begun(LEAST_BIT_PER_S - 1, WIDE, 5.0)
    for _ in range(20):
        rig.receive(report("forward", capacity_bit_per_s=WIDE), "link/network")
        rig.tick_alive(1)
    assert (rig.session.failure, rig.session.phase in ("arming", "running")) == ("", True)


def test_a_narrow_line_is_named() -> None:
    rig = begun(1_000_000, 1_000_000, 4.0)
    assert rig.session.phase in ("arming", "running")
    parts = "carries 1 Mbit/s", f"needs {FULL_BIT_PER_S * 1e-6:g} Mbit/s each way"
    assert all(part in "\n".join(rig.reports) for part in parts)


def test_a_session_waits_until_the_line_is_in_use_again_and_not_for_ever() -> None:
    slow = {"line": "full", "limit_bit_per_s": 100_000}
    assert begun(1_000_000, 1_000_000, 5.0, **slow).session.phase == "starting"
    assert begun(1_000_000, 1_000_000, 11.0, **slow).session.phase in ("arming", "running")


def test_without_a_report_of_the_network_nothing_is_waited_for() -> None:
    rig = Rig(2.0, **SITES, line_check=DATAGRAM.line_check)
    rig.tick_alive(6)
    assert rig.session.phase == "running"
