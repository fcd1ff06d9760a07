"""The life of layers: births, dormancy, return, retirement, and the cap (§4).

Two things are kept apart here: a *label* is what a cluster of trajectories carries in the coordinator (0 the
background, > 0 a layer, −1 none, < −1 a candidate on probation); a *layer id* is never reused and is what the
engine's label map shows. They differ for the objects past the cap, which share one layer "other".

Differs from the paper: it creates a layer whenever the N-cut splits a cluster and drops it with its last
trajectory; here a split must last a few frames first. A part split off an object (a limb, a head, the body
that rests while the head turns) stays with it for longer before it becomes an object of its own. A layer that
loses its trajectories sleeps for a while and is woken when a new cluster of like colours appears where it is
expected, and the number of layers is bounded.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from mlbs_actors.clustering.label_index import UNLABELLED, distinct_labels
from mlbs_actors.clustering.label_lookup import layers_of, sightings
from mlbs_actors.clustering.registry_state import RegistryState
from mlbs_actors.clustering.reidentification import (
    Sighting,
    colour_odds,
    colour_signatures,
    return_odds,
)
from mlbs_actors.config import Config
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["RESTED_CLUSTERINGS", "LayerRegistry"]

#: An object rests if it has not moved in so many clusterings: in one it may just be slow.
RESTED_CLUSTERINGS = 3


class LayerRegistry:
    """Decides which labels are layers; see the module's docstring.

    Parameters
    ----------
    shape : (H, W)
        Of the frame, px.
    state : RegistryState, optional
        To continue from; a new registry by default.
    """

    def __init__(self, config: Config, shape: tuple[int, int], state: RegistryState | None = None) -> None:
        self.config = config.layers
        self.identity = config.identity
        self.shape = shape
        self.state = state or RegistryState.empty()

    def judge(self, speeds: Mapping[int, float], least: float) -> None:
        """Record at a clustering which labels move against the camera.

        Parameters
        ----------
        speeds : mapping of int to float
            Label → its speed against the camera, px/frame; for all labels that have trajectories.
        least : float
            Speed of an object, px/frame.
        """
        state = self.state
        labels = state.labels.tolist()
        judged = np.array([label in speeds for label in labels], bool)
        moving = np.array([speeds.get(label, -np.inf) >= least for label in labels], bool)
        self.state = replace(
            state,
            judged=state.judged + judged,
            moving=state.moving + moving,
            rested=np.where(moving, 0, state.rested + judged),
        )

    def spared_labels(self) -> Array:
        """Return labels (m,) int64 of objects that skip the N-cut test at this clustering."""
        return np.asarray(self.state.labels[self.state.spared > 0])

    def spare(self, firm: Array) -> None:
        """Record which labels passed the N-cut test firmly.

        Parameters
        ----------
        firm : (m,) int64
            Labels that hold together firmly, from :func:`~mlbs_actors.clustering.splitting.split_labels`.
            Objects among them skip the test at the next clusterings: parts separate slowly.
        """
        state = self.state
        proven = (state.labels > BACKGROUND) & np.isin(state.labels, firm)
        fewer, most = np.maximum(state.spared - 1, 0), self.config.spared_clusterings
        self.state = replace(state, spared=np.where(proven, most, fewer))

    def ages(self, frame_index: int) -> dict[int, int]:
        """Return the frames since birth of every label, the background being older than all.

        A label that has hardly moved in all its life stays as young as on its first frame: foreground parts
        of a static scene can look like an object for a while, and would remain one for ever. One that has
        moved often enough is an object however long it rests.
        """
        state, config = self.state, self.config
        proven = state.moving >= np.minimum(config.least_moving * state.judged, config.moving_clusterings)
        ages = np.where(proven, frame_index - state.born, 0)
        known = {int(label): int(age) for label, age in zip(state.labels, ages, strict=True)}
        return {**known, BACKGROUND: np.iinfo(np.int64).max}

    def layer_labels(self) -> set[int]:
        """Return the labels that are layers, awake or asleep."""
        return set(self.state.labels[self.state.labels > BACKGROUND].tolist())

    def known_labels(self) -> set[int]:
        """Return the labels of all layers and candidates."""
        return set(self.state.labels.tolist())

    def parts(self) -> set[int]:
        """Return the labels that were split off an object, or have appeared on one."""
        return set(self.origins())

    def origins(self) -> dict[int, int]:
        """Map each label that was split off an object, or has appeared on one, to that object."""
        rows = zip(self.state.labels.tolist(), self.state.origins.tolist(), strict=True)
        return {label: origin for label, origin in rows if origin != UNLABELLED}

    def live_layers(self, frame_index: int) -> tuple[int, ...]:
        """Return layer ids awake at the newest frame or a held one, without the background; ascending."""
        state = self.state
        awake = (state.labels > 0) & (state.born <= frame_index) & (state.seen >= frame_index)
        return tuple(sorted(set(self.layers_of(state.labels[awake]).tolist())))

    def lasting_layers(self) -> set[int]:
        """Return the layers, but "other", that are objects however long they rest: they have moved often."""
        state = self.state
        lasting = (state.labels > BACKGROUND) & ~state.pooled & self._has_moved_often()
        return set(state.labels[lasting].tolist())

    def resting_layers(self) -> tuple[int, ...]:
        """Return the layers, but "other", that have not moved for ``RESTED_CLUSTERINGS``; ascending."""
        state = self.state
        resting = (state.labels > BACKGROUND) & ~state.pooled & (state.rested >= RESTED_CLUSTERINGS)
        return tuple(state.labels[resting].tolist())

    def layers_of(self, labels: Array) -> Array:
        """Return layer ids of labels, (n,) int64, −1 for none.

        A candidate split off an object belongs to its layer until it has one of its own.
        """
        state = self.state
        return np.asarray(layers_of(labels, state.labels, state.origins, state.pooled, state.other))

    def forget(self, merged: Mapping[int, int]) -> None:
        """Drop labels that were merged into others, so that they cannot wake.

        Parameters
        ----------
        merged : mapping of int to int
            Label → the one that it was merged into; its parts now belong to that. An object that was merged
            into the background is kept as long as it has other parts, and lives on in them.
        """
        state = self.state
        parts = [
            origin
            for label, origin in zip(state.labels.tolist(), state.origins.tolist(), strict=True)
            if label < UNLABELLED and label not in merged
        ]
        merged = {one: into for one, into in merged.items() if into != BACKGROUND or one not in parts}
        if not merged:
            return
        objects = self._objects()
        origins = [objects.get(merged.get(one, one), UNLABELLED) for one in self.state.origins.tolist()]
        self.state = replace(self.state, origins=np.array(origins, np.int64))
        self.state = self.state.select(~np.isin(self.state.labels, list(merged)))

    def unknown(self, labels: Array) -> set[int]:
        """Return the labels among ``labels`` (n,) int64 that are new."""
        return distinct_labels(labels) - self.known_labels() - {BACKGROUND, UNLABELLED}

    def admit(self, labels: Array, frame_index: int, origins: Mapping[int, int]) -> Array:
        """Replace the labels that are new since the last frame by candidate labels.

        Parameters
        ----------
        labels : (n,) int64
            Unknown labels ≥ 0 are taken for new clusters.
        frame_index : int
        origins : mapping of int to int
            New label → the object, or part of one, that it was split off or has appeared on.

        Returns
        -------
        (n,) int64
        """
        objects = self._objects()
        for label in sorted(self.unknown(labels)):
            labels = np.where(labels == label, self.state.next_candidate, labels)
            origin = objects.get(origins.get(label, UNLABELLED), UNLABELLED)
            self.state = self.state.with_candidate(frame_index, origin)
        return labels

    def _has_moved_often(self) -> Array:
        """Return for each row whether it is an object however long it rests, (k,) bool."""
        return np.asarray(self.state.moving >= self.config.moving_clusterings)

    def _objects(self) -> dict[int, int]:
        """Map each label to the object that it is, or belongs to as a candidate; −1 if none."""
        labels, origins = self.state.labels.tolist(), self.state.origins.tolist()
        return {
            label: label if label > BACKGROUND else origin
            for label, origin in zip(labels, origins, strict=True)
        }

    def observe(
        self,
        labels: Array,
        positions: Array,
        motions: Array,
        colours: Array,
        frame_index: int,
        published: Collection[int],
    ) -> Array:
        """Record where a frame's labels are; put those without trajectories to sleep, and forget old ones.

        Parameters
        ----------
        labels : (n,) int64
            From :meth:`admit`.
        positions, motions : (n, 2) float32
            Positions and backward motions of the trajectories, px.
        colours : (n, 3) uint8
            The frame's colours there.
        frame_index : int
        published : collection of int
            Layers that own pixels in the newest label map available. A layer with too few trajectories stays
            awake on them for ``coast_frames``.

        Returns
        -------
        (n,) int64
            Trajectories of labels that have too few are −1.
        """
        state = self.state
        rows, counts, means = sightings(state.labels, labels, positions, motions)
        enough: Array = counts >= self.config.min_tracks
        state.seen[enough] = state.tracked[enough] = frame_index
        state.centroids[enough], state.velocities[enough] = means[enough, :2], -means[enough, 2:]
        fresh, known = colour_signatures(rows, colours, len(state.labels))[enough], state.signatures[enough]
        # A frame has weight 0.1, the first one weight 1.
        share = np.where(known.any(axis=1), np.float32(0.1), np.float32(1))[:, None]
        state.signatures[enough] = np.float32(0.9) * known + share * fresh
        coasting: Array = ~enough & (state.labels > 0) & (state.seen == frame_index - 1)
        coasting &= frame_index - state.tracked <= self.config.coast_frames
        if coasting.any():
            coasting[coasting] = np.isin(self.layers_of(state.labels[coasting]), list(published))
        state.seen[coasting] = frame_index
        awake: Array = np.append(enough | coasting, True)  # the last for those of no known label
        labels = np.where(awake[rows], labels, UNLABELLED)
        asleep = frame_index - state.seen
        longest = np.where(self._has_moved_often(), np.inf, self.config.fleeting_frames)
        remembered = asleep <= np.minimum(longest, self.config.dormant_frames)
        keep = np.where(state.labels > 0, remembered, asleep == 0)
        if not keep.all():
            self.state = self.state.select(keep)
        if not self.state.pooled.any():
            self.state = replace(
                self.state, other=-1
            )  # the next "other" is another layer: ids are never reused
        return labels

    def promote(self, labels: Array, frame_index: int, probation: int, parted: Collection[int]) -> Array:
        """Make layers of the candidates that have lasted, and enforce the cap.

        Parameters
        ----------
        labels : (n,) int64
            From :meth:`observe`, after a clustering: only clusterings count for a candidate.
        frame_index : int
        probation : int
            Frames that a candidate must have lasted to become a layer; one split off an object must have
            lasted for ``part_probation_frames``. One whose object has lost all other trajectories becomes
            that object.
        parted : collection of int
            Candidates that are another thing than the object that they were split off, and no part of it.

        Returns
        -------
        (n,) int64
        """
        labels = labels.copy()
        for label in self.state.labels[self.state.labels < UNLABELLED][::-1]:
            # Looked up anew for each: the first part of a lost object becomes that object.
            row = int(np.flatnonzero(self.state.labels == label)[0])
            bereft = self._bereft(row, frame_index) is not None
            is_part = self.state.origins[row] != UNLABELLED
            if is_part and (
                int(label) in parted or (not bereft and self._returning(row, frame_index) is not None)
            ):
                self.state.origins[row], is_part = UNLABELLED, False
            awaited = self.config.part_probation_frames if is_part else probation
            lasted = frame_index - self.state.born[row] >= awaited
            if lasted or bereft:
                labels[labels == label] = self._promote(int(label), frame_index)
        self._keep_cap(labels, frame_index)
        return labels

    def _promote(self, candidate: int, frame_index: int) -> int:
        """Make a candidate a layer: the sleeping one that it matches, or else a new one."""
        state = self.state
        row = int(np.flatnonzero(state.labels == candidate)[0])
        sleeper = self._bereft(row, frame_index)
        if sleeper is None:
            sleeper = self._returning(row, frame_index)
        if sleeper is None:
            label, born, pooled = state.next_layer, state.born[row], False
            state = replace(state, next_layer=state.next_layer + 1)
        else:
            label, born, pooled = int(state.labels[sleeper]), state.born[sleeper], bool(state.pooled[sleeper])
            state.origins[row] = state.origins[sleeper]
            state.judged[row] += state.judged[sleeper]
            state.moving[row] += state.moving[sleeper]
        state.labels[row], state.born[row], state.pooled[row] = label, born, pooled
        self.state = state
        rows = np.argsort(state.labels, kind="stable")
        self.state = self.state.select(rows if sleeper is None else rows[rows != sleeper])
        return label

    def _returning(self, row: int, frame_index: int) -> int | None:
        """Return the row of the lost object that a candidate is, None if it is none.

        What appears on an object, from behind it, say, must be likelier the lost one than part of that.
        """
        state = self.state
        lost = np.flatnonzero((state.labels > BACKGROUND) & (state.tracked < frame_index))
        if not lost.size:
            return None
        columns = (state.tracked, state.centroids, state.velocities, state.signatures)
        odds = return_odds(
            state.centroids[row],
            state.signatures[row],
            Sighting(*(column[lost] for column in columns)),
            frame_index,
            self.shape,
            self.identity,
        )
        least = 0.0
        if state.origins[row] != UNLABELLED:
            origin = int(np.flatnonzero(state.labels == state.origins[row])[0])
            part = colour_odds(state.signatures[row], state.signatures[origin], self.identity)
            least = part + self.identity.apart
        best = int(odds.argmax())
        return int(lost[best]) if odds[best] > least else None

    def _bereft(self, row: int, frame_index: int) -> int | None:
        """Return the object a candidate was split off, if that has no trajectories and lives on in it."""
        state = self.state
        if state.labels[row] > BACKGROUND or state.origins[row] == UNLABELLED:
            return None
        origin = int(np.flatnonzero(state.labels == state.origins[row])[0])
        return origin if state.tracked[origin] < frame_index else None

    def _keep_cap(self, labels: Array, frame_index: int) -> None:
        """Move the smallest objects past the cap into the layer "other", for the rest of their lives."""
        room = self.config.max_layers - 2  # one each for the background and "other"
        while True:
            state = self.state
            single = np.flatnonzero((state.labels > 0) & ~state.pooled & (state.seen == frame_index))
            if len(single) <= room + (state.other < 0):
                return
            if state.other < 0:
                self.state = state = replace(state, other=state.next_layer, next_layer=state.next_layer + 1)
            sizes = [int((labels == state.labels[row]).sum()) for row in single]
            state.pooled[single[int(np.lexsort((-state.labels[single], np.array(sizes)))[0])]] = True
