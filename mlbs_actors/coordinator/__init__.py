"""The coordinator of one stream: follows trajectories, clusters them, and decides which layers live (§3, §4).

Read in this order: ``gate`` (what becomes of a frame), ``matching`` (how the last picture goes on in it),
``advance`` (the trajectories' labels, and when they are clustered), ``labelling`` (one clustering),
``held_frames`` and ``evidence`` (what the layers are sent), and ``coordinator``, which puts them together;
all that they share is in ``state``.
"""

from mlbs_actors.coordinator.coordinator import Coordinator
from mlbs_actors.coordinator.state import CoordinatorState

__all__ = ["Coordinator", "CoordinatorState"]
