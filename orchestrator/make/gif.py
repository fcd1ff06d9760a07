"""An animated GIF that is small enough to be sent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.filter import Graph
from av.filter.context import FilterContext
from av.video.frame import VideoFrame

from mlbs_actors.messages import Array
from orchestrator.make.footage import Footage
from orchestrator.make.moments import clock
from orchestrator.pictures.content import Drawing

__all__ = ["write_gif"]

#: What a GIF is at most: px, s, bytes. A larger file gets smaller pictures.
_WIDTH, _LONGEST, _LARGEST = 480, 20.0, 8_000_000

_LEAST_WIDTH = 160  # px
_STEP = 0.08  # between two frames, s
_TICK = Fraction(1, 100)  # in which the format counts time, s


def write_gif(footage: Footage, path: Path, drawing: Drawing | None) -> list[str]:
    """Write the footage at up to 12.5 frames a second and 480 px, in a palette of its own.

    Parameters
    ----------
    footage : Footage
    path : Path
    drawing : Drawing, optional
        What is drawn over the pictures; None for nothing.

    Returns
    -------
    list of str
        Whether it ends before the footage.
    """
    pictures: list[Array] = []
    times: list[float] = []
    remarks: list[str] = []
    for shot in footage.shots(path.name):
        pts = shot.frame.pts
        if times and pts - times[0] >= _LONGEST:
            remarks.append(f"{path.name} ends at {clock(pts)}; choose what it shows with --from and --to.")
            break
        if not times or pts - times[-1] >= _STEP - 1e-6:
            picture = shot.picture if drawing is None else shot.drawn(drawing, _WIDTH)
            pictures.append(_scaled(picture, _WIDTH, shot.frame.pixel_aspect))
            times.append(pts)
    ticks = [round((pts - times[0]) / float(_TICK)) for pts in times]
    width = pictures[0].shape[1]
    _write(path, pictures, ticks)
    while path.stat().st_size > _LARGEST and width > _LEAST_WIDTH:
        # The size goes with the area, or a little slower.
        share = max(0.5, min(0.9, (_LARGEST / path.stat().st_size) ** 0.5))
        width = max(_LEAST_WIDTH, int(width * share))
        _write(path, [_scaled(picture, width) for picture in pictures], ticks)
    return remarks


def _scaled(picture: Array, width: int, pixel_aspect: float = 1.0) -> Array:
    """Shrink a picture to at most a width, px, with square pixels."""
    width = min(width, picture.shape[1])
    height = max(1, round(picture.shape[0] * width / (picture.shape[1] * pixel_aspect)))
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))


def _write(path: Path, pictures: Sequence[Array], ticks: Sequence[int]) -> None:
    height, width = pictures[0].shape[:2]
    frames = [
        _frame(cv2.resize(picture, (width, height)), time)
        for picture, time in zip(pictures, ticks, strict=True)
    ]
    palette = _palette(frames)
    step = round((ticks[-1] - ticks[0]) / (len(ticks) - 1)) if len(ticks) > 1 else 10
    with av.open(str(path), "w", format="gif", options={"final_delay": str(step)}) as container:
        stream = container.add_stream("gif", rate=round(1 / _TICK))
        stream.width, stream.height, stream.pix_fmt = width, height, "pal8"
        stream.codec_context.time_base = _TICK
        for frame in _in_colours_of(palette, frames):
            frame.time_base = _TICK
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _frame(picture: Array, ticks: int) -> VideoFrame:
    frame = VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="bgr24").reformat(format="bgra")
    frame.pts, frame.time_base = ticks, _TICK
    return frame


def _buffer(graph: Graph, frame: VideoFrame) -> FilterContext:
    return graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=_TICK)


def _palette(frames: Sequence[VideoFrame]) -> VideoFrame:
    """Choose 256 colours, most of them of what moves."""
    graph = Graph()
    source = _buffer(graph, frames[0])
    chosen, sink = graph.add("palettegen", "stats_mode=diff:reserve_transparent=1"), graph.add("buffersink")
    source.link_to(chosen)
    chosen.link_to(sink)
    graph.configure()
    for frame in frames:
        source.push(frame)
    source.push(None)
    palette = sink.pull()
    assert isinstance(palette, VideoFrame)
    return palette


def _in_colours_of(palette: VideoFrame, frames: Sequence[VideoFrame]) -> Iterator[VideoFrame]:
    graph = Graph()
    source, colours = _buffer(graph, frames[0]), _buffer(graph, palette)
    # A pattern stays where it is from frame to frame; dithering by errors would flicker, in larger files.
    used = graph.add("paletteuse", "dither=bayer:bayer_scale=4:diff_mode=rectangle")
    sink = graph.add("buffersink")
    source.link_to(used, 0, 0)
    colours.link_to(used, 0, 1)
    used.link_to(sink)
    graph.configure()
    colours.push(palette)
    colours.push(None)
    for frame in frames:
        source.push(frame)
    source.push(None)
    for _ in frames:
        coloured = sink.pull()
        assert isinstance(coloured, VideoFrame)
        yield coloured
