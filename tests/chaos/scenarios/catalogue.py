"""All faults, grouped into the scenarios that inject them."""

from __future__ import annotations

from chaos.harness.scenario import Scenario
from chaos.scenarios import (
    cluster_nodes,
    damaged_sources,
    ended_commands,
    event_targets,
    lost_camera_processes,
    lost_frames,
    lost_processes,
    scarce_resources,
)

__all__ = ["FAULTS"]

FAULTS: tuple[Scenario, ...] = (
    *damaged_sources.SCENARIOS,
    *lost_frames.SCENARIOS,
    *lost_processes.SCENARIOS,
    *lost_camera_processes.SCENARIOS,
    *ended_commands.SCENARIOS,
    *scarce_resources.SCENARIOS,
    *cluster_nodes.SCENARIOS,
    *event_targets.SCENARIOS,
)
