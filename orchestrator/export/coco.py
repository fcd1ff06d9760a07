"""COCO: one JSON file for all streams, masks as run-length codes."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mlbs_actors.errors import MlbsError
from mlbs_actors.record.recorded_stream import RecordedFrame, recorded_stream, streams_of
from orchestrator.sources.address import parse_address
from orchestrator.sources.presence import holds_images, images_of

__all__ = ["CATEGORY", "write_coco"]

#: The only category.
CATEGORY = 1


def write_coco(run: Path, out: Path) -> None:
    """Write the run's objects as COCO instances, with the keys that its extensions to videos have.

    Each stream that has a label map is a video, with its mean frame rate; ``track_id`` of an annotation is
    the layer's id, unique within its video; it is in its attributes, too, where CVAT looks for it. An image
    has the name of the picture that it is, from the folder on that all pictures of the run have in common;
    one of a video or camera, which is no file, that of its label map.

    Parameters
    ----------
    run : Path
    out : Path
        The JSON file.
    """
    videos: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    pictures = {name: _pictures_at(source) for name, source in streams_of(run).items()}
    shared = _shared_folder(pictures.values())
    for name, files in pictures.items():
        times: list[float] = []
        for frame in recorded_stream(run / name):
            if not times:
                size = {"width": frame.width, "height": frame.height}
                videos.append({"id": len(videos) + 1, "name": name, **size})
            times.append(frame.pts)
            image = {
                "id": len(images) + 1,
                "file_name": _file_name(files, frame, shared) or f"{name}/{frame.name}.png",
                "width": frame.width,
                "height": frame.height,
                "video_id": len(videos),
                "frame_id": frame.index,
                "seconds": frame.pts,
            }
            images.append(image)
            for one, code in zip(frame.objects, frame.codes, strict=True):
                region = one.region
                annotations.append(
                    {
                        "id": len(annotations) + 1,
                        "image_id": image["id"],
                        "video_id": len(videos),
                        "category_id": CATEGORY,
                        "track_id": one.layer,
                        "segmentation": {"size": [frame.height, frame.width], "counts": code},
                        "area": one.area,
                        "bbox": [region.x, region.y, region.width, region.height],
                        "score": one.score,
                        "iscrowd": 0,
                        "attributes": {"track_id": one.layer},
                    }
                )
        if times:
            span = times[-1] - times[0]
            videos[-1] |= {"length": len(times), "fps": round((len(times) - 1) / span, 4) if span else None}
    content = {
        "info": {"description": f"Moving objects of {run.resolve().name}, segmented by mlbs-actors"},
        "licenses": [],
        "categories": [{"id": CATEGORY, "name": "object"}],
        "videos": videos,
        "images": images,
        "annotations": annotations,
    }
    out.write_text(json.dumps(content), encoding="utf-8")


def _pictures_at(source: str) -> list[Path]:
    """Return the files that a stream's frames are, in order; none unless they are pictures that are there."""
    try:
        address = parse_address(source, Path())
        return images_of(address.location) if holds_images(address) else []
    except (MlbsError, OSError):
        return []


def _shared_folder(streams: Iterable[list[Path]]) -> Path | None:
    folders = {path.parent for files in streams for path in files}
    return Path(os.path.commonpath(folders)) if folders else None


def _file_name(files: list[Path], frame: RecordedFrame, shared: Path | None) -> str | None:
    """Return the name of the picture that a frame is; None if it is none, or not the one of then."""
    if shared is None or frame.index >= len(files) or files[frame.index].stem != frame.name:
        return None
    return str(files[frame.index].relative_to(shared))
