"""Work that takes a share of the time, and the last lines of a file that grows."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.storage.last_lines import last_lines
from orchestrator.storage.share_of_time import ShareOfTime


def test_work_takes_no_more_than_its_share_whatever_it_lasts() -> None:
    now = 100.0
    work = ShareOfTime(1 / 50, 5.0, lambda: now)
    assert work.is_due
    for lasts, pause in ((0.01, 5.0), (1.0, 50.0)):
        with work.spent():
            now += lasts
        now += pause - 0.01
        assert not work.is_due
        now += 0.02
        assert work.is_due


def test_work_that_fails_stays_due() -> None:
    work = ShareOfTime(1 / 50, 5.0, lambda: 0.0)
    with pytest.raises(OSError, match="no disk"), work.spent():
        raise OSError("no disk")
    assert work.is_due


@pytest.mark.parametrize("most", [1, 3, 10])
@pytest.mark.parametrize("line_bytes", [2, 6, 100])
def test_the_last_whole_lines_are_read_whatever_stands_before_and_behind(
    tmp_path: Path, most: int, line_bytes: int
) -> None:
    lines = [f"line{number}" for number in range(5)]
    (tmp_path / "file").write_text("\n".join([*lines, "being writ"]))
    read = last_lines(tmp_path / "file", most, line_bytes)
    assert read == lines[len(lines) - len(read) :]
    if line_bytes == 100:
        assert len(read) == min(most, len(lines))


def test_of_a_file_that_is_not_there_no_line_is_read(tmp_path: Path) -> None:
    assert last_lines(tmp_path / "none", 3, 100) == []
