"""Whether a disk has room for what a session is expected to record."""

from collections.abc import Callable
from pathlib import Path

from services.launcher.plan import Plan
from services.recorder.config import RecorderConfig
from services.recorder.disk_watch import free_bytes

# A whole rig records so much in a second, by compression; the figures are measured, with a margin of a fifth.
_BYTES_PER_S = {"zstd": 600_000, "lz4": 1_200_000, "none": 3_500_000}


def disk_warning(plan: Plan, free: Callable[[Path], int | None] = free_bytes) -> str:
    """Return a sentence when the disk has less room than the recording of a session is expected to take; else empty.

    None for a recorder that is set to record less, or in snapshots: how much it will write is not known.
    """
    recorders = [node for node in plan.nodes if node.startswith("recorder@")]
    config = plan.loaded.section("recorder", RecorderConfig)
    if not recorders or config.topics or config.exclude or config.snapshot_s is not None:
        return ""
    needed = round(_BYTES_PER_S[config.compression] * plan.scenario.duration_s)
    needed = min(needed, config.quota_bytes or needed)
    left = free(plan.out)
    if left is None or left >= needed:
        return ""
    return (
        f"the disk of {plan.out} has {left / 1e6:.1f} MB left, and a session of {plan.scenario.duration_s:g} s takes "
        f"about {needed / 1e6:.1f} MB: the recording may end before the session; give another --out"
    )
