"""DAVIS and YouTube-VOS: folders of indexed PNG files, with the lists that their readers need."""

from __future__ import annotations

import json
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import recorded_stream, streams_of
from orchestrator.sinks.label_image import LARGEST_INDEXED_LABEL, encode_label_image

__all__ = ["write_davis", "write_youtube_vos"]


def write_davis(run: Path, out: Path) -> None:
    """Write ``Annotations/480p/STREAM/FRAME.png`` and ``ImageSets/2017/val.txt``.

    The folder is called 480p whatever the size of the frames, because readers of DAVIS look there.

    Parameters
    ----------
    run : Path
    out : Path
        An existing folder.

    Raises
    ------
    ConfigError
        If a layer's id does not fit into the format; from :func:`write_youtube_vos` too.
    """
    written = [name for name in streams_of(run) if _write_masks(run / name, out / "Annotations/480p" / name)]
    (out / "ImageSets/2017").mkdir(parents=True)
    (out / "ImageSets/2017/val.txt").write_text("".join(f"{name}\n" for name in written), encoding="utf-8")


def write_youtube_vos(run: Path, out: Path) -> None:
    """Write ``Annotations/STREAM/FRAME.png`` and ``meta.json``; parameters and errors as for DAVIS."""
    videos = {}
    for name in streams_of(run):
        seen = _write_masks(run / name, out / "Annotations" / name)
        if seen:
            objects = {
                str(layer): {"category": "object", "frames": frames} for layer, frames in sorted(seen.items())
            }
            videos[name] = {"objects": objects}
    (out / "meta.json").write_text(json.dumps({"videos": videos}), encoding="utf-8")


def _write_masks(stream: Path, folder: Path) -> dict[int, list[str]]:
    """Write one mask per frame; return the frames of every object, {} if there is no frame."""
    seen: dict[int, list[str]] = {}
    for frame in recorded_stream(stream):
        folder.mkdir(parents=True, exist_ok=True)
        for one in frame.objects:
            if one.layer > LARGEST_INDEXED_LABEL:
                raise ConfigError(
                    f"Indexed masks have no place for layer {one.layer} of {stream.name!r}, only for ids "
                    f"up to {LARGEST_INDEXED_LABEL}; export to coco."
                )
            seen.setdefault(one.layer, []).append(frame.name)
        (folder / f"{frame.name}.png").write_bytes(encode_label_image(frame.labels()))
    return seen
