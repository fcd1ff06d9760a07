"""How the values of options are read from texts, and written as texts again.

Nothing has to be installed to import this: the help needs it, too. What is not understood is a ValueError, or
from other modules a ConfigError, with a sentence.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from orchestrator.credentials import mask
from orchestrator.log import FORMATS, LogFormat
from orchestrator.make.kinds import KINDS
from orchestrator.monitor.address import MonitorAddress
from orchestrator.object_storage.address import StoreAddress, parse_store_address

if TYPE_CHECKING:
    from orchestrator.clips.settings import ClipSettings
    from orchestrator.events.targets import EventTarget
    from orchestrator.ignored import Ignored
    from orchestrator.run.need import Reserve
    from orchestrator.run.retention_limits import Keep

__all__ = ["DRAWABLE", "DRAWN", "LEAST_SIDE", "SAVABLE", "SAVED"]

#: The parts of a record that ``--save`` can name.
SAVABLE = ("masks", "parquet", "overlay", "background", "cutouts")

#: The default of ``--save``.
SAVED = SAVABLE[:3]

#: What can be drawn over pictures beside the objects, and what is by default.
DRAWABLE = ("ids", "zones", "frame", "clock")
DRAWN = DRAWABLE[:3]

#: Least ``--max-side``, px: in smaller pictures there is hardly a trajectory.
LEAST_SIDE = 64


def as_given(value: Any) -> Any:
    """Return the value itself."""
    return value


def one_word(value: object) -> list[str]:
    """Write a value that is one word."""
    return [str(value)]


def no_words(_: object) -> list[str]:
    """Write a flag, which has no value."""
    return []


def absolute(path: Path) -> list[str]:
    """Write a path, to be read from any folder."""
    return [str(path.absolute())]


def at_least_one(text: str) -> int:
    """Read a number."""
    return _number(text, 1)


def side(text: str) -> int:
    """Read the side of a picture, px."""
    return _number(text, LEAST_SIDE)


def _number(text: str, least: int) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) >= least):
        raise ValueError(f"{text!r} is not a whole number of at least {least}.")
    return int(text)


def output(text: str) -> Path | StoreAddress:
    """Read the path of a folder of this machine, or the address of an object store."""
    if text[1:3] in (":\\", ":/"):
        there = shlex.quote(f"/mnt/{text[0].lower()}/" + text[3:].replace(chr(92), "/"))
        raise ValueError(
            f"takes a folder of this machine, not {text!r}; where WSL has the drives of Windows: "
            f"--output {there}"
        )
    address = parse_store_address(text)
    if address is None and "://" in text:
        raise ValueError(
            f"takes a folder of this machine, or an object store at s3://, gs://, az:// or abfs://, not "
            f"{mask(text)!r}; mount the storage and name the folder, or copy the results there afterwards."
        )
    return address or Path(text)


def cluster_address(text: str) -> str:
    """Read ``HOST:PORT`` or ``auto``."""
    if text.startswith("ray://"):
        raise ValueError(
            "cannot be a ray:// proxy; run on a machine of the cluster and give HOST:PORT or auto."
        )
    host, _, port = text.rpartition(":")
    if text != "auto" and not (host and _is_port(port) and int(port)):
        raise ValueError(
            f"takes HOST:PORT, such as 10.0.0.5:6379, or auto for the cluster of this machine; not "
            f"{mask(text)!r}."
        )
    return text


def parts(text: str) -> frozenset[str]:
    """Read parts of a record, with commas."""
    return _chosen(text, SAVABLE)


def drawn(text: str) -> frozenset[str]:
    """Read what pictures show, with commas; nothing if it is empty."""
    return _chosen(text, DRAWABLE) if text else frozenset()


def made(text: str) -> tuple[str, ...]:
    """Read what is to be made, with commas; in the order of the kinds."""
    chosen = _chosen(text, tuple(KINDS))
    return tuple(kind for kind in KINDS if kind in chosen)


def _chosen(text: str, known: Sequence[str]) -> frozenset[str]:
    names = [part.strip() for part in text.split(",")]
    for name in names:
        if name not in known:
            asked = f"knows no {name!r}" if name else "names nothing"
            raise ValueError(f"{asked}; choose from {', '.join(known)}.")
    return frozenset(names)


def time_zone(text: str) -> str:
    """Read the name of a time zone."""
    try:
        ZoneInfo(text)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(f"knows no {text!r}; give a name such as Europe/Berlin or UTC.") from None
    return text


def monitor_address(text: str) -> MonitorAddress:
    """Read ``[HOST:]PORT``; empty for any free port of this machine."""
    host, _, port = text.rpartition(":")
    if text and not _is_port(port):
        raise ValueError(f"takes PORT or HOST:PORT, not {text!r}.")
    return MonitorAddress(host or "127.0.0.1", int(port or 0))


def metrics_port(text: str) -> int:
    """Read a port; empty for 0, that of the cluster."""
    if text and not (_is_port(text) and int(text)):
        raise ValueError("takes a PORT of this machine, from 1 to 65535, such as --ray-metrics 9465.")
    return int(text or 0)


def log_format(text: str) -> LogFormat:
    """Read how messages are written."""
    for name in FORMATS:
        if name == text:
            return name
    raise ValueError(f"takes {' or '.join(FORMATS)}, not {text!r}.")


def existing_folder(text: str) -> Path:
    """Read the path of a folder that must be there."""
    path = Path(text).absolute()
    if not path.is_dir():
        raise ValueError(f"names {text}, which is no folder; check the path.")
    return path


def ignored(words: Sequence[str]) -> Ignored:
    """Read the files of what is fixed in pictures."""
    from orchestrator.ignored import read_ignored

    return read_ignored(words)


def targets(texts: Sequence[str]) -> tuple[EventTarget, ...]:
    """Read where events are sent."""
    from orchestrator.events.targets import parse_target

    return tuple(parse_target(text) for text in texts)


def clips(text: str) -> ClipSettings:
    """Read the seconds of a clip before and after an event."""
    from orchestrator.clips.settings import clip_settings

    return clip_settings(text)


def page(text: str) -> str:
    """Read the address of a page."""
    if not text.startswith(("http://", "https://")) or "?" in text or "#" in text:
        raise ValueError(f"takes an address such as https://cameras.example.org/mlbs, not {mask(text)!r}.")
    return text.rstrip("/")


def segment(text: str) -> int:
    """Read the length of segments, s."""
    from orchestrator.run.retention_limits import parse_segment

    return parse_segment(text)


def keep(texts: Sequence[str]) -> Keep | None:
    """Read how much is kept; None without limits."""
    from orchestrator.run.retention_limits import parse_keep

    return parse_keep(texts) if texts else None


def reserve(text: str) -> Reserve:
    """Read what each stream reserves."""
    from orchestrator.run.need import parse_reserve

    return parse_reserve(text)


def _is_port(text: str) -> bool:
    return text.isascii() and text.isdecimal() and int(text) < 2**16
