"""Which objects something is made of: ``--only`` and ``--least-score``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import RecordedFrame
from orchestrator.make.moments import Span

__all__ = ["EVERYTHING", "Choice", "Chosen", "parse_only"]


@dataclass(frozen=True, slots=True)
class Choice:
    """What is asked for.

    Attributes
    ----------
    ids : frozenset of int
        Only these objects; empty for all.
    largest : bool
        Only the one with the largest area, summed over the frames.
    moving : bool
        Objects only in frames in which they move.
    least_score : float
        Only objects whose masks have at least this mean score, as in ``objects.csv``.
    """

    ids: frozenset[int] = frozenset()
    largest: bool = False
    moving: bool = False
    least_score: float = 0.0


EVERYTHING = Choice()


def parse_only(text: str | None, least_score: float = 0.0) -> Choice:
    """Read ids with commas, ``largest`` or ``moving``; None is for all. Raises ConfigError."""
    if text in (None, "largest", "moving"):
        return Choice(largest=text == "largest", moving=text == "moving", least_score=least_score)
    words = str(text).split(",")
    if not all(word.isascii() and word.isdecimal() for word in words):
        raise ConfigError(f"--only takes ids with commas, such as 3,5, or largest, or moving, not {text!r}.")
    return Choice(frozenset(map(int, words)), least_score=least_score)


@dataclass(slots=True)
class _Figures:
    """What is summed of an object: of the whole stream, and of the part that is asked for."""

    frames: int = 0
    score: float = 0.0
    area: int = 0
    kind: str = "object"
    first: int | None = None
    last: int = 0


@dataclass(frozen=True, slots=True)
class Chosen:
    """The objects of one stream that were chosen.

    Attributes
    ----------
    seen : dict of int to (int, int)
        Ids in ascending order → first and last frame in the part that is asked for.
    moving : bool
        Whether they count only while they move.
    """

    seen: dict[int, tuple[int, int]]
    moving: bool

    @classmethod
    def of(cls, choice: Choice, frames: Iterable[RecordedFrame], span: Span) -> Chosen:
        """Choose among the objects of all frames of a stream those that are asked for.

        Raises
        ------
        ConfigError
            If an id is asked for that is not in that part of the stream, or none is left.
        """
        figures: dict[int, _Figures] = {}
        for frame in frames:
            inside = span.holds(frame.index, frame.pts)
            for one in frame.objects:
                figure = figures.setdefault(one.layer, _Figures())
                figure.frames += 1
                figure.score += one.score
                if inside:
                    figure.area += one.area
                    figure.kind = one.kind
                    figure.first = frame.index if figure.first is None else figure.first
                    figure.last = frame.index
        seen = {
            layer: figure
            for layer, figure in sorted(figures.items())
            if figure.first is not None and figure.score >= choice.least_score * figure.frames
        }
        if unknown := sorted(choice.ids - seen.keys()):
            raise ConfigError(_words_on_missing(unknown[0], seen, choice))
        if choice.ids:
            seen = {layer: seen[layer] for layer in sorted(choice.ids)}
        elif choice.largest:
            single = [layer for layer, figure in seen.items() if figure.kind == "object"]
            seen = {layer: seen[layer] for layer in sorted(single, key=lambda one: -seen[one].area)[:1]}
        return cls({layer: (one.first or 0, one.last) for layer, one in seen.items()}, choice.moving)

    def of_frame(self, frame: RecordedFrame) -> RecordedFrame:
        """Return a frame with those of its objects that were chosen."""
        pairs = zip(frame.objects, frame.codes, strict=True)
        kept = [pair for pair in pairs if pair[0].layer in self.seen]
        if self.moving:
            kept = [pair for pair in kept if pair[0].state == "moving"]
        return replace(frame, objects=tuple(one for one, _ in kept), codes=tuple(code for _, code in kept))


def _words_on_missing(layer: int, seen: Iterable[int], choice: Choice) -> str:
    there = ", ".join(map(str, seen)) or "none"
    with_score = f" with a score of {choice.least_score:g} or more" if choice.least_score else ""
    return f"There is no object {layer} in that part of the stream{with_score}; there are {there}."
