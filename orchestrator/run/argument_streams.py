"""The streams of the command line: each argument is one source, taken as it stands."""

from __future__ import annotations

import os
import shlex
import unicodedata
from collections.abc import Collection, Sequence
from itertools import count
from pathlib import Path

from mlbs_actors.errors import ConfigError, SourceError
from orchestrator.credentials import mask
from orchestrator.program import command_line_of
from orchestrator.run.listed_stream import MAX_NAME_BYTES, RESERVED_NAMES, UNSAFE_CHARACTERS, ListedStream
from orchestrator.run.stream_list import MAX_STREAMS
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.presence import is_image, is_source, parts_of

__all__ = ["DEMO", "argument_address", "argument_streams", "default_output"]

#: What the argument ``demo`` stands for, unless there is a file of that name.
DEMO = "synthetic:street?frames=60"

#: Most words that a path with spaces is assembled from, to tell its user to quote it.
_MOST_WORDS = 12


def argument_address(word: str) -> SourceAddress:
    """Read one argument.

    Raises
    ------
    ConfigError
        If it is no known kind of source.
    """
    if not _is_text(word):
        raise ConfigError(f"the file name {word!r} is not UTF-8 text; rename the file")
    if is_source(word):
        return parse_address(str(Path(word).absolute()), Path())  # whatever it looks like, it is a file
    return parse_address(DEMO if word == "demo" else word, Path())


def argument_streams(words: Sequence[str], taken: Collection[str] = ()) -> tuple[ListedStream, ...]:
    """Turn arguments into streams, with a name for each.

    A name is the last part of the source's path. One that is taken gets a number: ``clip``, ``clip-2``.

    Parameters
    ----------
    words : sequence of str
        A video file, a folder, a glob, the URI of a camera or scene, or ``demo`` each.
    taken : collection of str
        Names of other streams.

    Raises
    ------
    ConfigError
        If an argument cannot be a source.
    """
    _refuse_unquoted(words)
    _refuse_single_images(words)
    used = {name.lower() for name in (*taken, *RESERVED_NAMES)}
    streams = []
    for word in words:
        for source in _sources_of(word):
            base = _allowed(source.default_name)
            names = (base if number == 1 else f"{base}-{number}" for number in count(1))
            name = next(name for name in names if name.lower() not in used)
            used.add(name.lower())
            streams.append(ListedStream(name, source, None))
    if len(streams) > MAX_STREAMS:
        raise ConfigError(f"The arguments are more than {MAX_STREAMS} streams; start several runs.")
    return tuple(streams)


def default_output(words: Sequence[str], *, resume: bool) -> Path:
    """Choose the folder of a run whose arguments name its sources, and no ``--output``.

    For a single file or folder it is ``NAME-objects`` beside it, otherwise ``out``. As no run may overwrite
    another, it is the first of ``out``, ``out-2`` and so on that does not exist, or to resume, the last that
    does.
    """
    base = Path("out")
    if len(words) == 1 and os.path.lexists(words[0]) and (path := Path(words[0])).stem.strip("."):
        base = path.with_name(f"{path.name if path.is_dir() else path.stem}-objects")
    previous = base
    for number in count(1):
        folder = base if number == 1 else base.with_name(f"{base.name}-{number}")
        if not folder.exists():
            return previous if resume else folder
        previous = folder
    raise AssertionError("not reached")


def _sources_of(word: str) -> list[SourceAddress]:
    try:
        source = argument_address(word)
        if word.endswith(".txt") and Path(source.location).is_file():
            raise ConfigError(
                f"the file {word} is text; {command_line_of('--streams', word)} would read it as a list of "
                "streams"
            )
        return parts_of(source) or [source]
    except (ConfigError, SourceError) as error:
        text = mask(str(error)).rstrip(".")
        raise ConfigError(f"{text[0].upper()}{text[1:]}.") from None


def _refuse_unquoted(words: Sequence[str]) -> None:
    """Raise ConfigError if several words are the path of one source with spaces."""
    exists = [is_source(word) for word in words]
    for start in range(len(words)):
        for end in range(start + 2, min(start + _MOST_WORDS, len(words)) + 1):
            path = " ".join(words[start:end])
            if not all(exists[start:end]) and is_source(path):
                fixed = [*words[:start], path, *words[end:]]
                raise ConfigError(
                    f"The path {path} holds spaces, so put it in quotes: {command_line_of(*fixed)}"
                )


def _refuse_single_images(words: Sequence[str]) -> None:
    """Raise ConfigError if a shell has replaced a glob of images: one stream was meant."""
    images = [Path(word) for word in words if is_image(word)]
    folders: dict[Path, Path] = {}
    for image in images:
        other = folders.setdefault(image.parent, image)
        if other != image:
            glob = shlex.quote(str(image.parent / f"*{image.suffix}"))
            raise ConfigError(
                f"{other} and {image} are images of one folder, given one by one; to make them one stream, "
                f"name the folder, {shlex.quote(str(image.parent))}, or put the glob in quotes: {glob}"
            )


def _allowed(name: str) -> str:
    """Make a name that a list of streams would accept too."""
    unsafe = UNSAFE_CHARACTERS | set("/\\")
    kept = "".join(
        "-" if character in unsafe or unicodedata.category(character) in ("Cc", "Cs") else character
        for character in name.replace("***", "-")
    ).strip()
    kept = kept.lstrip(".-").rstrip(". ") or "stream"
    room = MAX_NAME_BYTES - len(f"-{MAX_STREAMS}")
    return kept.encode()[:room].decode(errors="ignore") if len(kept.encode()) > MAX_NAME_BYTES else kept


def _is_text(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:
        return False
    return True
