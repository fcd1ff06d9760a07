"""Existence of sources on disk, checked without opening or decoding anything.

Nothing here imports Ray, so a list of streams can be checked before anything starts.
"""

from __future__ import annotations

import glob
import os
import re
import shlex
from collections.abc import Collection
from contextlib import suppress
from decimal import Decimal
from difflib import get_close_matches
from functools import partial
from itertools import islice
from pathlib import Path

from mlbs_actors.errors import SourceError
from orchestrator.sources.address import SourceAddress, SourceKind, fixed_part, has_wildcards
from orchestrator.sources.libav_policy import has_protocol

__all__ = [
    "holds_images",
    "images_of",
    "is_image",
    "is_source",
    "parts_of",
    "require_source",
]

_IMAGE_SUFFIXES = frozenset(
    {".apng", ".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"}
)

_VIDEO_SUFFIXES = frozenset(
    {".3gp", ".avi", ".dav", ".flv", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ogv"}
    | {".ts", ".webm", ".wmv"}
)

#: A stem that ends in a number as Python writes a float, such as time.time(): without zeros at the end.
_DECIMAL_STEM = re.compile(r"(.*[^\d.])?\d+\.(0|\d*[1-9])")

#: Most names in a folder that a missing one is compared with.
_NAMES_COMPARED = 2_000


def is_image(path: str) -> bool:
    """Whether there is a file at a path whose name ends as those of images do."""
    return Path(path).suffix.lower() in _IMAGE_SUFFIXES and os.path.isfile(path)  # noqa: PTH113, it also takes long names


def is_source(path: str) -> bool:
    """Whether something is at a path, or matches it as a glob."""
    try:
        return os.path.lexists(path) or (has_wildcards(path) and any(glob.iglob(_pattern(path))))  # noqa: PTH207
    except (OSError, ValueError):
        return False  # such as a name that is too long


def parts_of(source: SourceAddress) -> list[SourceAddress]:
    """List the streams that one source stands for.

    Returns
    -------
    list of SourceAddress
        Of a folder or glob of videos, each video; of a glob of folders of images, each folder; otherwise
        empty.

    Raises
    ------
    SourceError
        If the choice is ambiguous.
    """
    if source.kind is not SourceKind.PATH:
        return []
    parts = [(video.stem, video) for video in _videos_of(source.location)]
    parts += list(_image_folders_of(source.location).items())
    return [SourceAddress(SourceKind.PATH, str(path), name) for name, path in parts]


def require_source(address: SourceAddress) -> None:
    """Check that there is something to open; cheap, and nothing is decoded.

    A camera need not be there yet, but libav must know its protocol.

    Raises
    ------
    SourceError
        If the file or folder is missing, or is not of a kind that can be read.
    """
    if address.kind is SourceKind.PATH:
        try:
            _require_path(address)
        except OSError as error:
            raise SourceError(f"{address} cannot be read: {error.strerror}; check the path.") from None
    elif address.location.startswith("srt:") and not has_protocol("srt"):
        raise SourceError(
            f"{address} cannot be read, because the installed libav has no SRT; have its sender, or a relay "
            "such as MediaMTX, offer the stream over RTSP too, and name that address."
        )


def _require_path(address: SourceAddress) -> None:
    path = Path(address.location)
    if holds_images(address):
        images_of(address.location)
    elif not path.exists():
        raise SourceError(f"There is no file or folder {address}; {_advice_on(path)}")
    elif not path.is_file():
        # A pipe would block its reader for ever.
        raise SourceError(f"{address} is no regular file; name a video file or a folder of images.")
    elif not os.access(path, os.R_OK):
        raise SourceError(f"The file {address} cannot be read; change its permissions.")
    elif path.stat().st_size == 0:
        raise SourceError(f"The file {address} is empty; copy it again.")


def _advice_on(missing: Path) -> str:
    """Say which name in its folder is meant, if one is nearly the same."""
    alike: dict[str, str] = {}
    with suppress(OSError):  # the folder is missing, too, or cannot be listed
        there = (path.name for path in islice(missing.parent.iterdir(), _NAMES_COMPARED))
        ending = missing.suffix.lower()
        alike = {name.lower(): name for name in there if Path(name).suffix.lower() == ending}
    near = get_close_matches(missing.name.lower(), alike, n=1, cutoff=0.85)
    return f"did you mean {alike[near[0]]!r}?" if near else "check the path."


def holds_images(address: SourceAddress) -> bool:
    """Whether the address is a folder, a glob or an image."""
    path = Path(address.location)
    if address.kind is not SourceKind.PATH:
        return False
    return (
        path.is_dir()
        or _is_glob(address.location)
        or (path.is_file() and path.suffix.lower() in _IMAGE_SUFFIXES)
    )


def _videos_of(location: str) -> list[Path]:
    """List the videos of a folder, or those that match a glob, in natural order; empty if there are none.

    Raises
    ------
    SourceError
        If there are images too, so that the choice is ambiguous.
    """
    try:
        if not (Path(location).is_dir() or _is_glob(location)):
            return []
    except OSError:
        return []  # such as a name that is too long; opening it will report that
    videos = _files_of(location, _VIDEO_SUFFIXES)
    if videos and (images := _files_of(location, _IMAGE_SUFFIXES)):
        raise SourceError(
            f"{location} holds videos and images, such as {videos[0].name} and {images[0].name}; "
            f"name one kind by a glob such as {_quoted_glob(videos[0])}."
        )
    return videos


def _image_folders_of(location: str) -> dict[str, Path]:
    """Find the folders of images that match a glob, or whose images do, in natural order.

    Returns
    -------
    dict of str to Path
        Match of the last wildcard for a folder → the folder, or the glob of its images; empty if the location
        is no glob, or one of images in a single folder.

    Raises
    ------
    SourceError
        If two folders would have the same name.
    """
    if not _is_glob(location):
        return {}
    folders = Path(location)
    if images := _files_of(location, _IMAGE_SUFFIXES):
        # Images of one data set, each in its folder, are not one sequence.
        pattern, folders = folders.name, folders.parent
        paths = {image.parent: Path(glob.escape(str(image.parent))) / pattern for image in images}
        if len(paths) == 1:
            return {}
    else:
        matches = map(Path, glob.glob(_pattern(location)))  # noqa: PTH207
        paths = {one: one for one in matches if one.is_dir() and _files_of(str(one), _IMAGE_SUFFIXES)}
    depth = max(place for place, part in enumerate(folders.parts) if has_wildcards(part))
    found: dict[str, Path] = {}
    for folder in sorted(paths, key=_natural_order):
        path = paths[folder]
        other = found.setdefault(folder.parts[depth], path)
        if other is not path:
            raise SourceError(f"{other} and {path} would have the same name; write a line for each.")
    return found


def images_of(location: str) -> list[Path]:
    """List the images of a folder, or those that match a glob, in natural order.

    Raises
    ------
    SourceError
        If there are none, or the masks of two would have the same name.
    """
    visible = _files_of(location, _IMAGE_SUFFIXES)
    if not visible and _image_folders_of(f"{location}/*"):
        raise SourceError(
            f"There are no images in {location} itself; for a stream a folder write "
            f"{shlex.quote(f'{location}/*')}."
        )
    if not visible and (deeper := _files_of(f"{location}/*/*", _VIDEO_SUFFIXES)):
        videos = shlex.quote(f"{location}/*/*{deeper[0].suffix}")
        raise SourceError(
            f"There are no videos in {location} itself; for those in its folders write {videos}."
        )
    if not visible:
        raise SourceError(
            f"There are no videos and no images at {location}; check the path, and whether the names of the "
            f"files end in {_suffix_list(_VIDEO_SUFFIXES)} or, for images, {_suffix_list(_IMAGE_SUFFIXES)}."
        )
    first_of: dict[str, Path] = {}
    for path in visible:
        other = first_of.setdefault(path.stem, path)
        if other is not path:
            raise SourceError(
                f"{other} and {path} would have the same mask, {path.stem}.png; "
                f"name one kind of file by a glob such as {_quoted_glob(path)}."
            )
    return visible


def _is_glob(location: str) -> bool:
    return fixed_part(Path(location)) != Path(location)


def _pattern(location: str) -> str:
    """Write a path as a glob: wildcards in the names of existing folders stand for themselves."""
    path = Path(location)
    fixed = fixed_part(path)
    return str(Path(glob.escape(str(fixed))) / path.relative_to(fixed))


def _files_of(location: str, suffixes: Collection[str]) -> list[Path]:
    folder = Path(location)
    try:
        # Path.glob takes no absolute patterns.
        names = folder.iterdir() if folder.is_dir() else glob.iglob(_pattern(location))  # noqa: PTH207
        found = [Path(name) for name in names]
    except OSError as error:
        raise SourceError(f"The files of {location} cannot be listed: {error.strerror}.") from None
    shown = [path for path in found if path.suffix.lower() in suffixes and not path.name.startswith(".")]
    fitting = [path for path in shown if path.is_file()]
    decimal = all(_DECIMAL_STEM.fullmatch(path.stem) for path in fitting)
    return sorted(fitting, key=partial(_natural_order, number=r"\d+(?:\.\d+)?" if decimal else r"\d+"))


def _natural_order(path: Path, number: str = r"\d+") -> tuple[list[tuple[int, Decimal, str]], str]:
    """Sort key by which frame10 comes after frame9; equal numbers (1, 01) fall back to the text."""
    parts = re.split(f"({number})", str(path))
    key = [(0, Decimal(part), "") if part[0].isdecimal() else (1, Decimal(), part) for part in parts if part]
    return key, str(path)


def _quoted_glob(path: Path) -> str:
    """Write the glob of a file's kind in its folder, as a shell and a list of streams take it."""
    return shlex.quote(str(path.parent / f"*{path.suffix}"))


def _suffix_list(suffixes: Collection[str]) -> str:
    return ", ".join(sorted(suffix.removeprefix(".") for suffix in suffixes))
