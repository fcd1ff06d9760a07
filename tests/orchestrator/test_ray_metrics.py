"""The figures of the streams by way of Ray's metrics, and what is scraped from its exporter."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from mlbs_actors.errors import ConfigError
from orchestrator.command_line import parse
from orchestrator.counts.stream_counts import StreamCounts
from orchestrator.events.delivery import Backlog
from orchestrator.monitor import ray_metrics
from orchestrator.monitor.metrics import COUNT_METRICS, METRICS, STATE, TARGET_METRICS
from orchestrator.monitor.ray_metrics import RayMetrics
from orchestrator.ray_session import ray_session
from orchestrator.run.stream_state import StreamState, after_loss

ROOT = Path(__file__).resolve().parents[2]
LIST = ["--streams", "list.txt"]


class FakeMetric:
    """Keeps the last value of each set of labels, as Ray does."""

    every: dict[str, dict[tuple[str, ...], float]]

    def __init__(self, name: str, description: str, tag_keys: tuple[str, ...]) -> None:
        self._values = self.every.setdefault(name, {})
        self._keys = tag_keys

    def set(self, value: float, tags: dict[str, str]) -> None:
        self._values[tuple(tags[key] for key in self._keys)] = value

    def inc(self, value: float, tags: dict[str, str]) -> None:
        assert value > 0
        place = tuple(tags[key] for key in self._keys)
        self._values[place] = self._values.get(place, 0) + value


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[tuple[str, ...], float]]:
    monkeypatch.setattr(FakeMetric, "every", {}, raising=False)
    monkeypatch.setattr(ray_metrics, "Counter", FakeMetric)
    monkeypatch.setattr(ray_metrics, "Gauge", FakeMetric)
    return FakeMetric.every


def test_ray_is_told_the_figures_that_the_page_serves(told: dict[str, dict[tuple[str, ...], float]]) -> None:
    metrics = RayMetrics()
    state = StreamState("yard", "running", read=20, committed=8, layers=3, frames_per_second=4.25)
    metrics.update([state, StreamState("late")])
    metrics.update([replace(state, read=36, dropped=2, latency_ms=500.0), StreamState("late")])
    names = [{one.name for one in METRICS}, {one.name for one in TARGET_METRICS}]
    assert set(told) == set.union(*names, {one.name for one in COUNT_METRICS}, {STATE})
    # Before they count anything counters are there, so that a Prometheus sees them begin.
    nothing = pytest.approx(0, abs=1e-300)
    assert told["mlbs_stream_read_frames_total"] == {("yard",): 36, ("late",): nothing}
    assert told["mlbs_stream_committed_frames_total"] == {("yard",): 8, ("late",): nothing}
    assert told["mlbs_stream_dropped_frames_total"] == {("yard",): 2, ("late",): nothing}
    assert told["mlbs_stream_latency_seconds"] == {("yard",): 0.5, ("late",): 0}
    assert told["mlbs_stream_queued_frames"] == {("yard",): 26, ("late",): 0}
    assert told[STATE] == {("yard", "running"): 1, ("late", "waiting"): 1}


def test_a_counter_never_falls_and_a_frame_that_is_read_again_counts_once(
    told: dict[str, dict[tuple[str, ...], float]],
) -> None:
    metrics = RayMetrics()
    running = StreamState("yard", "running", read=40)
    for state in (
        running,
        after_loss(running, "Lost."),
        replace(running, read=32),
        replace(running, read=48),
    ):
        metrics.update([state])
    assert told["mlbs_stream_read_frames_total"] == {("yard",): 48}
    assert told[STATE] == {("yard", "running"): 1, ("yard", "starting"): 0}


def test_what_waits_for_a_target_of_events_is_told_once_a_second(
    told: dict[str, dict[tuple[str, ...], float]],
) -> None:
    now, waiting = [10.0], [3]
    metrics = RayMetrics(lambda: [Backlog("mqtt://broker/***", waiting[0], None)], lambda: now[0])
    for now[0], waiting[0], known in ((10.0, 3, 3), (10.5, 4, 3), (11.0, 5, 5)):
        metrics.update([])
        assert told["mlbs_events_waiting"] == {("mqtt://broker/***",): known}
    assert told["mlbs_events_away_seconds"] == {("mqtt://broker/***",): 0}


def test_what_is_counted_is_told_once_a_second_and_no_zone_that_is_gone_goes_on(
    told: dict[str, dict[tuple[str, ...], float]],
) -> None:
    now = [10.0]
    counts = [
        StreamCounts(zones={"yard": 2}, crossings={"fence": {"left": 3, "right": 0}}),
        StreamCounts(zones={"lane": 1}, crossings={"fence": {"left": 5, "right": 0}}),
    ]
    metrics = RayMetrics(clock=lambda: now[0], counts=lambda stream: counts[0])
    metrics.update([StreamState("gate", "running")])
    assert told["mlbs_zone_objects"] == {("gate", "yard"): 2}
    now[0], counts[0] = 11.0, counts[1]
    metrics.update([StreamState("gate", "running")])
    assert told["mlbs_zone_objects"] == {("gate", "yard"): 0, ("gate", "lane"): 1}
    nothing = pytest.approx(0, abs=1e-300)
    assert told["mlbs_line_crossings_total"] == {
        ("gate", "fence", "left"): 5,
        ("gate", "fence", "right"): nothing,
    }


def test_nothing_goes_on_of_a_stream_that_was_taken_from_the_list(
    told: dict[str, dict[tuple[str, ...], float]],
) -> None:
    metrics = RayMetrics()
    metrics.update([StreamState("yard", "running", read=8, layers=3, frames_per_second=2.0)])
    metrics.update([])
    assert set(told[STATE].values()) == {0}
    assert told["mlbs_stream_frames_per_second"] == told["mlbs_stream_layers"] == {("yard",): 0}


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--ray-metrics"], "takes a PORT"),
        (["--ray-metrics", "0"], "takes a PORT"),
        (["--ray-metrics", "0.0.0.0:9465"], "takes a PORT"),
        (["--address", "auto", "--ray-metrics", "9465"], "without PORT"),
    ],
)
def test_a_port_is_named_where_the_run_chooses_it_and_nowhere_else(words: list[str], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse([*LIST, *words])
    assert parse([*LIST, "--ray-metrics", "9465"]).ray_metrics == 9465
    assert parse([*LIST, "--address", "auto", "--ray-metrics"]).ray_metrics == 0
    assert parse(LIST).ray_metrics is None


def test_what_keeps_ray_from_exporting_is_told_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray.dashboard.optional_deps", None)
    with pytest.raises(ConfigError, match="pip install"), ray_session(None, tmp_path, 9465):
        pass
    monkeypatch.setitem(sys.modules, "ray.dashboard.optional_deps", os)  # as if all were there
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port {port}"), ray_session(None, tmp_path, port):
            pass


@pytest.mark.long
def test_a_prometheus_finds_every_figure_at_the_port_on_this_machine_only(tmp_path: Path) -> None:
    pytest.importorskip(
        "ray.dashboard.optional_deps", reason="ray[default] is not installed, see CONTRIBUTING.md"
    )
    from prometheus_client.parser import text_string_to_metric_families

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    (tmp_path / "list.txt").write_text(
        '"yard 2" synthetic:demo?frames=12&width=64&height=48\ngate rtsp://bob:hunter2@127.0.0.1:1/x\n'
    )
    command = [sys.executable, "-m", "orchestrator", *LIST, "--watch", "--ray-metrics", str(port)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RAY_metrics_report_interval_ms": "1000"}
    with (tmp_path / "said").open("w") as said:
        run = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=said, stderr=said)
    try:
        url, text = f"http://127.0.0.1:{port}/metrics", ""
        while 'state="done"' not in text:
            assert run.poll() is None, (tmp_path / "said").read_text()
            time.sleep(0.5)
            try:
                text = urlopen(url).read().decode()
            except OSError:
                continue
        outside = [name for name in host_addresses() if is_open(name, port)]
        assert outside == []
        assert is_open("127.0.0.1", port)
        with pytest.raises(HTTPError, match="401"):  # Ray's agent, which runs what it is told to
            urlopen("http://127.0.0.1:52365/api/job_agent/jobs/")
    finally:
        run.send_signal(signal.SIGINT)
        run.wait()
    samples = {
        (
            sample.name.removeprefix("ray_"),
            sample.labels.get("stream"),
            sample.labels.get("state"),
        ): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
    for one in METRICS:
        assert (one.name, "yard 2", None) in samples
    assert samples["mlbs_stream_read_frames_total", "yard 2", None] == 12
    assert samples["mlbs_stream_committed_frames_total", "yard 2", None] == 12
    assert samples[STATE, "yard 2", "done"] == 1
    assert samples[STATE, "yard 2", "running"] == 0
    assert "hunter2" not in text
    assert "hunter2" not in (tmp_path / "said").read_text()


def host_addresses() -> set[str]:
    """Addresses of this machine that others can reach."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: asks which address would be used
        except OSError:
            return set()
        return {probe.getsockname()[0]} - {"127.0.0.1"}


def is_open(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=2):
            return True
    except OSError:
        return False
