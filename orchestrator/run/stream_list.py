"""The list of streams: one stream per line, ``SOURCE`` or ``NAME SOURCE``, shell quoting, ``#`` comments.

A folder or glob of videos is one stream per video, and so is a glob of folders of images.

The list may come from elsewhere, so it is not trusted: bounded in size, only the addresses of
:mod:`orchestrator.sources.address`, names that stay inside the output folder. All bad lines are reported
together, before anything starts.
"""

from __future__ import annotations

import shlex
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.wording import count_of
from orchestrator.credentials import mask
from orchestrator.program import command_line_of
from orchestrator.run.cameras_file import parse_cameras
from orchestrator.run.listed_stream import ListedStream, StreamsFile, check_name
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.presence import is_source, parts_of, require_source

__all__ = [
    "MAX_BYTES",
    "MAX_STREAMS",
    "cameras_file",
    "missing_sources",
    "parse_stream_list",
    "read_stream_list",
    "refuse_if_all",
]

MAX_BYTES = 8 * 2**20
MAX_STREAMS = 10_000

_LINES_SHOWN = 20
#: Ends of the names of files of cameras.
_YAML = (".yaml", ".yml")
#: Magic bytes of JPEG, PNG, AVI and WebP, Matroska and MPEG: the user gave the video instead of a list.
_MEDIA_BEGINNINGS = (b"\xff\xd8\xff", b"\x89PNG", b"RIFF", b"\x1aE\xdf\xa3", b"\x00\x00\x01")


def read_stream_list(path: Path) -> StreamsFile:
    """Read and check a list of streams.

    Parameters
    ----------
    path : Path
        UTF-8 text; relative paths in it are relative to its folder.

    Returns
    -------
    StreamsFile
        At least one stream, and no fault.

    Raises
    ------
    ConfigError
        If the file cannot be read, is too long, holds no stream, or has bad lines: then the message names
        every one of them, and those whose source is missing.
    """
    parsed = parse_stream_list(path)
    if parsed.faults:
        report = _fault_report(path, parsed.faults)
        # A missing source is no fault of the list; but the message should name both.
        sourceless = _sourceless(parsed.streams)
        if missing := {one.line: sentence.rstrip(".") for one, sentence in sourceless if one.line}:
            report += "\nOf the other lines, these could not run:\n" + _listing(missing)
        raise ConfigError(report)
    return parsed


def cameras_file(path: Path | None) -> Path | None:
    """Return the path of a list that is a file of cameras; None of any other, or of none."""
    return path if path is not None and path.suffix in _YAML else None


def parse_stream_list(path: Path, before: StreamsFile | None = None) -> StreamsFile:
    """Read what can be used of a list of streams, or of a file of cameras, whose name ends in ``.yaml``.

    Parameters
    ----------
    path : Path
    before : StreamsFile, optional
        An earlier version, for what cannot be used now of a file of cameras.

    Raises
    ------
    ConfigError
        If the file cannot be read, is too long, or holds neither streams nor bad lines.
    """
    is_yaml = cameras_file(path) is not None
    parsed = parse_cameras(path, path.parent, before) if is_yaml else _parse_lines(path)
    if len(parsed.streams) > MAX_STREAMS:
        raise ConfigError(f"The list {path} holds more than {MAX_STREAMS} streams; split it.")
    return parsed


def _parse_lines(path: Path) -> StreamsFile:
    streams: list[ListedStream] = []
    first_line: dict[str, int] = {}
    faults: dict[int, str] = {}
    lines = _lines(path)
    # Checked before the addresses are, which takes minutes for a million.
    if sum(bool(raw.strip()) and not raw.lstrip().startswith(b"#") for raw in lines) > MAX_STREAMS:
        raise ConfigError(f"The list {path} holds more than {MAX_STREAMS} lines with streams; split it.")
    for number, raw in enumerate(lines, start=1):
        try:
            for stream in _parse_line(raw, number, path.parent):
                same = stream.name.lower()  # for many shares and disks it is the same folder
                if same in first_line:
                    raise ConfigError(
                        f"the name {stream.name!r} is taken by line {first_line[same]} (upper and lower case "
                        "are alike); give this stream another one by writing NAME SOURCE"
                    )
                first_line[same] = number
                streams.append(stream)
        except (ConfigError, SourceError) as error:
            faults[number] = mask(str(error)).rstrip(".")
    if not streams and not faults:
        raise ConfigError(f"The list {path} holds no stream; write one a line, as NAME SOURCE.")
    return StreamsFile(tuple(streams), faults)


def missing_sources(streams: Sequence[ListedStream]) -> dict[str, str]:
    """Find streams without a source.

    Returns
    -------
    dict of str to str
        Stream name → the reason, a sentence without credentials.
    """
    return {stream.name: sentence for stream, sentence in _sourceless(streams)}


