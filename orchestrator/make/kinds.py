"""The kinds of things that can be made, each with the forms of files that it has.

Nothing has to be installed to import this: the help needs it, too.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["KINDS", "VIDEOS", "Kind"]

#: Endings of videos without opacity.
VIDEOS = (".mp4", ".mkv")


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
    "overlay": Kind("the objects outlined and tinted", VIDEOS),
    "remove": Kind("what was behind the objects, from frames that show it, and where it is made up", VIDEOS),
    "blur": Kind("the objects blurred (no promise that nobody can be recognised)", VIDEOS),
    "pixelate": Kind("the objects as a mosaic (no promise either)", VIDEOS),
    "highlight": Kind("all grey but the objects", VIDEOS),
    "cutout": Kind(
        "the objects alone: a video with opacity as .mov (ProRes 4444) or .webm (VP9), or with .png a folder "
        "of pictures",
        (".mov", ".webm", ".png"),
    ),
    "clips": Kind("the parts in which something moves, and a table of their times", VIDEOS),
    "gif": Kind("an animation of at most 20 s, 480 px and 8 MB", (".gif",)),
    "sheet": Kind("20 frames on one picture", (".jpg", ".png")),
}
