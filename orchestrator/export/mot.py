"""MOTChallenge: a text file for each stream, a line for each frame and box."""

from __future__ import annotations

from pathlib import Path

from mlbs_actors.record.recorded_stream import recorded_stream, streams_of

__all__ = ["write_mot"]


def write_mot(run: Path, out: Path) -> None:
    """Write ``STREAM.txt`` with the lines ``frame,id,x,y,w,h,score,-1,-1,-1``.

    The format counts frames and pixels from 1; the last three values would be a place in the world.

    Parameters
    ----------
    run : Path
    out : Path
        An existing folder.
    """
    for name in streams_of(run):
        with (out / f"{name}.txt").open("w", encoding="utf-8") as file:
            for frame in recorded_stream(run / name):
                for one in frame.objects:
                    left, top, width, height = one.region.box
                    box = f"{left + 1},{top + 1},{width},{height}"
                    file.write(f"{frame.index + 1},{one.layer},{box},{one.score:.4f},-1,-1,-1\n")