def refuse_if_all(path: Path | None, streams: Sequence[ListedStream], faults: Mapping[str, str]) -> None:
    """Raise ConfigError if all streams have a fault, for one of which a run would go on without it."""
    if streams and len(faults) == len(streams):
        listed = {stream.line: faults[stream.name].rstrip(".") for stream in streams if stream.line}
        given = [faults[stream.name] for stream in streams if stream.line is None]
        report = [] if path is None else [_fault_report(path, listed)]
        raise ConfigError("\n".join([*report, *given[:_LINES_SHOWN]]))


def _sourceless(streams: Sequence[ListedStream]) -> Iterator[tuple[ListedStream, str]]:
    """Yield the streams without a source, with the reason."""
    for stream in streams:
        try:
            require_source(stream.source)
        except SourceError as error:
            yield stream, str(error)


def _lines(path: Path) -> list[bytes]:
    try:
        if path.is_dir():
            raise ConfigError(
                f"{path} is a folder, not a list of streams; leave out --streams: "
                f"{command_line_of(str(path))}"
            )
        if not path.is_file():
            raise ConfigError(f"There is no list of streams at {path}; give an existing file with --streams.")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError(f"The list {path} cannot be read: {error}.") from error
    if content.startswith(_MEDIA_BEGINNINGS) or content[4:8] == b"ftyp":
        raise ConfigError(
            f"{path} is a video or picture, not a list of streams; leave out --streams: "
            f"{command_line_of(str(path))}"
        )
    if len(content) > MAX_BYTES:
        raise ConfigError(f"The list {path} is larger than {MAX_BYTES // 2**20} MiB; split it.")
    return content.removeprefix(b"\xef\xbb\xbf").split(b"\n")


def _parse_line(raw: bytes, number: int, folder: Path) -> list[ListedStream]:
    try:
        text = raw.decode("utf-8").strip()
    except UnicodeDecodeError:
        raise ConfigError("is not UTF-8 text") from None
    if any(unicodedata.category(character) == "Cc" and character != "\t" for character in text):
        raise ConfigError("holds a control character (NUL or alike); remove it")
    try:
        words = shlex.split(_without_comment(text))
    except ValueError:
        raise ConfigError("has a quote or backslash without its partner") from None
    if not words:
        return []
    _refuse_unquoted(text, words, folder)
    source = parse_address(words[-1], folder)
    given = words[0] if len(words) == 2 else None
    parts = parts_of(source)
    if not parts:
        name = source.default_name if given is None else given
        return [_named(name, source, number, is_given=given is not None)]
    prefix = "" if given is None else f"{given}-"
    return [_named(prefix + part.default_name, part, number, is_given=False) for part in parts]


def _refuse_unquoted(text: str, words: Sequence[str], folder: Path) -> None:
    """Raise ConfigError if a line has too many words, or its words are a path with spaces."""
    if len(words) < 2 or (len(words) == 2 and is_source(str(folder / words[1]))):
        return
    text = _without_comment(text).strip()
    name, _, rest = text.partition(" ")
    for start, path in (("", text), (f"{name} ", rest.strip())):
        if is_source(str(folder / path)):
            raise ConfigError(f"has a path with spaces; put it in quotes: {start}{shlex.quote(path)}")
    if len(words) > 2:
        # No camera is shown: quotes would hide its password from what masks it.
        example = "" if "://" in text else f": {words[0]} {shlex.quote(' '.join(words[1:]))}"
        raise ConfigError(
            f"has {len(words)} words, not SOURCE or NAME SOURCE; "
            f"put a path that holds spaces in quotes{example}"
        )


def _named(name: str, source: SourceAddress, number: int, *, is_given: bool) -> ListedStream:
    check_name(name, given=is_given)
    return ListedStream(name, source, number)


def _without_comment(text: str) -> str:
    """Cut an unquoted ``#`` that begins a word, as a shell does.

    ``shlex`` would cut inside a word too, and turn ``rtsp://bob:a#b@host`` into another address.
    """
    quote = ""
    position = 0
    while position < len(text):
        character = text[position]
        if quote:
            if character == quote:
                quote = ""
            elif character == "\\" and quote == '"':
                position += 1
        elif character == "\\":
            position += 1
        elif character in "'\"":
            quote = character
        elif character == "#" and (position == 0 or text[position - 1].isspace()):
            return text[:position]
        position += 1
    return text


def _fault_report(path: Path, faults: dict[int, str]) -> str:
    count = count_of(len(faults), "bad line")
    return f"The list {path} has {count}; nothing was started.\n{_listing(faults)}"


def _listing(faults: dict[int, str]) -> str:
    """List faulty lines, the first ones with their faults."""
    shown = [f"  line {number}: {sentence}." for number, sentence in list(faults.items())[:_LINES_SHOWN]]
    rest = list(faults)[_LINES_SHOWN:]
    if rest:
        shown.append(f"  and lines {_as_ranges(rest)}.")
    return "\n".join(shown)


def _as_ranges(numbers: Sequence[int]) -> str:
    """Write ascending numbers as ranges: ``3, 5–9``."""
    ranges: list[tuple[int, int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1] = (ranges[-1][0], number)
        else:
            ranges.append((number, number))
    return ", ".join(str(low) if low == high else f"{low}–{high}" for low, high in ranges)
