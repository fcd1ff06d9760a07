"""Whole videos: with an effect on what was chosen or where it may be, or the labels drawn over it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mlbs_actors.messages import Array
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.missed import covered_shots
from orchestrator.make.video_file import VideoFile

__all__ = ["write_covered", "write_video"]


def write_video(footage: Footage, path: Path, shown: Callable[[Shot], Array]) -> list[str]:
    """Write the footage with its sound, each frame as a function shows it; return remarks."""
    with VideoFile(path, footage.sound) as video:
        for shot in footage.shots(path.name):
            video.add(shown(shot), shot.frame.pts, shot.frame.pixel_aspect)
    return video.remarks


def write_covered(footage: Footage, path: Path, shown: Callable[[Shot, Array], Array]) -> list[str]:
    """Write the footage with its sound, made by a function of each shot and of what is covered in it."""
    with VideoFile(path, footage.sound) as video:
        for shot, covered in covered_shots(footage, path.name):
            video.add(shown(shot, covered), shot.frame.pts, shot.frame.pixel_aspect)
    return video.remarks
