"""Overlays drawn anew from the record and the source: the labels over the video."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import description_of, streams_of
from mlbs_actors.wording import count_of
from orchestrator.events.zones import Zone
from orchestrator.export.replay import with_pictures
from orchestrator.pictures.content import DEFAULT_DRAWING, Drawing
from orchestrator.pictures.privacy import is_private
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sinks.overlay import OverlayVideo, overlay_remarks
from orchestrator.sinks.record import recorded_frames
from orchestrator.sources.address import SourceAddress, parse_address

__all__ = ["draw_overlay", "write_overlays"]


def write_overlays(run: Path, out: Path) -> list[str]:
    """Write ``STREAM.mp4`` for each stream that has label maps, with progress on standard error.

    Parameters
    ----------
    run : Path
    out : Path
        An existing folder.

    Returns
    -------
    list of str
        Sentences about streams whose overlay is missing or incomplete.

    Raises
    ------
    ConfigError
        If no source can be read again.
    """
    remarks = []
    drawing = Drawing(private=is_private(description_of(run)))
    for name, source in streams_of(run).items():
        if recorded_frames(run / name):
            remarks += draw_overlay(run / name, source, out / f"{name}.mp4", drawing=drawing)
    if not any(out.glob("*.mp4")):
        raise ConfigError(" ".join(remarks) or f"The run in {run} has no label maps to draw.")
    return remarks


def draw_overlay(
    stream: Path, source: str, path: Path, zones: Sequence[Zone] = (), drawing: Drawing = DEFAULT_DRAWING
) -> list[str]:
    """Draw the overlay of one stream.

    Parameters
    ----------
    stream : Path
        Folder of the stream.
    source : str
        Its address.
    path : Path
        The mp4 file; there is none if no frame can be drawn.
    zones : sequence of Zone
        Drawn over every frame.
    drawing : Drawing
        What is drawn beside them.

    Returns
    -------
    list of str
        What is missing, and why.
    """
    overlay, drawn, missing = OverlayVideo(path, _sound_of(source), zones, drawing), 0, 0
    pairs = with_pictures(stream, source, private=drawing.private)
    for frame, picture in track(
        pairs, stream.name, recorded_frames(stream), console=Console(stderr=True), transient=True
    ):
        if picture is None or picture.shape[:2] != (frame.height, frame.width):
            missing += 1
            continue
        regions = {one.layer: one.region for one in frame.objects}
        overlay.add(
            LabelledPicture(
                image=picture,
                labels=frame.labels(),
                index=frame.index,
                pts=frame.pts,
                regions=regions,
                pixel_aspect=frame.pixel_aspect,
                scene=frame.scene,
            )
        )
        drawn += 1
    overlay.close()
    if drawn and not path.exists():
        return [f"{stream.name}: {remark}" for remark in overlay_remarks(path)]
    if missing:
        return [
            f"The source of stream {stream.name!r} gave {drawn} of its {count_of(drawn + missing, 'frame')} "
            "again, in the size recorded; the others are not in its overlay."
        ]
    return []


def _sound_of(source: str) -> SourceAddress | None:
    try:
        return parse_address(source, Path("/"))
    except ConfigError:
        return None
