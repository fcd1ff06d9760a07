"""What clips are made."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mlbs_actors.errors import ConfigError
from orchestrator.events.event import EventKind
from orchestrator.sources.address import SourceAddress, SourceKind
from orchestrator.sources.animation import is_animation
from orchestrator.sources.presence import holds_images

__all__ = ["LONGEST_SHARED_SECONDS", "ClipSettings", "clip_settings", "has_clips"]

#: Events that overlap share a clip as long as it does not get longer than this, s.
LONGEST_SHARED_SECONDS = 30.0

#: An event may have begun this long before it is certain and be cut out, s: a zone takes three label maps, a
#: least age or a time in a zone as long as it says.
_CERTAIN_SECONDS = 60.0

#: Longest time before an event and after it that a clip may show, s: so much is kept of every camera.
_MOST_SECONDS = 60.0


@dataclass(frozen=True, slots=True)
class ClipSettings:
    """What clips are made, and how much of them is kept.

    Attributes
    ----------
    before, after : float
        How much of what was before an event and after it is shown, s.
    kinds : frozenset of str
        Of which events, as in ``events.jsonl``.
    most : int
        Newest clips of a stream that are kept.
    most_bytes : int
        Of all clips of a run; above it the oldest are deleted.
    """

    before: float = 5.0
    after: float = 5.0
    kinds: frozenset[EventKind] = frozenset(("entered", "crossed", "rule"))
    most: int = 1000
    most_bytes: int = 10_000_000_000

    @property
    def ring_seconds(self) -> float:
        """How much of a camera's packets must be kept for them, s."""
        return self.before + max(self.after, LONGEST_SHARED_SECONDS) + _CERTAIN_SECONDS


def clip_settings(text: str) -> ClipSettings:
    """Read what ``--clips`` says: ``BEFORE,AFTER``, or nothing for the defaults.

    Raises
    ------
    ConfigError
        If it says anything else.
    """
    if not text:
        return ClipSettings()
    try:
        before, after = map(float, text.split(","))
    except ValueError:
        before = after = math.nan
    if not (0 <= before <= _MOST_SECONDS and 0 <= after <= _MOST_SECONDS and before + after > 0):
        raise ConfigError(
            f"--clips takes the seconds before and after an event, each from 0 to {_MOST_SECONDS:.0f}, such "
            f"as 5,10; this is {text!r}."
        )
    return ClipSettings(before=before, after=after)


def has_clips(source: SourceAddress) -> bool:
    """Whether clips can be made of a source: of cameras and videos, not of images and made scenes."""
    if source.kind is not SourceKind.PATH:
        return source.live
    return not holds_images(source) and not is_animation(source.location)
