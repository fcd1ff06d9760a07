"""A camera whose record is in segments, with frames as quick as they can be written and times of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from record_fakes import frame, segmentation

from mlbs_actors.actors.stream.protocol import Snapshot
from mlbs_actors.state_file import capture
from orchestrator.events.zones import EventRules
from orchestrator.sinks.record import StreamRecord

#: 2026-11-27T14:00:00Z, when the camera's first frame is taken; it sends ten a second.
BEGAN = 1_795_788_000
SECONDS = 10
SAVE = frozenset({"masks", "parquet", "overlay", "cutouts"})


@dataclass(frozen=True)
class Rows:
    rows: int


class Camera:
    """Writes frames into a record as they come, with a snapshot after every 20th."""

    def __init__(
        self,
        folder: Path,
        save: frozenset[str] = SAVE,
        *,
        rate: float = 10.0,
        seconds: int | None = SECONDS,
        began: float = BEGAN,
        rules: EventRules | None = None,
    ) -> None:
        self._rate = rate
        self._began = began
        self.now = began
        self.record = StreamRecord(
            folder,
            folder.name,
            save,
            live=True,
            rules=rules,
            segment_seconds=seconds,
            clock=lambda: self.now,
        )
        before = self.record.opening.resume_from
        self.rows = 0 if before is None else before.rows

    def send(self, end: int) -> None:
        """Send frames to before ``end``; in every other ten there is a second object, a new one each 1000."""
        for index in range(self.rows, end):
            pts = index / self._rate
            self.now = self._began + pts
            objects = [5 + index // 1000] if index // 10 % 2 else []
            self.record.write(segmentation(index, 3, *objects), replace(frame(index), pts=pts))
            self.rows = index + 1
            if self.rows % 20 == 0:
                assert self.record.keep(self._snapshot())

    def _snapshot(self) -> Snapshot:
        assert self.record.opening.snapshots is not None
        folder = self.record.opening.snapshots / f"{self.rows:08d}"
        folder.mkdir(parents=True)
        capture(Rows(self.rows)).write(folder / "one")
        return Snapshot(folder, self.rows, self.rows, ("one",))
