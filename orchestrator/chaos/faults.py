"""All faults that are brought about, in the order of their numbers."""

from __future__ import annotations

from orchestrator.chaos import (
    damaged_sources,
    lost_camera_processes,
    lost_frames,
    lost_processes,
    scarce_resources,
)
from orchestrator.chaos.place import Fault

__all__ = ["FAULTS"]

FAULTS: tuple[Fault, ...] = tuple(
    sorted(
        damaged_sources.FAULTS
        + lost_processes.FAULTS
        + lost_camera_processes.FAULTS
        + lost_frames.FAULTS
        + scarce_resources.FAULTS,
        key=lambda fault: int(fault.number.split()[0]),
    )
)
