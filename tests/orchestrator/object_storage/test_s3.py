"""The command with a local S3 server: killed, gone on with on another disk, fenced, and fetched."""

from __future__ import annotations

import importlib.util
import os
import random
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from whole_run import REPOSITORY, run_whole

from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.record_tables import read_rows
from orchestrator.object_storage.address import StoreAddress
from orchestrator.object_storage.ledger import read_standing
from orchestrator.object_storage.store import ObjectStore, open_store

FRAMES = 2400
SOURCE = f"synthetic:street?frames={FRAMES}&width=160&height=120"
SECRET = "s3cr3t-of-the-store"

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(importlib.util.find_spec("obstore") is None, reason="needs the extra object-storage"),
    pytest.mark.skipif(importlib.util.find_spec("moto") is None, reason="needs pip install 'moto[server]'"),
]


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """A bucket on a server of this machine, which the environment names."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setenv("AWS_ENDPOINT_URL", url)
    monkeypatch.setenv("AWS_REGION", "us-east-1")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "somebody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    with (tmp_path / "server.log").open("w") as log:
        server = subprocess.Popen(
            [sys.executable, "-m", "moto.server", "-p", url.rpartition(":")[2]], stdout=log, stderr=log
        )
        try:
            for _ in range(600):
                try:
                    urllib.request.urlopen(urllib.request.Request(f"{url}/bucket", method="PUT")).close()
                    break
                except OSError:
                    time.sleep(0.1)
            yield "s3://bucket"
        finally:
            server.kill()
            server.wait()


def command(address: str, scratch: Path) -> list[str]:
    run = [sys.executable, "-m", "orchestrator", SOURCE, "--resume"]
    return [*run, "--output", address, "--scratch", str(scratch)]


def published_masks(store: ObjectStore) -> int:
    return sum(name.endswith(".png") for name in read_standing(store).files)


def test_a_run_that_is_killed_goes_on_on_another_disk(bucket: str, tmp_path: Path) -> None:
    address, dice = f"{bucket}/runs/street", random.Random()
    store = open_store(StoreAddress(address))
    for number in range(3):
        before = published_masks(store)
        with (tmp_path / f"{number}.log").open("w") as log:
            started = subprocess.Popen(
                command(address, tmp_path / f"disk{number}"),
                cwd=REPOSITORY,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            try:
                while started.poll() is None and published_masks(store) <= before:
                    time.sleep(0.2)
                if number == 0:
                    other = subprocess.run(
                        command(address, tmp_path / "other"),
                        cwd=REPOSITORY,
                        capture_output=True,
                        text=True,
                        timeout=120,
                        check=False,
                    )
                    assert other.returncode == 2
                    assert f"Another run is at work at {address}" in other.stderr
                time.sleep(dice.uniform(0, 3))
            finally:
                if started.poll() is None:
                    os.killpg(started.pid, signal.SIGKILL)
                started.wait()
    ended = run_whole(*command(address, tmp_path / "last")[3:])
    assert ended.returncode == 0, ended.stderr
    assert f"Results: {address}" in ended.stderr
    fetched = subprocess.run(
        [sys.executable, "-m", "orchestrator.fetch", address, str(tmp_path / "fetched")],
        cwd=REPOSITORY,
        check=False,
    )
    assert fetched.returncode == 0
    assert run_whole(SOURCE, "--output", tmp_path / "plain").returncode == 0
    found, plain = (next(tmp_path.glob(f"{name}/*/masks")).parent for name in ("fetched", "plain"))
    assert len(list(plain.glob("masks/*.png"))) == FRAMES
    assert {path.name: path.read_bytes() for path in found.glob("masks/*")} == {
        path.name: path.read_bytes() for path in plain.glob("masks/*")
    }
    assert [*read_rows(found)] == [*read_rows(plain)]
    assert read_commits(found)[-1].last == read_commits(plain)[-1].last == FRAMES - 1
    for name in ("objects.csv", "events.jsonl"):
        assert (found / name).read_bytes() == (plain / name).read_bytes()
    texts = [
        path for path in tmp_path.rglob("*") if path.is_file() and path.suffix in (".log", ".json", ".html")
    ]
    assert not [path for path in texts if SECRET in path.read_text(encoding="utf-8")]
