"""The requests to a real store: a folder, by the package that makes them to S3, too."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from mlbs_actors.errors import ConfigError
from orchestrator import fetch
from orchestrator.object_storage.address import StoreAddress, parse_store_address, scratch_place
from orchestrator.object_storage.ledger import Ledger, read_standing
from orchestrator.object_storage.manifest import Part
from orchestrator.object_storage.store import MissingObjectError, StoreError, open_store
from orchestrator.object_storage.uploads import digest_of

HAS_OBSTORE = importlib.util.find_spec("obstore") is not None

needs_obstore = pytest.mark.skipif(not HAS_OBSTORE, reason="needs the extra object-storage")


@needs_obstore
def test_a_store_does_what_is_asked_of_it(tmp_path: Path) -> None:
    store = open_store(StoreAddress(f"file://{tmp_path}/run"))
    assert store.keys("manifests") == []
    for number in (2, 1, 3):
        assert store.create(f"manifests/{number}", b"%d" % number)
    assert not store.create("manifests/2", b"another")
    assert store.get("manifests/2") == b"2"
    assert store.keys("manifests") == ["manifests/1", "manifests/2", "manifests/3"]
    assert store.keys("manifests", "manifests/2") == ["manifests/3"]
    store.put("published/1.1/a", iter([bytes(9_000_000), b"end"]))
    store.put("published/1.1/b", b"whole")
    assert store.get("published/1.1/a", 8_999_999, 4) == b"\0end"
    store.put("published/1.1/b", b"again")
    assert store.get("published/1.1/b") == b"again"
    store.delete(["published/1.1/b", "published/1.1/none"])
    for size in (None, 1):
        with pytest.raises(MissingObjectError):
            store.get("published/1.1/b", 0, size)


@needs_obstore
def test_a_server_that_does_not_answer_is_an_error_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "somebody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "s3cr3t")
    with pytest.raises(StoreError) as error:
        open_store(StoreAddress("s3://bucket/run")).keys("manifests")
    assert "\n" not in str(error.value)
    assert "s3cr3t" not in str(error.value)


@needs_obstore
def test_a_run_is_fetched_into_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    address = f"file://{tmp_path}/run"
    assert fetch.main([address, str(tmp_path / "none")]) == 2
    assert not (tmp_path / "none").exists()
    assert capsys.readouterr().err == f"There is no run at {address}.\n"
    store = open_store(StoreAddress(address))
    store.put("published/1.1/run.json", b"{}")
    ledger = Ledger(store, read_standing(store), "me", address)
    ledger.add(
        {"run.json": (Part("published/1.1/run.json", 0, 2, digest_of(iter([b"{}"]))),)}, (), ended=True
    )
    ledger.close()
    assert fetch.main([address, str(tmp_path / "found")]) == 0
    assert (tmp_path / "found/run.json").read_bytes() == b"{}"
    assert fetch.main([address, str(tmp_path / "found")]) == 2
    store.put("published/1.1/run.json", b"[]")
    assert fetch.main([address, str(tmp_path / "damaged")]) == 1
    assert "published/1.1/run.json is damaged" in capsys.readouterr().err
    assert not (tmp_path / "damaged").exists()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(ConfigError, match=r"pip install 'mlbs-actors\[object-storage\]'"):
        open_store(StoreAddress("s3://bucket/run"))


@pytest.mark.parametrize(
    "text", ["s3://bucket", "s3://bucket/", "s3://a:b@bucket/x", "gs://b/x?key=1", "file://x"]
)
def test_an_address_that_cannot_be_used_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="takes "):
        parse_store_address(text)


def test_an_address_is_read_and_has_a_place_of_its_own() -> None:
    one, other = parse_store_address("s3://bucket/runs/gate/"), parse_store_address("s3://bucket/more/gate")
    assert one == StoreAddress("s3://bucket/runs/gate")
    assert other is not None
    assert parse_store_address("/out") is parse_store_address("ftp://host/x") is None
    root = Path("/disk")
    assert scratch_place(one, root).name.startswith("gate-")
    assert scratch_place(one, root) != scratch_place(other, root)


def test_a_run_works_where_no_cache_is_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/cache")
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert scratch_place(StoreAddress("s3://bucket/run"), None).parent == Path("/state/mlbs-actors")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "/home/somebody")
    parent = scratch_place(StoreAddress("s3://bucket/run"), None).parent
    assert parent == Path("/home/somebody/.local/state/mlbs-actors")
