"""How many clips stay."""

from __future__ import annotations

import os
from pathlib import Path

from orchestrator.clips.shelf import ClipShelf
from orchestrator.disk_use.measured import bytes_by_kind


def clip(run: Path, stream: str, number: int, size: int = 100) -> Path:
    path = run / stream / f"clips/{number:08d}-00000000.mp4"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(size))
    os.utime(path, (number, number))
    return path


def numbers(run: Path, stream: str) -> list[int]:
    return sorted(int(path.name[:8]) for path in (run / stream / "clips").glob("*"))


def test_of_each_stream_the_newest_clips_stay(tmp_path: Path) -> None:
    for number in range(5):
        clip(tmp_path, "gate", number)
    clip(tmp_path, "yard", 0)
    shelf = ClipShelf(tmp_path, most=3, most_bytes=10_000)
    assert (numbers(tmp_path, "gate"), numbers(tmp_path, "yard")) == ([2, 3, 4], [0])
    shelf.add([clip(tmp_path, "gate", 5)])
    assert numbers(tmp_path, "gate") == [3, 4, 5]


def test_of_all_streams_together_the_newest_bytes_stay(tmp_path: Path) -> None:
    shelf = ClipShelf(tmp_path, most=100, most_bytes=350)
    for number in range(6):
        shelf.add([clip(tmp_path, "gate" if number % 2 else "yard", number)])
    assert (numbers(tmp_path, "gate"), numbers(tmp_path, "yard")) == ([3, 5], [4])


def test_a_clip_of_several_events_counts_once_and_goes_as_a_whole(tmp_path: Path) -> None:
    first = clip(tmp_path, "gate", 1)
    second = first.with_name("00000002-00000000.mp4")
    second.hardlink_to(first)
    shelf = ClipShelf(tmp_path, most=2, most_bytes=250)
    shelf.add([clip(tmp_path, "gate", 3)])
    assert numbers(tmp_path, "gate") == [1, 2, 3]
    assert bytes_by_kind(tmp_path / "gate") == {"clips": 200}
    shelf.add([clip(tmp_path, "gate", 4)])
    assert numbers(tmp_path, "gate") == [3, 4]


def test_what_was_deleted_as_the_oldest_is_not_made_again(tmp_path: Path) -> None:
    for number in range(5):
        clip(tmp_path, "gate", number)
    shelf = ClipShelf(tmp_path, most=3, most_bytes=10_000)
    folder = tmp_path / "gate/clips"
    assert not shelf.takes(folder / "00000001-ffffffff.mp4")
    assert shelf.takes(folder / "00000003-ffffffff.mp4")
    roomy = ClipShelf(tmp_path, most=30, most_bytes=10_000)
    assert roomy.takes(folder / "00000001-ffffffff.mp4")


def test_remains_of_a_clip_that_was_never_finished_are_deleted(tmp_path: Path) -> None:
    part = clip(tmp_path, "gate", 1).with_name(".00000002-00000000.mp4.abcd.part")
    part.write_bytes(b"")
    ClipShelf(tmp_path, most=3, most_bytes=10_000)
    assert not part.exists()


def test_a_clip_of_a_ninth_digit_is_newer_than_one_of_eight(tmp_path: Path) -> None:
    for number in (99_990_000, 99_990_001):
        clip(tmp_path, "gate", number)
    shelf = ClipShelf(tmp_path, most=2, most_bytes=10_000)
    assert shelf.takes(tmp_path / "gate/clips/100000010-ffffffff.mp4")
