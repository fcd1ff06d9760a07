"""What the benchmark measures beside the methods: its arithmetic, on made-up processes and times."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from benchmark.in_process.engine_run import EngineCall, EngineCost, play, steady_cost
from benchmark.measurements.births import BirthCost, birth_cost, times_in_process, times_through_ray
from benchmark.measurements.capacity import Capacity, cameras_a_core, capacity_table
from benchmark.measurements.layers import (
    further_object_ms,
    layers_table,
    mean_further_object_ms,
    measure_layers,
    processes_table,
)
from benchmark.measurements.memory import KindMemory, memory_by_kind, memory_table, stream_mib
from benchmark.measurements.ray_cost import (
    PipelineCost,
    StartUp,
    SteadyCost,
    cost_table,
    cpu_ms_by_kind,
    start_up,
)
from benchmark.measurements.sizes import measure_sizes
from benchmark.measurements.streams import StreamsCost, most_frames_a_second, streams_table
from benchmark.plots import Plot, draw
from benchmark.settings import Settings
from benchmark.through_ray.empty_parts import EmptyParts, last_messages
from benchmark.through_ray.endless_video import EndlessReader, write_video
from benchmark.through_ray.pipeline import Arrival, SteadyWindow
from benchmark.through_ray.process_costs import (
    Process,
    cpu_growth,
    kinds_of,
    private_bytes,
    process_tree,
    sum_by_kind,
)
from mlbs_actors import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.scenes.synthetic import scene
from orchestrator.extra import require_matplotlib

ROOT = Path(__file__).resolve().parents[2]
TICK = os.sysconf("SC_CLK_TCK")


def fake_process(proc: Path, pid: int, parent: int, title: str, user: float, system: float) -> None:
    """A process as the kernel shows it; its name holds what a name may hold."""
    folder = proc / str(pid)
    folder.mkdir(parents=True, exist_ok=True)
    times = f"{round(user * TICK)} {round(system * TICK)} 0 0 20 0 1 0 {700 + pid}"
    (folder / "stat").write_text(f"{pid} (a) b (c) S {parent} 1 1 0 -1 0 0 0 0 0 {times}")
    (folder / "cmdline").write_bytes(title.encode().replace(b" ", b"\0") + b"\0")
    (folder / "smaps_rollup").write_text(
        "55d0-7ffc ---p 00000000 00:00 0 [rollup]\nRss: 900 kB\nPrivate_Clean: 24 kB\n"
        "Private_Dirty: 1000 kB\nShared_Clean: 70 kB\n"
    )


def session(proc: Path, *, layer: float = 0.0, raylet: float = 0.0) -> dict[int, Process]:
    """A driver, a raylet, two layers, a reader; and a process of somebody else."""
    fake_process(proc, 10, 1, "python -m benchmark", 1.0, 0.5)
    fake_process(proc, 11, 10, "/opt/raylet --node", 2.0 + raylet, 0.0)
    fake_process(proc, 12, 11, "ray::LayerActor.serve", 0.0 + layer, 3.0)
    fake_process(proc, 13, 11, "ray::LayerActor", 0.0, 0.0)
    fake_process(proc, 14, 11, "ray::ReaderActor.serve", 4.0, 0.0)
    fake_process(proc, 99, 1, "ray::LayerActor of another session", 50.0, 50.0)
    (proc / "meminfo").touch()
    return process_tree(10, proc)


def test_a_tree_holds_all_that_descend_and_nobody_else(tmp_path: Path) -> None:
    tree = session(tmp_path)
    assert sorted(tree) == [10, 11, 12, 13, 14]
    assert tree[10].cpu_seconds == pytest.approx(1.5)
    assert tree[12] == Process(12, 11, "ray::LayerActor.serve", 3.0, 712)
    assert process_tree(98, tmp_path) == {}


def test_a_process_that_ends_while_it_is_read_is_left_out(tmp_path: Path) -> None:
    session(tmp_path)
    (tmp_path / "14" / "stat").unlink()
    assert 14 not in process_tree(10, tmp_path)
    assert private_bytes(98, tmp_path) == 0


def test_this_process_is_in_its_own_tree_and_has_memory_and_time() -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        tree = process_tree(os.getpid())
    finally:
        child.communicate(b"\n")
    assert {os.getpid(), child.pid} <= set(tree)
    assert tree[os.getpid()].cpu_seconds > 0
    assert private_bytes(os.getpid()) > 2**20


def test_each_process_has_the_kind_of_its_actor_and_ray_has_the_rest(tmp_path: Path) -> None:
    kinds = kinds_of(session(tmp_path), 10, {12: "background layer", 99: "object layer"})
    assert kinds == {10: "driver", 11: "Ray's own", 12: "background layer", 13: "layer", 14: "reader"}


def test_cpu_time_grows_between_two_moments_and_a_new_process_counts_whole(tmp_path: Path) -> None:
    before = session(tmp_path)
    fake_process(tmp_path, 15, 11, "ray::IDLE", 0.25, 0.0)
    after = session(tmp_path, layer=1.5, raylet=0.5)
    growth = cpu_growth(before, after)
    assert growth == pytest.approx({10: 0.0, 11: 0.5, 12: 1.5, 13: 0.0, 14: 0.0, 15: 0.25})
    sums = sum_by_kind(growth, kinds_of(after, 10, {}))
    assert sums == pytest.approx({"Ray's own": 0.75, "driver": 0.0, "layer": 1.5, "reader": 0.0})


def window(tmp_path: Path, frames: int = 20) -> SteadyWindow:
    before, after = session(tmp_path), session(tmp_path, layer=1.0, raylet=0.2)
    layers = {12: "background layer", 13: "object layer"}
    memory = {pid: private_bytes(pid, tmp_path) for pid in after}
    return SteadyWindow(100.0, 104.0, frames, before, after, kinds_of(after, 10, layers), memory)


def test_a_steady_window_gives_rate_and_cpu_time_of_a_frame_over_all_processes(tmp_path: Path) -> None:
    seen = window(tmp_path)
    assert seen.frames_a_second == 5.0
    milliseconds = cpu_ms_by_kind(seen)
    assert milliseconds["background layer"] == pytest.approx(50.0)
    assert milliseconds["Ray's own"] == pytest.approx(10.0)
    streams = StreamsCost.of(seen)
    assert (streams.frames_a_second, streams.cpu_ms) == pytest.approx((5.0, 60.0))


def test_rays_share_is_the_empty_methods_over_the_engine() -> None:
    start = StartUp(1.0, 3.0, math.nan)
    engine = PipelineCost(10.0, 100.0, {"reader": 15.0, "coordinator": 65.0}, start)
    empty = PipelineCost(50.0, 20.0, {"reader": 5.0, "pool": 7.0}, start)
    rows = [line.split() for line in cost_table("x", engine, empty).splitlines()]
    assert ["reader", "15", "5"] in rows
    assert ["pool", "0", "7"] in rows
    assert ["all", "processes", "80", "12", "15", "%"] in rows
    assert ["frames/s", "10", "50"] in rows


def arrivals(times: list[float], objects: dict[int, set[int]] | None = None) -> list[Arrival]:
    """Label maps at these times, s; from each frame named on, these objects."""
    seen: frozenset[int] = frozenset()
    made = []
    for frame, seconds in enumerate(times):
        seen = frozenset((objects or {}).get(frame, seen))
        made.append(Arrival(seconds, seconds, frame, seen))
    return made


def test_the_start_ends_with_the_first_label_map_and_the_rate_is_steady_after_the_last_slow_one() -> None:
    slow, quick = [10.0, 12.0, 14.0], [14.1 + 0.1 * k for k in range(12)]
    start = start_up(8.0, 9.0, arrivals([*slow, *quick]), wall_ms=100.0)
    assert start.ray == 1.0
    assert start.first == 2.0
    assert start.steady == pytest.approx(6.0)
    assert math.isnan(start_up(8.0, 9.0, arrivals(slow), wall_ms=100.0).steady)


def test_memory_is_counted_by_kind_and_a_streams_own_is_summed(tmp_path: Path) -> None:
    kinds = memory_by_kind(window(tmp_path))
    assert kinds["background layer"] == KindMemory(1, 1.0, 1.0)
    assert stream_mib(kinds) == 3.0  # reader, background, one object; not the driver, not Ray
    assert "5" in memory_table("x", kinds).splitlines()[-1]


def test_streams_are_held_against_cores_over_cpu_time() -> None:
    assert most_frames_a_second(2, 100.0) == 20.0
    costs = {1: StreamsCost(5.0, 100.0), 4: StreamsCost(15.0, 120.0)}
    lines = streams_table("x", costs, {1: 6.0, 4: 18.0}, 20.0).splitlines()
    assert lines[1].split() == ["1", "5", "6", "100", "25", "%"]
    assert lines[2].split() == ["4", "15", "18", "120", "75", "%"]


def test_a_core_serves_as_many_cameras_as_it_has_time_for() -> None:
    quick, slow = Capacity(80.0, 20.0, 3.0), Capacity(7.0, 250.0, 16.0)
    assert cameras_a_core(quick, 25) == pytest.approx(0.9 * 1000 / (25 * 20))
    assert cameras_a_core(slow, 5) == pytest.approx(0.9 * 1000 / (5 * 250))
    assert cameras_a_core(slow, 10) == 0  # one stream alone does seven frames a second
    rows = capacity_table({"640×480": {3: quick}, "3840×2160": {16: slow}}).splitlines()
    assert rows[2].startswith("| 640×480 | 3 | 3 | 80 | 20 | 9 | 4.5 | 1.8 |")
    assert rows[3].endswith("| 16 | 16 | 7 | 250 | 0.72 | – | – |")


def call(wall: float, *objects: set[int]) -> EngineCall:
    return EngineCall(wall, wall / 2, tuple(map(frozenset, objects)), {"cut": wall / 4})


def test_the_steady_cost_leaves_the_warm_frames_out() -> None:
    calls = [call(900.0), call(900.0, {1}, {1}), call(10.0, {1}), call(20.0, {1, 2}), call(60.0, {1, 2, 3})]
    assert steady_cost(calls, 2) == EngineCost(20.0, 15.0, 2.0, {"cut": 7.5})


def test_a_birth_is_the_first_frame_of_an_object_that_was_never_there() -> None:
    calls = [call(5.0, {1}), call(5.0, {1}), call(30.0, {1, 2}), call(9.0, {2}), call(7.0, {1, 2})]
    times = times_in_process(calls, warm=1)
    assert [time.birth for time in times] == [False, True, False, False]
    assert birth_cost(times) == BirthCost(1, 8.0, 30.0, 9.0)


def test_through_ray_a_frame_takes_the_time_since_the_one_before() -> None:
    times = times_through_ray(arrivals([1.0, 1.5, 2.0, 4.0, 4.5], {0: {1}, 3: {1, 2}}), warm=2)
    assert [(time.frame, time.wall_ms, time.birth) for time in times] == [
        (2, 500.0, False), (3, 2000.0, True), (4, 500.0, False),
    ]  # fmt: skip
    assert math.isnan(birth_cost(times[-1:]).longest_birth_ms)


def cost(cpu: float) -> EngineCost:
    return EngineCost(cpu, cpu, 1.0, {})


def test_a_further_object_costs_the_growth_over_the_objects_more() -> None:
    costs = {1: cost(80.0), 3: cost(100.0), 8: cost(140.0)}
    further = further_object_ms({count: one.cpu_ms for count, one in costs.items()})
    assert math.isnan(further[1])
    assert (further[3], further[8]) == (10.0, 8.0)
    rows = [line.split() for line in layers_table(costs).splitlines()]
    assert rows[1][4:] == ["0.80", "-", "-", "-"]
    assert rows[3][4:] == ["1.40", "8", "8", "8"]
    assert layers_table({2: cost(50.0)}).splitlines()[1].split()[4:] == ["-", "-", "-", "-"]


def test_the_mean_of_further_objects_counts_from_an_ordinary_frame_on() -> None:
    mean = mean_further_object_ms({1: 80.0, 3: 100.0, 8: 140.0, 16: 139.0})
    assert math.isnan(mean[1])
    assert math.isnan(mean[3])
    assert (mean[8], mean[16]) == (8.0, 3.0)


def test_through_ray_the_cost_of_a_further_object_is_that_of_all_processes() -> None:
    few = SteadyCost(50.0, 20.0, {"object layer": 3.0, "coordinator": 17.0})
    more = SteadyCost(40.0, 25.0, {"object layer": 6.0, "coordinator": 20.0})
    rows = [line.split() for line in processes_table({3: few, 5: more}).splitlines()]
    assert rows[1] == ["3", "20", "20", "3", "1.00", "-", "-", "-"]
    assert rows[2] == ["5", "25", "26", "6", "1.30", "3", "15", "15"]


def test_the_mean_of_some_windows_counts_each_kind_of_process_in_all_of_them() -> None:
    first = SteadyCost(100.0, 10.0, {"coordinator": 8.0, "spare layer": 2.0})
    mean = SteadyCost.mean([first, SteadyCost(50.0, 20.0, {"coordinator": 10.0})])
    assert (mean.frames_a_second, mean.wall_ms) == pytest.approx((1e3 / 15, 15.0))
    assert mean.cpu_ms == {"coordinator": 9.0, "spare layer": 1.0}


@pytest.mark.long
def test_the_empty_parts_send_the_engines_own_messages_for_every_frame() -> None:
    made = scene("demo", frames=7, width=160, height=120)
    messages = last_messages(map(made.frame, range(7)), Config())
    assert messages.evidence.frame_index == messages.segmentation.frame_index == 6
    assert [one.layer for one in messages.posteriors] == [own.layer for own in messages.evidence.layers]
    parts = EmptyParts(messages)
    coordinator, segmenter = parts.coordinator(Config()), parts.segmenter(Config())
    assert [coordinator.feedback_index(index) for index in range(4)] == [None, None, 0, 1]
    frame = made.frame(0)
    for index in range(3):
        (evidence,) = coordinator.step(index, frame, None)
        assert {own.last_frame for own in evidence.layers} == {index - 1}
        layers = [parts.layer(Config(), own.layer, own.kind) for own in evidence.layers]
        posteriors = [layer.step(evidence, None) for layer in layers]
        segmentation = segmenter.step(evidence, frame, posteriors)
        assert {one.frame_index for one in posteriors} == {segmentation.frame_index} == {index}
        assert segmentation.labels is messages.segmentation.labels


def test_a_video_is_played_for_ever_with_frames_that_count_on(tmp_path: Path) -> None:
    made = scene("demo", frames=3, width=64, height=49)
    write_video(map(made.frame, range(3)), tmp_path / "three.mp4")
    reader = EndlessReader(tmp_path / "three.mp4")
    frames = [reader.read() for _ in range(7)]
    reader.close()
    assert [frame.index for frame in frames if frame] == list(range(7))
    pictures = [frame.image for frame in frames if frame and frame.image is not None]
    assert pictures[0].shape == (48, 64, 3)  # an odd side loses a row
    assert np.array_equal(pictures[1], pictures[4])
    assert np.abs(pictures[2].astype(float) - made.frame(2)[:48]).mean() < 8


def settings(tmp_path: Path) -> Settings:
    return Settings(sequences={}, config=Config(), frames=7, warm=6, folder=tmp_path)


@pytest.mark.long
def test_sizes_and_layers_have_a_row_for_each_and_the_engines_stages(tmp_path: Path) -> None:
    sizes = measure_sizes(settings(tmp_path), ((96, 64), (128, 96)))
    assert [line.split()[0] for line in sizes.tables[0].splitlines()] == ["size", "96×64", "128×96"]
    assert sizes.figures["96×64"]["stage_ms"]["flow"] > 0
    layers = measure_layers(settings(tmp_path), (1,), ())
    assert layers.figures["in_process"]["1"]["cpu_ms"] > 0
    assert layers.plots["layers"].x == [1]


@pytest.mark.long
def test_the_engine_is_timed_call_by_call() -> None:
    made = scene("demo", frames=6, width=96, height=64)
    calls = play(map(made.frame, range(6)), Config())
    assert [len(one.objects) for one in calls] == [0, 0, 0, 0, 5, 1]
    assert all(one.wall_ms > 0 for one in calls)


@pytest.mark.long
@pytest.mark.parametrize("form", ["lines", "bars"])
def test_a_plot_is_a_png_whatever_is_unknown(tmp_path: Path, form: Literal["lines", "bars"]) -> None:
    plot = Plot("title", "x", "ms", [1, 2], {"a": [1.0, math.nan], "b": [3.0, 2.0]}, form)
    draw(plot, tmp_path / "new" / "a.png")
    assert (tmp_path / "new" / "a.png").read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_a_sentence_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orchestrator.extra.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="scripts/setup bench"):
        require_matplotlib()


SMALL = "synthetic:demo?frames=8&width=96&height=64"

#: The command with fewer and smaller runs, in a program of its own: Ray's settings come before its import.
PROGRAM = """\
import sys
from functools import partial
from orchestrator.ray_session import ray_settings
with ray_settings(None) as scratch:
    from benchmark import command
    command.measure_layers = partial(command.measure_layers, objects=(1,), through_ray=(1, 4))
    command.measure_streams = partial(command.measure_streams, streams=(1,))
    command.measure_capacity = partial(command.measure_capacity, sizes=((96, 64),), objects=(1, 3))
    command.measure_births = partial(command.measure_births, scenes=("late-entry",), size=(96, 64))
    sys.exit(command.main(sys.argv[1:], scratch))
