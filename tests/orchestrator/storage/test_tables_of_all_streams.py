"""The tables of a run with files and cameras are one data set, for tools that know nothing of a run."""

from __future__ import annotations

from pathlib import Path

import duckdb
import pyarrow.dataset
import pytest
from record_fakes import write_stream
from segment_fakes import Camera

from orchestrator.storage.durable_files import temporary_path
from orchestrator.storage.segments import segment_folders


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file, a camera whose newest segment is open, and what else lies in a run's folder."""
    folder = tmp_path_factory.mktemp("run")
    write_stream(folder / "yard")
    camera = Camera(folder / "gate")
    camera.send(250)
    camera.record.close(whole=False)
    assert len(segment_folders(folder / "gate")) > 1
    for name in ("ray.log", "run.json", "report.html"):
        (folder / name).write_text("no table")
    temporary_path(folder / "yard/layers-00000999.parquet").write_bytes(b"begun when it was killed")
    return folder


@pytest.mark.parametrize("table", ["layers", "frames"])
def test_one_glob_finds_every_row_of_every_stream_once(run: Path, table: str) -> None:
    tables = pyarrow.dataset.dataset(sorted(map(str, run.glob(f"**/{table}*.parquet")))).to_table()
    counted = duckdb.execute(
        f"SELECT stream, count(*) FROM '{run}/**/{table}*.parquet' GROUP BY stream"
    ).fetchall()
    streams = tables["stream"].to_pylist()
    assert sorted(counted) == [(name, streams.count(name)) for name in ("gate", "yard")]
    key = ["stream", "frame"] + ["layer"] * (table == "layers")
    assert tables.group_by(key).aggregate([]).num_rows == tables.num_rows
    if table == "frames":
        assert sorted(counted) == [("gate", 240), ("yard", 40)]
