"""What is said of an option: how it is given, read, written again and recorded, and when it counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from orchestrator.option_values import as_given

__all__ = ["Effect", "Form", "Option"]


class Form(Enum):
    """How an option is given."""

    VALUE = "FLAG VALUE"
    FLAG = "FLAG"
    REPEATED = "FLAG VALUE, again for more"
    WORDS = "FLAG VALUE VALUE ..."
    OPTIONAL_VALUE = "FLAG, or FLAG VALUE"


class Effect(Enum):
    """When another value of an option takes effect in a run that has begun."""

    FIXED = "never: it belongs to a run"
    NEXT_START = "at the next start"
    AT_ONCE = "within seconds"
    RESTART = "within seconds, as the stream's processes start again"
    EPOCH = "within seconds, as the stream's processes start again with a new epoch: all ids are new"


@dataclass(frozen=True, slots=True)
class Option:
    """An option.

    Attributes
    ----------
    meaning : str
        A sentence without its full stop.
    metavar : str
        Stands for its value in the help.
    form : Form
    read : callable
        Turns what was given, a text or for ``REPEATED`` and ``WORDS`` a list of texts, into the value; raises
        ConfigError.
    write : callable, optional
        Turns a value into the texts that give it again, from any folder; None if the command that goes on
        does not need it.
    record : callable, optional
        Turns a value into what ``run.json`` holds of it; None if it holds nothing.
    effect : Effect
    of_streams : bool
        Whether a file of cameras can give it for each stream.
    page : str
        Where the docs say more.
    """

    meaning: str
    metavar: str = ""
    form: Form = Form.VALUE
    read: Callable[[Any], Any] = as_given
    write: Callable[[Any], Sequence[str]] | None = None
    record: Callable[[Any], object] | None = None
    effect: Effect = Effect.NEXT_START
    of_streams: bool = False
    page: str = ""

    def value(self, name: str, raw: str | list[str] | bool) -> Any:
        """Return the value of what was given.

        Raises
        ------
        ConfigError
            If it is not understood; the message begins with ``name``.
        """
        from mlbs_actors.errors import ConfigError

        try:
            return self.read(raw)
        except ValueError as error:
            raise ConfigError(f"{name} {error}") from None
