"""Which folders are the record of a stream."""

from __future__ import annotations

from pathlib import Path

import pytest
from record_fakes import write_run, write_stream

from mlbs_actors.errors import ConfigError
from mlbs_actors.record import recorded_stream


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_run(tmp_path, [write_stream(tmp_path / "yard")])
    return tmp_path


def test_a_stream_is_read_whether_its_folder_is_a_path_or_text(run: Path) -> None:
    frames = [one.index for one in recorded_stream(run / "yard")]
    assert frames
    assert [one.index for one in recorded_stream(str(run / "yard"))] == frames


def test_what_is_no_stream_is_told_at_once(run: Path) -> None:
    with pytest.raises(ConfigError, match=r"There is no stream in .*yrad; name the folder of a stream"):
        recorded_stream(run / "yrad")
    with pytest.raises(ConfigError, match=r"is a run; name the folder of one of its streams: yard\."):
        recorded_stream(run)
    with pytest.raises(ConfigError, match="There is no stream in nowhere"):
        recorded_stream("nowhere")


def test_a_stream_of_a_run_that_has_not_begun_has_no_frames(run: Path) -> None:
    (run / "yard").rename(run / "elsewhere")
    assert list(recorded_stream(run / "yard")) == []
