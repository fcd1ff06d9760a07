"""Which objects count, by their newest mask and their age: for rules, and for what is sent."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

__all__ = ["ObjectFilter", "Range", "Strict"]

_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Strict(BaseModel):
    """What an operator writes: a key that is not known is a fault."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Range(Strict):
    """Bounds of a value, which itself may be equal to them.

    Attributes
    ----------
    least : float
    most : float, optional
        By default there is none.
    """

    least: _NotNegative = 0.0
    most: _NotNegative | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Range:
        if self.most is not None and self.most < self.least:
            raise ValueError(f"no value is at least {self.least:g} and at most {self.most:g}")
        return self

    def holds(self, value: float) -> bool:
        """Whether a value is within the bounds."""
        return self.least <= value and (self.most is None or value <= self.most)


class ObjectFilter(Strict):
    """What is asked of an object; all of it must hold.

    Attributes
    ----------
    score : float
        Least score of its mask, 0 to 1.
    area : Range
        px.
    aspect : Range
        Width of its box for its height.
    seconds : float
        Least age, s.
    """

    score: Annotated[float, Field(ge=0, le=1)] = 0.0
    area: Range = Range()
    aspect: Range = Range()
    seconds: _NotNegative = 0.0

    def takes(
        self, score: float | None, area: float | None, aspect: float | None, seconds: float | None
    ) -> bool:
        """Whether these values are within the bounds; what is not known, which is None, is."""
        return (
            (score is None or score >= self.score)
            and (area is None or self.area.holds(area))
            and (aspect is None or self.aspect.holds(aspect))
            and (seconds is None or seconds >= self.seconds)
        )
