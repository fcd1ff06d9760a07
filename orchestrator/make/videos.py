"""Whole videos: with an effect on what was chosen, or the labels drawn over it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mlbs_actors.messages import Array
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.video_file import VideoFile

__all__ = ["write_video"]


def write_video(footage: Footage, path: Path, shown: Callable[[Shot], Array]) -> list[str]:
    """Write the footage with its sound, each frame as a function shows it; return remarks."""
    with VideoFile(path, footage.sound) as video:
        for shot in footage.shots(path.name):
            video.add(shown(shot), shot.frame.pts, shot.frame.pixel_aspect)
    return video.remarks
