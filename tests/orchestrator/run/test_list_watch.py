"""A list that is read again while the run goes on: what comes, what goes, what is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.run.list_watch import ListChange, ListWatch
from orchestrator.run.stream_list import read_stream_list


class Watched:
    """A list on the disk, and a watch of it on a clock that only the test moves."""

    def __init__(self, folder: Path, text: str) -> None:
        self.path = folder / "list.txt"
        for name in ("a", "b", "c", "d"):
            (folder / f"{name}.mp4").write_text("a video")
        self.path.write_text(text)
        self.now = 0.0
        self.told: list[str] = []
        self.records = {name: str(folder / f"{name}.mp4") for name in ("a", "b")}
        self.watch = ListWatch(
            self.path,
            read_stream_list(self.path),
            self.records.get,
            self.told.append,
            clock=lambda: self.now,
        )

    def look(self) -> ListChange | None:
        self.now += 1.0
        return self.watch.look()

    def change(self, text: str) -> ListChange | None:
        """Write the list and look until it has been seen twice."""
        self.path.write_text(text)
        assert self.look() is None, "a list that may be half-written was taken"
        return self.look()


@pytest.fixture
def watched(tmp_path: Path) -> Watched:
    return Watched(tmp_path, "a.mp4\nb.mp4\n")


def named(change: ListChange | None) -> tuple[list[str], list[str]]:
    assert change is not None
    return [stream.name for stream in change.added], list(change.removed)


def test_new_lines_are_new_streams_and_lines_that_are_gone_end_theirs(watched: Watched) -> None:
    assert watched.look() is None
    change = watched.change("# changed\nc.mp4\nb.mp4\nlast d.mp4\n")
    assert named(change) == (["c", "last"], ["a"])
    assert change is not None
    assert [stream.line for stream in change.added] == [2, 4]
    assert [watched.look() for _ in range(3)] == [None] * 3
    assert watched.told == []


def test_the_list_is_looked_at_twice_a_second_at_most(watched: Watched) -> None:
    watched.path.write_text("a.mp4\nb.mp4\nc.mp4\n")
    for _ in range(8):
        watched.now += 0.05
        assert watched.watch.look() is None
    watched.now += 0.45
    assert watched.watch.look() is None
    watched.now += 0.55
    assert named(watched.watch.look()) == (["c"], [])


@pytest.mark.parametrize(
    ("bad", "told"),
    [
        ("ftp://x/y", "line 3: 'ftp' is no known kind of source"),
        ("gone.mp4", "line 3: There is no file or folder"),
        ("b c.mp4", "line 3: the name 'b' is taken by line 2"),
        ("x y z", "line 3: has 3 words"),
    ],
)
def test_a_bad_line_is_told_and_ignored_until_it_is_mended(watched: Watched, bad: str, told: str) -> None:
    assert named(watched.change(f"a.mp4\nb.mp4\n{bad}\nd.mp4\n")) == (["d"], [])
    assert len(watched.told) == 1
    assert told in watched.told[0]
    assert watched.told[0].endswith("The line is ignored until it is mended.")
    assert watched.look() is None
    assert named(watched.change("a.mp4\nb.mp4\nc.mp4\nd.mp4\n")) == (["c"], [])
    assert [text.rpartition("/")[2] for text in watched.told[1:]] == [
        "list.txt can be used again, all of it."
    ]


def test_nothing_ends_while_a_line_is_bad(watched: Watched) -> None:
    assert watched.change("a.mp4\nb mp4 b.mp4\n") is None
    assert named(watched.change("a.mp4\n")) == ([], ["b"])


def test_a_name_stands_for_one_source_throughout_a_run(watched: Watched) -> None:
    assert watched.change("a c.mp4\nb.mp4\n") is None
    assert "line 1: the name 'a' stands for " in watched.told[0]
    assert named(watched.change("b.mp4\n")) == ([], ["a"])
    assert watched.change("a d.mp4\nb.mp4\n") is None
    assert named(watched.change("a2 a.mp4\nb.mp4\n")) == (["a2"], [])


def test_a_stream_that_left_may_come_back_with_the_same_source(watched: Watched) -> None:
    assert named(watched.change("b.mp4\n")) == ([], ["a"])
    assert named(watched.change("a.mp4\nb.mp4\n")) == (["a"], [])


def test_a_stream_that_left_before_it_had_a_record_may_come_again(watched: Watched) -> None:
    watched.change("a.mp4\nb.mp4\nc.mp4\n")
    assert named(watched.change("a.mp4\nb.mp4\n")) == ([], ["c"])
    assert named(watched.change("a.mp4\nb.mp4\nc d.mp4\n")) == (["c"], [])


@pytest.mark.parametrize("text", ["", "# nothing\n", "\xff\xd8\xff"])
def test_a_list_that_cannot_be_read_changes_nothing(watched: Watched, text: str) -> None:
    watched.path.write_bytes(text.encode("latin-1"))
    assert [watched.look() for _ in range(3)] == [None] * 3
    assert watched.told[0].endswith("Nothing is changed.")
    watched.path.unlink()
    assert [watched.look() for _ in range(3)] == [None] * 3
    assert named(watched.change("a.mp4\n")) == ([], ["b"])


def test_a_camera_may_be_at_another_address(tmp_path: Path) -> None:
    watched = Watched(tmp_path, "a.mp4\ncam rtsp://bob:wrong@host/one\n")
    watched.records["cam"] = "rtsp://***@host/one"
    for line in ("cam rtsp://bob:right@host/one", "cam rtsp://bob:right@other/two", "cam http://host/"):
        change = watched.change(f"a.mp4\n{line}\n")
        assert change is not None
        assert (change.added, change.removed) == ((), ())
        assert [stream.source.location for stream in change.changed] == [line.removeprefix("cam ")]
    assert watched.change("a.mp4\ncam b.mp4\n") is None  # no camera
    assert "only a camera can be at another address" in watched.told[0]


def test_a_renamed_camera_does_not_run_twice_while_a_line_is_bad(tmp_path: Path) -> None:
    watched = Watched(tmp_path, "a.mp4\nlane rtsp://host/lane\n")
    change = watched.change("a.mp4\nroad rtsp://host/lane\nx y z\n")
    assert named(change) == (["road"], ["lane"])
