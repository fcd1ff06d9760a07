"""The snapshots of a stream, in its coordinator: when one is due, its files, and the way back to it."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from mlbs_actors.actors.ipc.shared_memory import Shared
from mlbs_actors.actors.parts import CoordinatorPart
from mlbs_actors.actors.stream.account import StreamAccount
from mlbs_actors.actors.stream.live_layers import LiveLayers
from mlbs_actors.actors.stream.protocol import Snapshot, StreamSpec
from mlbs_actors.actors.stream.saved_states import (
    CONDUCTOR_FILE,
    COORDINATOR_FILE,
    PUBLISHED_FILE,
    SEGMENTER_FILE,
    ConductorState,
    StateWriter,
    layer_file,
)
from mlbs_actors.actors.stream.segmenter_actor import Labelling
from mlbs_actors.actors.stream.sink import Record
from mlbs_actors.messages import Segmentation
from mlbs_actors.source import SourceFrame
from mlbs_actors.state_file import read_state

__all__ = ["StreamSnapshots"]


class StreamSnapshots:
    """Has all parts of a stream write their states after the same frame, or go back to them.

    Parameters
    ----------
    spec : StreamSpec
    part : CoordinatorPart
    layers : LiveLayers
    labelling : Labelling
    account : StreamAccount
    record : Record
    """

    def __init__(
        self,
        spec: StreamSpec,
        part: CoordinatorPart,
        layers: LiveLayers,
        labelling: Labelling,
        account: StreamAccount,
        record: Record,
    ) -> None:
        self._spec = spec
        self._part = part
        self._layers = layers
        self._labelling = labelling
        self._account = account
        self._record = record
        self._folder: Path | None = None
        self._saved = 0  # rows of the source before the newest one
        self._next = sys.maxsize
        self._earliest = 0.0  # the first one depends on its rows only
        self._writer = StateWriter()
        self._restored: str | None = None  # the parameters of the snapshot

    def restore(self, folder: Path) -> tuple[tuple[SourceFrame, ...], dict[int, Shared[Segmentation]]]:
        """Take all parts back to a snapshot, before :meth:`begin`.

        Returns
        -------
        waiting : tuple of SourceFrame
            Read and not yet labelled at that time, in source order.
        published : dict of int to Shared
            The newest label maps at that time by their frame.

        Raises
        ------
        SnapshotError, RayError
            If a state cannot be read, here or in the segmenter.
        """
        state = read_state(folder / CONDUCTOR_FILE, ConductorState)
        self._part.state = read_state(folder / COORDINATOR_FILE, type(self._part.state))
        self._layers.restore(state.layers)
        self._account.restore(state.counts, state.position)
        self._saved = state.position.rows
        self._restored = state.config
        if self._spec.motion is not None:
            self._spec.motion.followed = state.followed
        return state.waiting, self._labelling.restore(folder, state.layers)

    @property
    def is_of_other_parameters(self) -> bool:
        """Whether the snapshot was made with other parameters than those of now."""
        return self._restored not in (None, self._spec.config.model_dump_json())

    def begin(self, folder: Path | None) -> None:
        """Have snapshots written into a folder from now on; None for none."""
        self._folder = folder
        self._await_next()

    @property
    def are_wanted(self) -> bool:
        """Whether there is a folder for them."""
        return self._folder is not None

    def are_due(self) -> bool:
        """Whether the next one is to be written now."""
        return self._progressed >= self._next and time.monotonic() >= self._earliest

    def are_current(self) -> bool:
        """Whether the newest one covers all that the source has delivered."""
        return self._saved == self._account.position.rows

    def save(self, waiting: tuple[SourceFrame, ...]) -> None:
        """Have every part write its state, all after the same frame, while the work continues.

        Parameters
        ----------
        waiting : tuple of SourceFrame
            Read and not yet labelled, in source order.
        """
        assert self._folder is not None
        self._await_next()
        if not self._spec.live:
            self._earliest = time.monotonic() + self._spec.snapshot_seconds
        folder = self._folder / f"{self._account.position.rows:08d}"
        self._labelling.save(folder)
        layers = self._layers.state()
        config = self._spec.config.model_dump_json()
        followed = () if self._spec.motion is None else self._spec.motion.followed
        own = ConductorState(self._account.counts, self._account.position, waiting, layers, config, followed)
        self._writer.write({CONDUCTOR_FILE: own, COORDINATOR_FILE: self._part.state}, folder)
        shared = (CONDUCTOR_FILE, COORDINATOR_FILE, SEGMENTER_FILE, PUBLISHED_FILE)
        parts = (*shared, *(layer_file(one.layer) for one in layers))
        self._record.submit_snapshot(Snapshot(folder, self._record.rows, self._record.label_maps, parts))
        self._saved = self._account.position.rows

    def finish(self) -> None:
        """Wait until the coordinator's own files have been handed to the disk."""
        self._writer.finish()

    def _await_next(self) -> None:
        every = self._spec.snapshot_rows
        self._next = (self._progressed // every + 1) * every if self.are_wanted else sys.maxsize

    @property
    def _progressed(self) -> int:
        """The count that snapshots depend on: most rows of a live source can be drops, which cost no work."""
        return self._record.label_maps if self._spec.live else self._record.rows
