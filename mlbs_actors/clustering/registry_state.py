"""The state of the layer registry: a row for each label that lives, sleeps or is on probation (§4)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mlbs_actors.clustering.label_index import UNLABELLED
from mlbs_actors.clustering.reidentification import SIGNATURE_BINS
from mlbs_actors.messages import Array

__all__ = ["RegistryState"]


@dataclass(frozen=True, slots=True)
class RegistryState:
    """All objects that live, sleep or are on probation, one in each row of the arrays.

    Attributes
    ----------
    labels : (k,) int64
        Ascending; candidates have labels < −1.
    born : (k,) int64
        Frame of birth.
    origins : (k,) int64
        Label of the object that it was split off or has appeared on, −1 if none.
    seen : (k,) int64
        Last frame awake; older than the newest frame = asleep.
    judged, moving : (k,) int64
        Clusterings since birth, and in how many of them it moved against the camera.
    rested : (k,) int64
        Clusterings since it last moved against the camera.
    spared : (k,) int64
        Clusterings in which it skips the N-cut test.
    tracked : (k,) int64
        Last frame with enough trajectories; a layer can stay awake a little longer on its published pixels.
    centroids, velocities : (k, 2) float64
        Mean position (px) and forward motion (px/frame) when last seen.
    signatures : (k, SIGNATURE_BINS³) float32
        Colours of its trajectories: a histogram that fades by a tenth a frame (0 before the first).
    pooled : (k,) bool
        Shares the layer "other".
    next_layer : int
        Next unused layer id.
    next_candidate : int
        Next unused candidate label, < −1.
    other : int
        Layer id of "other", −1 before it is needed.
    """

    labels: Array
    born: Array
    origins: Array
    judged: Array
    moving: Array
    rested: Array
    spared: Array
    seen: Array
    tracked: Array
    centroids: Array
    velocities: Array
    signatures: Array
    pooled: Array
    next_layer: int
    next_candidate: int
    other: int

    @staticmethod
    def empty() -> RegistryState:
        """Return the state without any object."""
        return RegistryState(
            labels=np.zeros(0, np.int64),
            born=np.zeros(0, np.int64),
            origins=np.zeros(0, np.int64),
            judged=np.zeros(0, np.int64),
            moving=np.zeros(0, np.int64),
            rested=np.zeros(0, np.int64),
            spared=np.zeros(0, np.int64),
            seen=np.zeros(0, np.int64),
            tracked=np.zeros(0, np.int64),
            centroids=np.zeros((0, 2)),
            velocities=np.zeros((0, 2)),
            signatures=np.zeros((0, SIGNATURE_BINS**3), np.float32),
            pooled=np.zeros(0, bool),
            next_layer=1,
            next_candidate=UNLABELLED - 1,
            other=-1,
        )

    def select(self, rows: Array) -> RegistryState:
        """Return the state with only some rows, in this order; a part of a forgotten object is none any more.

        Parameters
        ----------
        rows : (m,) int64 or (k,) bool
        """
        selected = replace(self, **{name: column[rows] for name, column in self._columns().items()})
        origins = np.where(np.isin(selected.origins, selected.labels), selected.origins, UNLABELLED)
        return replace(selected, origins=origins)

    def with_candidate(self, frame_index: int, origin: int) -> RegistryState:
        """Return the state with the next candidate in its first row.

        Parameters
        ----------
        frame_index : int
            Of its birth.
        origin : int
            Label of the object that it was split off or has appeared on, −1 if none.
        """
        begun = {
            "labels": self.next_candidate,
            "born": frame_index,
            "origins": origin,
            "seen": frame_index,
            "tracked": frame_index,
        }
        columns: dict[str, Any] = {}
        for name, column in self._columns().items():
            first = np.full((1, *column.shape[1:]), begun.get(name, 0), column.dtype)
            columns[name] = np.concatenate([first, column])
        return replace(self, **columns, next_candidate=self.next_candidate - 1)

    def with_lost(self, lost: RegistryState) -> RegistryState:
        """Return the state with the objects of another one too, whose labels are none of its own."""
        theirs = lost._columns()
        joined: dict[str, Any] = {
            name: np.concatenate([theirs[name], own]) for name, own in self._columns().items()
        }
        return replace(self, **joined).select(np.argsort(joined["labels"], kind="stable"))

    def _columns(self) -> dict[str, Any]:
        """Return the arrays by name."""
        values = ((one.name, getattr(self, one.name)) for one in fields(self))
        return {name: value for name, value in values if isinstance(value, np.ndarray)}
