"""What a run tells its user, and what happens when nobody listens."""

from __future__ import annotations

import json
import os
import signal
import sys
from datetime import datetime, timezone
from pathlib import Path

import pytest

from orchestrator.log import Log, ending_quietly


def closed_pipe() -> int:
    """Return the writing end of a pipe whose other end is closed."""
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def test_a_message_hides_credentials_and_is_text_or_a_json_line(capsys: pytest.CaptureFixture[str]) -> None:
    Log().say("No rtsp://bob:hunter2@host/x.")
    text = capsys.readouterr().err
    assert text.startswith("No rtsp://")
    Log("json", "/out", lambda: datetime(2026, 1, 2, tzinfo=timezone.utc)).warn(
        "No rtsp://bob:hunter2@host/x."
    )
    line = capsys.readouterr().err
    assert json.loads(line) == {
        "time": "2026-01-02T00:00:00.000Z",
        "level": "warning",
        "run": "/out",
        "stream": None,
        "event": "message",
        "message": text.strip(),
    }
    assert "hunter2" not in text + line
    Log("json").say("It is gone.", "error", "gate")
    assert json.loads(capsys.readouterr().err)["stream"] == "gate"


def test_a_line_that_nobody_reads_asks_once_for_the_end_and_later_ones_go_nowhere() -> None:
    log, asked = Log(), list[int]()
    log.on_reader_gone = asked.append
    with open(closed_pipe(), "w") as output:
        for _ in range(3):
            log.write(output, "a line")
    assert asked == [signal.SIGPIPE]


def test_a_line_that_nobody_reads_before_the_run_begins_is_its_end() -> None:
    with open(closed_pipe(), "w") as output, pytest.raises(SystemExit) as end:
        Log().write(output, "a line")
    assert end.value.code == 141


def test_what_is_left_to_write_when_nobody_reads_any_more_is_no_complaint(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with open(closed_pipe(), "w") as output, (tmp_path / "other").open("w") as other:
        monkeypatch.setattr(sys, "stdout", output)
        monkeypatch.setattr(sys, "stderr", other)
        with pytest.raises(SystemExit) as end, ending_quietly():
            print("a line that is still in the buffer")
    assert end.value.code == 141
