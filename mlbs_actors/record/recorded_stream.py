"""A recorded stream, frame by frame: the input of every export.

The tables and masks are read with packages of the extra ``read``, which are imported when they are needed.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mlbs_actors.errors import ConfigError
from mlbs_actors.extras import needing
from mlbs_actors.messages import Array, LayerSummary
from mlbs_actors.record.edits import EDITS, NO_EDITS, Edits, read_edits
from mlbs_actors.record.frame_row import FrameRow
from mlbs_actors.record.scene_place import ScenePlace

__all__ = [
    "RecordedFrame",
    "description_of",
    "edits_of",
    "read_description",
    "recorded_stream",
    "streams_of",
]


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One frame that has a label map.

    Attributes
    ----------
    index : int
        Counts every frame of the source.
    pts : float
        Seconds since the source's first frame.
    name : str
        Of its mask file, without extension.
    height, width : int
        px.
    camera_motion : (float, float)
        px/frame, x before y.
    objects : tuple of LayerSummary
        In ascending id.
    codes : tuple of str
        Their masks as COCO's compressed run-length codes.
    pixel_aspect : float
        How wide a pixel is to be shown for its height.
    scene : ScenePlace, optional
        Where the zones are that are fixed to the scene.
    camera : tuple of float, optional
        Homography of the background, row by row, that takes its pixels to the frame before.
    """

    index: int
    pts: float
    name: str
    height: int
    width: int
    camera_motion: tuple[float, float]
    objects: tuple[LayerSummary, ...]
    codes: tuple[str, ...]
    pixel_aspect: float = 1.0
    scene: ScenePlace | None = None
    camera: tuple[float, ...] | None = None

    def labels(self) -> Array:
        """The label map, (H, W) uint16.

        Raises
        ------
        MissingPackageError
            Without the extra ``read``.
        """
        with needing("read"):
            from pycocotools import mask as coco_mask

        labels = np.zeros((self.height, self.width), np.uint16)
        for one, counts in zip(self.objects, self.codes, strict=True):
            code = {"size": [self.height, self.width], "counts": counts.encode("ascii")}
            labels[np.asarray(coco_mask.decode(code), dtype=bool)] = one.layer
        return labels


def read_description(run: Path) -> dict[str, Any] | None:
    """Read the ``run.json`` of a folder; None if it holds no run, or the file cannot be read."""
    try:
        description: dict[str, Any] = json.loads((run / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return description


def description_of(run: Path) -> dict[str, Any]:
    """Return the ``run.json`` of a run.

    Raises
    ------
    ConfigError
        If the folder holds no run, or its tables were not saved.
    """
    description = read_description(run)
    if description is None:
        raise ConfigError(f"{run} holds no run; name the folder given to --output.")
    if "parquet" not in description["save"]:
        raise ConfigError(f"The run in {run} has no tables to export; run it again with parquet in --save.")
    return description


def streams_of(run: Path) -> dict[str, str]:
    """Map the names of a run's streams, in the order of its list, to their addresses, passwords hidden.

    Raises
    ------
    ConfigError
        From :func:`description_of`.
    """
    return dict(description_of(run)["sources"])


def edits_of(folder: Path, path: Path | None = None) -> Edits:
    """Return the corrections of a stream, those of its ``edits.csv`` or of another file.

    Raises
    ------
    ConfigError
        If they are wrong; the message has the line.
    MissingPackageError
        Without the extra ``read``.
    """
    if path is None:
        path = folder / EDITS
        if not path.exists():
            return NO_EDITS
    with needing("read"):
        from mlbs_actors.record.record_tables import read_rows

    return read_edits(path, lambda: read_rows(folder))


def recorded_stream(folder: str | Path, edits: Edits | None = None) -> Iterator[RecordedFrame]:
    """Yield committed frames that have a label map, in order, one part of the tables at a time.

    Parameters
    ----------
    folder : str or Path
        Of the stream. A stream of a run that has not begun has none yet, and no frames.
    edits : Edits, optional
        Corrections of its ids; by default those of :func:`edits_of`.

    Raises
    ------
    ConfigError
        If there is no such stream, or its corrections are wrong.
    MissingPackageError
        Without the extra ``read``.
    """
    with needing("read"):
        from mlbs_actors.record.record_tables import read_rows

    folder = Path(folder)
    _refuse_no_stream(folder)
    edits = edits_of(folder) if edits is None else edits
    return _frames_of(edits.applied(read_rows(folder)))


def _refuse_no_stream(folder: Path) -> None:
    run = read_description(folder)
    if run is not None:
        names = ", ".join(run.get("sources", {})) or "none"
        raise ConfigError(f"{folder} is a run; name the folder of one of its streams: {names}.")
    if not folder.is_dir() and folder.name not in (read_description(folder.parent) or {}).get("sources", {}):
        raise ConfigError(f"There is no stream in {folder}; name the folder of a stream, OUTPUT/NAME.")


def _frames_of(rows: Iterable[FrameRow]) -> Iterator[RecordedFrame]:
    for row in rows:
        result = row.result
        if result is None or row.name is None:
            continue
        height, width = result.shape
        yield RecordedFrame(
            index=row.frame,
            pts=row.pts,
            name=row.name,
            height=height,
            width=width,
            camera_motion=result.camera_motion,
            objects=result.layers,
            codes=result.run_length_codes,
            pixel_aspect=result.pixel_aspect,
            scene=result.scene,
            camera=result.camera,
        )
