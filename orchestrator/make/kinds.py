"""The kinds of things that can be made, each with the forms of files that it has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array
from orchestrator.make.clips import write_clips
from orchestrator.make.cutout import write_cutout
from orchestrator.make.effects import EFFECTS
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.gif import write_gif
from orchestrator.make.remove import write_removed
from orchestrator.make.sheet import write_sheet
from orchestrator.make.videos import write_video
from orchestrator.pictures.content import Drawing

__all__ = ["KINDS", "Kind", "Manner", "files_of", "write"]

_VIDEOS = (".mp4", ".mkv")


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of thing.

    Attributes
    ----------
    words : str
        What it is, for the help.
    suffixes : tuple of str
        Endings that its file may have, the usual one first.
    """

    words: str
    suffixes: tuple[str, ...]


#: By name.
KINDS = {
    "overlay": Kind("the objects outlined and tinted", _VIDEOS),
    "remove": Kind("what was behind the objects, from frames that show it, and where it is made up", _VIDEOS),
    "blur": Kind("the objects blurred (no promise that nobody can be recognised)", _VIDEOS),
    "pixelate": Kind("the objects as a mosaic (no promise either)", _VIDEOS),
    "highlight": Kind("all grey but the objects", _VIDEOS),
    "cutout": Kind(
        "the objects alone: a video with opacity as .mov (ProRes 4444) or .webm (VP9), or with .png a folder "
        "of pictures",
        (".mov", ".webm", ".png"),
    ),
    "clips": Kind("the parts in which something moves, and a table of their times", _VIDEOS),
    "gif": Kind("an animation of at most 20 s, 480 px and 8 MB", (".gif",)),
    "sheet": Kind("20 frames on one picture", (".jpg", ".png")),
}


@dataclass(frozen=True, slots=True)
class Manner:
    """How it is made.

    Attributes
    ----------
    drawing : Drawing, optional
        What overlays, clips, animations and sheets show of objects; None for nothing.
    each : bool
        Whether every object is cut out by itself.
    apart : bool
        Whether every clip is a video of its own.
    """

    drawing: Drawing | None
    each: bool = False
    apart: bool = False

    @classmethod
    def usual(cls, *, ids: bool = True) -> Manner:
        """Draw objects as overlays do, and nothing else."""
        return cls(Drawing(ids=ids, zones=False, frame=False))

    def shown(self, shot: Shot) -> Array:
        """Return what a frame looks like."""
        return shot.picture if self.drawing is None else shot.drawn(self.drawing)


def files_of(kind: str, stem: str, suffix: str, manner: Manner) -> list[str]:
    """Return the names of the files and folders that :func:`write` makes, the main one first."""
    if kind == "clips":
        return [stem] if manner.apart else [f"{stem}{suffix}", f"{stem}.csv"]
    if kind == "remove":
        return [f"{stem}{suffix}", f"{stem}-made-up{suffix}"]
    if kind == "cutout" and (manner.each or suffix == ".png"):
        return [stem]
    return [f"{stem}{suffix}"]


def write(kind: str, footage: Footage, folder: Path, stem: str, suffix: str, manner: Manner) -> list[str]:
    """Make one thing.

    Parameters
    ----------
    kind : str
        Of :data:`KINDS`.
    footage : Footage
    folder : Path
        Where to; empty.
    stem, suffix : str
        Name of the file or folder, see :func:`files_of`, and the ending.
    manner : Manner

    Returns
    -------
    list of str
        Sentences about what is missing.

    Raises
    ------
    ConfigError
        If there is nothing to make it of.
    """
    paths = [folder / name for name in files_of(kind, stem, suffix, manner)]
    path = paths[0]
    if not footage.chosen.seen and kind not in ("overlay", "gif", "sheet"):
        raise ConfigError(f"There is no such object in {footage.name!r}, so no {kind} is made.")
    match kind:
        case "cutout":
            remarks = write_cutout(footage, path, suffix, each=manner.each)
        case "remove":
            remarks = write_removed(footage, path, paths[1])
        case "clips":
            remarks = write_clips(footage, path, suffix, manner.shown, apart=manner.apart)
        case "gif":
            remarks = write_gif(footage, path, manner.drawing)
        case "sheet":
            write_sheet(footage, path, manner.drawing)
            remarks = []
        case "overlay":
            remarks = write_video(footage, path, manner.shown)
        case _:
            shown: Callable[[Shot], Array] = EFFECTS[kind]
            remarks = write_video(footage, path, shown)
    return remarks + footage.remarks()
