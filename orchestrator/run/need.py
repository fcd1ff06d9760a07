"""What one stream needs: as many run at once as fit, and on a cluster it is reserved.

Memory goes by the size of the pictures, as far as it is known before the start (docs/scaling.md has the
measurements). CPU time does not: a stream of small pictures takes all that it gets, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from mlbs_actors.actors.node.memory import LAYER_BYTES, STREAM_BYTES
from mlbs_actors.errors import ConfigError

__all__ = ["PLACE_BYTES", "STREAMS_A_CORE", "USUAL_NEED", "Need", "Reserve", "need_of", "parse_reserve"]

#: Unique memory of a stream with four objects whose pictures are not known, bytes: at 640×480.
PLACE_BYTES = STREAM_BYTES + 4 * LAYER_BYTES

#: Most streams of files for each core. A stream's stages wait for one another: two on a core keep it busy.
STREAMS_A_CORE = 2

#: Of pictures of a known size: the part that does not depend on it, and for each pixel, bytes.
_LEAST_BYTES, _BYTES_A_PIXEL = 900 * 2**20, 600

_UNITS = {"MB": 10**6, "GB": 10**9, "MiB": 2**20, "GiB": 2**30}


@dataclass(frozen=True, slots=True)
class Need:
    """What one stream needs.

    Attributes
    ----------
    cpus : float
    memory : int
        Bytes.
    """

    cpus: float = 1 / STREAMS_A_CORE
    memory: int = PLACE_BYTES


#: Of a stream whose pictures are not known.
USUAL_NEED = Need()


@dataclass(frozen=True, slots=True)
class Reserve:
    """What the user says that each stream needs.

    Attributes
    ----------
    cpus : float, optional
    memory : int, optional
        Bytes.
    words : str
        As it was given.
    """

    cpus: float | None
    memory: int | None
    words: str


def parse_reserve(text: str) -> Reserve:
    """Read ``cpu=0.25,memory=600MB``, or one of the two; raises ConfigError."""
    given: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.strip().partition("=")
        found = re.fullmatch(r"(\d+(?:\.\d+)?) ?([A-Za-z]*)", value, re.ASCII)
        amount, unit = (float(found[1]), found[2]) if found else (0.0, "")
        if name == "cpu" and amount > 0 and not unit:
            scale = 1
        elif name == "memory" and amount > 0 and unit in _UNITS:
            scale = _UNITS[unit]
        else:
            scale = 0
        if not scale or name in given:
            raise ConfigError(
                f"--reserve takes cpu=NUMBER and memory=SIZE in {', '.join(_UNITS)}, such as "
                f"cpu=0.25,memory=600MB, each of them once; not {text!r}."
            )
        given[name] = amount * scale
    memory = given.get("memory")
    return Reserve(given.get("cpu"), None if memory is None else round(memory), text)


def need_of(reserve: Reserve | None, sizes: Iterable[tuple[int, int] | None]) -> Need:
    """Return what each stream of a run needs.

    Parameters
    ----------
    reserve : Reserve, optional
        What the user says of it.
    sizes : iterable of tuple of int
        Height and width of the pictures of each stream, px; None where they are not known.
    """
    known = list(sizes)
    need = USUAL_NEED
    if known and all(known):
        most = max(size[0] * size[1] for size in known if size is not None)
        need = Need(memory=_LEAST_BYTES + _BYTES_A_PIXEL * most)
    if reserve is None:
        return need
    return Need(reserve.cpus or need.cpus, reserve.memory or need.memory)