"""


def measured(name: str, folder: Path) -> Any:
    """Run one measurement; return its figures."""
    flags = ["--measure", name, "--sequences", SMALL, "--frames", "14", "--warm", "6"]
    flags += ["--json", str(folder / "figures.json"), "--plots", str(folder)]
    command = [sys.executable, "-c", PROGRAM, *flags]
    paths = [str(ROOT), str(ROOT / "scripts"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}  # as scripts/bench sets it
    ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert ended.returncode == 0, ended.stderr
    assert name in ended.stderr
    assert ended.stdout
    assert list(folder.glob(f"{name}*.png"))
    return json.loads((folder / "figures.json").read_text())[name]


@pytest.mark.ray
@pytest.mark.long
def test_the_pipeline_is_measured_beside_empty_methods(tmp_path: Path) -> None:
    figures = measured("ray", tmp_path)[SMALL]
    assert figures["engine"]["all_cpu_ms"] > figures["empty"]["all_cpu_ms"] > 0
    assert 0 < figures["engine"]["start_up"]["ray"] < figures["engine"]["start_up"]["first"]


@pytest.mark.ray
@pytest.mark.long
def test_a_crowd_is_measured_in_one_process_and_through_ray(tmp_path: Path) -> None:
    figures = measured("layers", tmp_path)
    assert figures["in_process"]["1"]["all_cpu_ms"] > 0
    one, four = (figures["through_ray"][objects] for objects in ("1", "4"))
    assert 0 < one["cpu_ms"]["object layer"] < four["cpu_ms"]["object layer"]
    assert one["all_cpu_ms"] < four["all_cpu_ms"]
    turns = one["turns_cpu_ms"]
    assert len(turns) == len(four["turns_cpu_ms"]) == 6
    assert one["all_cpu_ms"] == pytest.approx(sum(turns) / len(turns))


@pytest.mark.ray
@pytest.mark.long
def test_the_memory_of_each_kind_of_process_is_measured(tmp_path: Path) -> None:
    kinds = {"reader", "coordinator", "segmenter", "background layer", "sink", "pool", "driver", "Ray's own"}
    assert kinds <= set(measured("memory", tmp_path)[SMALL])


@pytest.mark.ray
@pytest.mark.long
def test_streams_at_once_are_measured(tmp_path: Path) -> None:
    figures = measured("streams", tmp_path)[SMALL]
    assert figures["most_frames_a_second"] > 0
    assert figures["streams"]["1"]["frames_a_second"] > 0


@pytest.mark.ray
@pytest.mark.long
def test_the_rate_of_a_stream_is_measured_by_size_and_objects(tmp_path: Path) -> None:
    figures = measured("capacity", tmp_path)["96×64"]
    for objects in ("1", "3"):
        assert figures[objects]["frames_a_second"] > 0
        assert figures[objects]["cpu_ms"] > 0
        assert set(figures[objects]["cameras_a_core"]) == {"5", "10", "25"}


@pytest.mark.ray
@pytest.mark.long
def test_births_are_measured_in_both_ways_to_run(tmp_path: Path) -> None:
    figures = measured("births", tmp_path)["late-entry"]
    assert [time["frame"] for time in figures["in process"]["frames"]] == [*range(6, 14)]
    assert [time["frame"] for time in figures["through Ray"]["frames"]] == [*range(6, 14)]
