"""Corrections of a finished record by hand: ids merged, dropped and split.

A file has a correction a line, in CSV: ``merge,A,B`` (A becomes B), ``drop,C`` and ``split,D,FRAME`` (from
that frame on D is another object). Each line goes on from what those before it have made. The record itself
stays as it is; its rows are corrected while they are read.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.extras import needing
from mlbs_actors.messages import LayerSummary, Region
from mlbs_actors.record.frame_row import FrameRow, ResultRow

__all__ = ["EDITS", "NO_EDITS", "Edit", "Edits", "read_edits"]

#: Name of the file, in the stream's folder.
EDITS = "edits.csv"

_FORMS = {"merge": "merge,A,B", "drop": "drop,C", "split": "split,D,FRAME"}


@dataclass(frozen=True, slots=True)
class Edit:
    """One correction.

    Attributes
    ----------
    layer : int
        The id that it changes.
    new : int, optional
        What becomes of it; None if it is dropped.
    begin : int
        First frame in which it does.
    """

    layer: int
    new: int | None
    begin: int = 0


@dataclass(frozen=True, slots=True)
class Edits:
    """Corrections of one stream, in the order of their file."""

    edits: tuple[Edit, ...] = ()

    def id_of(self, layer: int, frame: int) -> int | None:
        """Return what a recorded id is in a frame; None if it is dropped."""
        for edit in self.edits:
            if layer == edit.layer and frame >= edit.begin:
                if edit.new is None:
                    return None
                layer = edit.new
        return layer

    def applied(self, rows: Iterable[FrameRow]) -> Iterator[FrameRow]:
        """Yield the rows of a record with these corrections."""
        for row in rows:
            if row.result is None or not self.edits:
                yield row
            else:
                yield replace(row, result=self._corrected(row.result, row.frame))

    def _corrected(self, result: ResultRow, frame: int) -> ResultRow:
        ids = ((self.id_of(one.layer, frame), place) for place, one in enumerate(result.layers))
        kept = sorted((new, place) for new, place in ids if new is not None)
        layers, codes = [], []
        for new, group in groupby(kept, key=lambda one: one[0]):
            places = [place for _, place in group]
            layers.append(_joined([result.layers[place] for place in places], new))
            codes.append(_joined_code([result.run_length_codes[place] for place in places], result.shape))
        return replace(result, layers=tuple(layers), run_length_codes=tuple(codes))


NO_EDITS = Edits()


def read_edits(path: Path, rows: Callable[[], Iterable[FrameRow]]) -> Edits:
    """Read a file of corrections.

    Parameters
    ----------
    path : Path
    rows : callable
        Returns the rows of the record, which say what ids there are. The id that a split makes is the
        largest of them and the number of splits up to its line.

    Raises
    ------
    ConfigError
        If it cannot be read, or a line is none of the known forms, or names an id or a frame that there is
        not. The message has its number.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise ConfigError(f"{path} cannot be read: {why}.") from None
    known = _Objects.of(rows())
    edits = []
    for number, words in enumerate(csv.reader(lines), start=1):
        words = [word.strip() for word in words]
        if not any(words) or words[0].startswith("#"):
            continue
        try:
            edits.append(known.edit(words))
        except ValueError as error:
            raise ConfigError(f"{path}, line {number}: {error}.") from None
    return Edits(tuple(edits))


@dataclass(slots=True)
class _Objects:
    """The objects of a record after some corrections.

    Attributes
    ----------
    seen : dict of int to (int, int)
        Id → first and last frame.
    largest : int
        Id so far.
    gone : dict of int to str
        Id → what has become of it.
    """

    seen: dict[int, tuple[int, int]]
    largest: int
    gone: dict[int, str]

    @classmethod
    def of(cls, rows: Iterable[FrameRow]) -> _Objects:
        seen: dict[int, tuple[int, int]] = {}
        for row in rows:
            for one in row.result.layers if row.result else ():
                seen[one.layer] = seen.get(one.layer, (row.frame, 0))[0], row.frame
        return cls(seen, max(seen, default=0), {})

    def edit(self, words: Sequence[str]) -> Edit:
        """Check one line against the objects, change these, and return what it says; ValueError if wrong."""
        match words:
            case ["merge", one, other]:
                layer, into = self._object(one), self._object(other)
                if layer == into:
                    raise ValueError(f"object {layer} cannot be merged into itself")
                (first, last), (begin, end) = self.seen.pop(layer), self.seen[into]
                self.seen[into] = min(first, begin), max(last, end)
                self.gone[layer] = f"was merged into {into} above"
                return Edit(layer, into)
            case ["drop", one]:
                layer = self._object(one)
                del self.seen[layer]
                self.gone[layer] = "was dropped above"
                return Edit(layer, None)
            case ["split", one, frame]:
                layer = self._object(one)
                begin, (first, last) = _number(frame, "frame"), self.seen[layer]
                if not first < begin <= last:
                    raise ValueError(
                        f"object {layer} is seen in frames {first} to {last}, and cannot be split at {begin}"
                    )
                self.largest += 1
                self.seen[layer], self.seen[self.largest] = (first, begin - 1), (begin, last)
                return Edit(layer, self.largest, begin)
        form = _FORMS.get(words[0])
        forms = form or ", ".join(list(_FORMS.values())[:-1]) + f" or {_FORMS['split']}"
        raise ValueError(f"{','.join(words)!r} is no correction; write {forms}")

    def _object(self, word: str) -> int:
        layer = _number(word, "object's id")
        if layer in self.gone:
            raise ValueError(f"object {layer} {self.gone[layer]}")
        if layer not in self.seen:
            raise ValueError(f"there is no object {layer} in the record; objects.csv has the ids")
        return layer


def _number(word: str, what: str) -> int:
    if not (word.isascii() and word.isdecimal()):
        raise ValueError(f"{word!r} is no {what}, which is a whole number")
    return int(word)


def _joined(parts: Sequence[LayerSummary], new: int) -> LayerSummary:
    """Summarise parts of one object under an id; means are weighted by area."""
    if len(parts) == 1:
        return replace(parts[0], layer=new)
    area = sum(part.area for part in parts)

    def mean(values: Iterable[float]) -> float:
        return sum(value * part.area for value, part in zip(values, parts, strict=True)) / area

    left, top = min(part.region.x for part in parts), min(part.region.y for part in parts)
    right = max(part.region.x + part.region.width for part in parts)
    bottom = max(part.region.y + part.region.height for part in parts)
    return LayerSummary(
        layer=new,
        kind="object" if any(part.kind == "object" for part in parts) else "other",
        region=Region(left, top, right - left, bottom - top),
        area=area,
        centroid=(mean(part.centroid[0] for part in parts), mean(part.centroid[1] for part in parts)),
        velocity=(mean(part.velocity[0] for part in parts), mean(part.velocity[1] for part in parts)),
        confidence=mean(part.confidence for part in parts),
        state="moving" if any(part.state == "moving" for part in parts) else "resting",
        score=mean(part.score for part in parts),
    )


def _joined_code(codes: Sequence[str], shape: tuple[int, int]) -> str:
    if len(codes) == 1:
        return codes[0]
    with needing("read"):
        from pycocotools import mask as coco_mask

    masks = [{"size": list(shape), "counts": code.encode("ascii")} for code in codes]
    return str(coco_mask.merge(masks)["counts"].decode("ascii"))
