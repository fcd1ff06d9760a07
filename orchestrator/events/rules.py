"""Rules: what an operator wants to hear of a stream, each a named event of its own."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from orchestrator.events.object_filter import ObjectFilter, Strict
from orchestrator.events.schedule import Schedule

__all__ = ["Count", "Dwell", "Rule", "Step", "check_rules"]

Direction = Literal["left", "right"]
_Name = Annotated[str, Field(min_length=1, max_length=100)]
_Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Dwell(Strict):
    """An object stays in a zone.

    Attributes
    ----------
    zone : str
    seconds : float
        For so long without having left it.
    """

    zone: str
    seconds: _Seconds


class Step(Strict):
    """Part of a sequence: an object enters a zone, or crosses a line.

    It is written as the name, or as ``NAME: left`` or ``NAME: right`` of a line.

    Attributes
    ----------
    name : str
    direction : {"left", "right"}, optional
        By default either.
    """

    name: str
    direction: Direction | None = None

    @model_validator(mode="before")
    @classmethod
    def _as_written(cls, written: Any) -> Any:
        if isinstance(written, str):
            return {"name": written}
        if isinstance(written, dict) and len(written) == 1 and "name" not in written:
            [(name, direction)] = written.items()
            return {"name": name, "direction": direction}
        return written


class Count(Strict):
    """Objects at once in a zone, or crossings of a line.

    Attributes
    ----------
    zone, line : str, optional
        One of the two.
    at_least : int
        Objects, or crossings.
    seconds : float
        In a zone: for so long without a break.
    within : float
        Over a line: in so many seconds.
    direction : {"left", "right"}, optional
        Over a line; by default either.
    """

    zone: str | None = None
    line: str | None = None
    at_least: Annotated[int, Field(ge=1)]
    seconds: _Seconds = 0.0
    within: _Seconds = 0.0
    direction: Direction | None = None

    @model_validator(mode="after")
    def _of_one(self) -> Count:
        if (self.zone is None) == (self.line is None):
            raise ValueError("a count needs either a 'zone' or a 'line'")
        if self.line is None and (self.within > 0 or self.direction is not None):
            raise ValueError("'within' and 'direction' are of a line; in a zone, give 'seconds'")
        if self.line is not None and (self.within == 0 or self.seconds > 0):
            raise ValueError("crossings of a line are counted 'within' some seconds")
        return self

    @property
    def place(self) -> str:
        """Name of the zone or line."""
        return self.zone or self.line or ""


class Rule(Strict):
    """What must happen for an event of kind ``rule``; one of ``dwell``, ``sequence`` and ``count``.

    Attributes
    ----------
    name : str
    dwell : Dwell, optional
    sequence : (Step, Step), optional
        The same object does one after the other.
    within : float
        Of ``sequence``: seconds between the two at most.
    count : Count, optional
    objects : ObjectFilter
        Objects that count.
    cool_down : float
        Seconds after an event in which there is no other one of the rule.
    schedule : Schedule, optional
        By default it is always in force.
    """

    name: _Name
    dwell: Dwell | None = None
    sequence: tuple[Step, Step] | None = None
    within: _Seconds = 0.0
    count: Count | None = None
    objects: ObjectFilter = ObjectFilter()
    cool_down: _Seconds = 0.0
    schedule: Schedule | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> Rule:
        if sum(one is not None for one in (self.dwell, self.sequence, self.count)) != 1:
            raise ValueError("a rule needs one of 'dwell', 'sequence' and 'count'")
        if (self.sequence is None) != (self.within == 0):
            raise ValueError(
                "a 'sequence' needs 'within', the seconds between the two at most; others have none"
            )
        return self

    @property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that tell it from others."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:16]

    @property
    def places(self) -> tuple[Step, ...]:
        """The zones and lines that it names."""
        if self.dwell is not None:
            return (Step(name=self.dwell.zone),)
        if self.count is not None:
            return (Step(name=self.count.place, direction=self.count.direction),)
        return self.sequence or ()


def check_rules(rules: tuple[Rule, ...], kinds: dict[str, Literal["zone", "line"]]) -> None:
    """Check that rules have names of their own, and that what they name is there.

    Parameters
    ----------
    rules : tuple of Rule
    kinds : dict
        Of the stream's zones and lines, by name.

    Raises
    ------
    ValueError
        If not.
    """
    names = [rule.name for rule in rules]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f"two rules are named {twice!r}")
    for rule in rules:
        for place in rule.places:
            if place.name not in kinds:
                there = ", ".join(map(repr, kinds)) or "none"
                raise ValueError(
                    f"the rule {rule.name!r} names {place.name!r}, which is no zone or line of this stream; "
                    f"there is {there}"
                )
            if place.direction is not None and kinds[place.name] != "line":
                raise ValueError(
                    f"the rule {rule.name!r} has a direction of {place.name!r}, which is no line"
                )
        wanted = "line" if rule.count is not None and rule.count.line is not None else "zone"
        if rule.sequence is None and kinds[rule.places[0].name] != wanted:
            raise ValueError(f"the rule {rule.name!r} needs a {wanted}; {rule.places[0].name!r} is none")
