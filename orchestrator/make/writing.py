"""Makes one thing of a stream: how each kind is made, and into which files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array
from orchestrator.make.clips import write_clips
from orchestrator.make.cutout import write_cutout, write_over
from orchestrator.make.effects import COVERS, highlighted
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.gif import write_gif
from orchestrator.make.kinds import KINDS, VIDEOS
from orchestrator.make.remove import write_removed
from orchestrator.make.sheet import write_sheet
from orchestrator.make.videos import write_covered, write_video
from orchestrator.pictures.content import Drawing
from orchestrator.sources.address import SourceAddress

__all__ = ["Manner", "files_of", "suffixes_of", "write"]


#: Kinds over whose pictures objects can be drawn.
_DRAWN = ("overlay", "clips", "gif", "sheet")


@dataclass(frozen=True, slots=True)
class Manner:
    """How a thing is made.

    Attributes
    ----------
    drawing : Drawing, optional
        What overlays, clips, animations and sheets show of objects; None for nothing.
    each : bool
        Whether every object is cut out by itself.
    apart : bool
        Whether every clip is a video of its own.
    over : SourceAddress, optional
        The video that a cut-out is laid over.
    """

    drawing: Drawing | None
    each: bool = False
    apart: bool = False
    over: SourceAddress | None = None

    @classmethod
    def asked(cls, kind: str, *, labels: bool | None = None, ids: bool | None = None) -> Manner:
        """Draw objects as overlays do, and nothing else; None for what is usual for a kind."""
        if labels is None:
            labels = kind != "clips" or ids is True  # clips are watched for themselves
        return cls(Drawing(ids=ids is not False, zones=False, frame=False) if labels else None)

    def variant(self, kind: str) -> list[str]:
        """Return how it differs from what is usual for a kind, in words for the name of a file."""
        if kind not in _DRAWN:
            return [] if self.over is None else ["over"]
        labels = self.drawing is not None
        words = [] if labels is (kind != "clips") else ["labels" if labels else "no-labels"]
        return words + (["no-ids"] if self.drawing is not None and not self.drawing.ids else [])

    def shown(self, shot: Shot) -> Array:
        """Return what a frame looks like."""
        return shot.picture if self.drawing is None else shot.drawn(self.drawing)


def suffixes_of(kind: str, manner: Manner) -> tuple[str, ...]:
    """Return the endings that its file may have, the usual one first."""
    return KINDS[kind].suffixes if manner.over is None else VIDEOS


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
        Of :data:`~orchestrator.make.kinds.KINDS`.
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
        case "cutout" if manner.over is not None:
            remarks = write_over(footage, path, manner.over)
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
        case "highlight":
            remarks = write_video(footage, path, highlighted)
        case _:
            remarks = write_covered(footage, path, COVERS[kind])
    return remarks + footage.remarks()
