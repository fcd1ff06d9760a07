"""What one stream takes of a node, reserved with Ray: autoscalers and other jobs of the cluster see it.

The processes of a stream come and go with its objects, and a layer must never wait for Ray's scheduler. So
they ask for nothing one by one: a placement group reserves the share of all of them, and the stream's reader,
which is there from its start to its end, takes it.
"""

from __future__ import annotations

import time
import weakref
from dataclasses import dataclass
from itertools import count

import ray
from ray.util.placement_group import (
    PlacementGroup,
    placement_group,
    placement_group_table,
    remove_placement_group,
)
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy

__all__ = ["Reservation", "Share"]

#: Of this driver's reservations: Ray refuses a name that it has already.
_numbers = count(1)


@dataclass(frozen=True, slots=True)
class Share:
    """Share of a node.

    Attributes
    ----------
    cpus : float
        As Ray counts them.
    memory : int
        Bytes.
    """

    cpus: float
    memory: int

    @property
    def bundle(self) -> dict[str, float]:
        """The share as Ray's resources."""
        return {"CPU": self.cpus, "memory": self.memory}


class Reservation:
    """A share of one node; asked for at once, and granted as soon as Ray has it free.

    It ends with :attr:`release`, when this object is dropped, or with the driver.

    Parameters
    ----------
    share : Share
    node : str
        Ray's id of the node.

    Attributes
    ----------
    since : float
        When it was asked for, monotonic, s.
    release : callable
        Returns the share, and ends the actor that takes it. May be called twice.
    """

    def __init__(self, share: Share, node: str) -> None:
        self.since = time.monotonic()
        self._share = share
        self._group = placement_group(
            [share.bundle],
            strategy="STRICT_PACK",
            name=f"mlbs-actors-{next(_numbers)}",
            bundle_label_selector=[{"ray.io/node-id": node}],
        )
        self._granted = False
        self.release = weakref.finalize(self, _remove, self._group)
        self.release.atexit = False  # Ray removes the groups of a driver that has ended

    @property
    def granted(self) -> bool:
        """Whether the share is reserved by now."""
        self._granted = self._granted or placement_group_table(self._group)["state"] == "CREATED"
        return self._granted

    def options(self) -> dict[str, object]:
        """Return Ray's options of the actor that takes the share; it waits until that is granted."""
        return {
            "num_cpus": self._share.cpus,
            "memory": self._share.memory,
            "scheduling_strategy": PlacementGroupSchedulingStrategy(self._group),
        }


def _remove(group: PlacementGroup) -> None:
    if ray.is_initialized():
        remove_placement_group(group)
