"""The coupling of each device live in its servo, behind its real wire and a drive that is 5 ms late: its critical K."""

import itertools
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from coupling_theory import critical_stiffness
from telenano_devices.doubles import libraries
from telenano_devices.doubles.live_devices import LiveDevice
from telenano_devices.impedance.coupling import ZERO, CouplingSettings, Gate
from telenano_devices.impedance.servo import ServoCommand, ServoSample
from telenano_devices.impedance.servo_process import ProcessLink

pytestmark = [pytest.mark.endurance, pytest.mark.skipif(**libraries.WITHOUT_CC)]

LATE_S, PERIOD_S = 5e-3, 1e-3
# B [N s/m] far below what the delay bears, and how many sample times a force waits beside that
DAMPING = {"haply": (4.0, 1.0), "dhd": (4.0, 0.0), "hd": (1.0, 0.0)}
SHARES = (0.8, 0.9, 1.1, 1.2)
NUDGE_M, WATCHED_S = 1.5e-3, 2.5
# between what encoders resolve and where the workspace or the clamp would end it
SEEN_M, MOST_M = 2e-4, 1.2e-2
# A servo whose steps came late more often than this was held up.
LATE_SHARE = 0.02


class Node:
    """The node's side of a servo: a command each millisecond."""

    def __init__(self, link: ProcessLink, damping_n_s_per_m: float) -> None:
        self.link, self._damping, self._count = link, damping_n_s_per_m, 0
        self.reference_m = 0.0
        self.newest = ServoSample()

    def run(self, duration_s: float, stiffness_n_per_m: float) -> list[tuple[float, float]]:
        """Return times of samples and places [s, m]."""
        settings = CouplingSettings(
            (0.0, 0.0, stiffness_n_per_m),
            (0.5, 0.5, self._damping),
            self.link.capabilities.max_force_n,
            1e6,
            rest_s=0.02,
            frozen_s=0.0,
            jump_m=0.05,
            runaway_m_per_s=10.0,
        )
        found = []
        due_s = end_s = time.monotonic()
        end_s += duration_s
        while due_s < end_s:
            due_s += PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            self._count += 1
            self.newest = self.link.newest(-1.0, PERIOD_S) or self.newest
            engaged = self.newest.gate <= Gate.ACTIVE + 1 and not self.newest.error
            place = (0.0, 0.0, self.reference_m)
            self.link.send(
                ServoCommand(self._count, time.monotonic_ns(), place, ZERO, ZERO, engaged, 0, False, settings)
            )
            found.append((self.newest.taken_ns * 1e-9, self.newest.position_m[2] - self.reference_m))
        return found


def growth_per_s(motion: list[tuple[float, float]]) -> float:
    """Return by what the peaks of a swing grow [1/s], from a line through their logarithms."""
    peaks = [
        (at_s, abs(place))
        for (_, before), (at_s, place), (_, after) in zip(motion, motion[1:], motion[2:], strict=False)
        if abs(before) <= abs(place) > abs(after) and abs(place) > SEEN_M
    ]
    kept = list(itertools.takewhile(lambda peak: peak[1] < MOST_M, peaks))
    assert len(kept) >= 8, kept
    times, sizes = np.array(kept).T
    return float(np.polyfit(times, np.log(sizes), 1)[0])


@pytest.mark.parametrize("kind", ["haply", "dhd", "hd"])
def test_critical_stiffness_is_that_of_theory_behind_a_late_drive(kind: str, tmp_path: Path) -> None:
    damping, waits = DAMPING[kind]
    with LiveDevice(kind, tmp_path) as device:
        device.do("drive_delay_s", LATE_S)
        link = ProcessLink(kind, device.settings)
        link.open()
        try:
            able = link.capabilities
            arm = (able.mass_kg, able.damping_n_s_per_m)
            theory = critical_stiffness(arm, able.rate_hz, damping, waits + LATE_S * able.rate_hz)
            node = Node(link, damping)
            begun = node.run(0.5, 0.2 * theory)
            assert begun and node.newest.gate == Gate.ACTIVE
            first, rates = node.newest, []
            for share in SHARES:
                node.run(0.8, 0.2 * theory)
                node.reference_m += NUDGE_M
                rates.append(growth_per_s(node.run(WATCHED_S, share * theory)))
            late = (node.newest.late - first.late) / (node.newest.counter - first.counter)
        finally:
            link.close()
    slope, offset = np.polyfit(SHARES, rates, 1)
    found = -offset / slope
    text = (
        f"critical K of {able.identity} with a drive {LATE_S * 1e3:g} ms late: {found * theory:.0f} N/m, by theory "
        f"{theory:.0f}, ratio {found:.3f}; growth {', '.join(f'{rate:+.2f}' for rate in rates)} 1/s; {late:.2%} late"
    )
    sys.stdout.write(f"{text}\n")
    if late > LATE_SHARE:
        pytest.skip(f"the servo was held up: {text}")
    assert found == pytest.approx(1.0, abs=0.1, rel=0.0)
    assert rates == sorted(rates) and rates[0] < 0.0 < rates[-1]
