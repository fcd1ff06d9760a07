"""COCO: one JSON file for all streams, masks as run-length codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mlbs_actors.record.recorded_stream import recorded_stream, streams_of

__all__ = ["CATEGORY", "write_coco"]

#: The only category.
CATEGORY = 1


def write_coco(run: Path, out: Path) -> None:
    """Write the run's objects as COCO instances, with the keys that its extensions to videos have.

    Each stream that has a label map is a video, with its mean frame rate; ``track_id`` of an annotation is
    the layer's id, unique within its video.

    Parameters
    ----------
    run : Path
    out : Path
        The JSON file.
    """
    videos: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for name in streams_of(run):
        times: list[float] = []
        for frame in recorded_stream(run / name):
            if not times:
                size = {"width": frame.width, "height": frame.height}
                videos.append({"id": len(videos) + 1, "name": name, **size})
            times.append(frame.pts)
            image = {
                "id": len(images) + 1,
                "file_name": f"{name}/{frame.name}.png",
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
