"""Streams that a program starts: their results, whatever happens to their processes."""

from __future__ import annotations

import asyncio
import atexit
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from actor_fakes import wait_until
from cold_parts import ColdParts
from thread_host import ThreadHost, threads

import orchestrator
from mlbs_actors import MultilayerSubtractor, Result
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import get
from mlbs_actors.actors.pipeline import Node
from mlbs_actors.errors import ConfigError, MlbsError
from mlbs_actors.scenes.synthetic import scene_from_uri
from orchestrator import StreamResult
from orchestrator.library import run as library_run
from orchestrator.library import starting
from orchestrator.run.need import Need

SCENE = "synthetic:demo?frames=72&width=160&height=120&seed=1"
LONG = "synthetic:demo?frames=240&width=64&height=48&seed=2"


@pytest.fixture(scope="module")
def expected() -> list[Result]:
    """What the class says of the scene."""
    scene = scene_from_uri(SCENE)
    return [
        result
        for _, result in MultilayerSubtractor().segment(scene.frame(index) for index in range(len(scene)))
    ]


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[ThreadHost]:
    """Actors in threads instead of Ray."""

    @contextmanager
    def present(address: str | None) -> Iterator[bool]:
        yield False

    def node(folder: Path, streams: int, need: Need, say: object, *, shared: bool) -> Node:
        return Node(parts=ColdParts(), policy=PoolPolicy(streams=2))

    monkeypatch.setattr(starting, "present_ray", present)
    monkeypatch.setattr(library_run, "host_of", node)
    with threads() as host:
        yield host


def assert_like(results: list[StreamResult], expected: list[Result]) -> None:
    assert [one.frame for one in results] == list(range(len(expected)))
    for one, other in zip(results, expected, strict=True):
        assert np.array_equal(one.labels, other.labels)
        assert one.labels.dtype == other.labels.dtype
        assert one.layers == other.layers
        assert one.frame_index == other.frame_index


def test_results_are_those_of_the_class_frame_by_frame(host: ThreadHost, expected: list[Result]) -> None:
    with orchestrator.start({"a": SCENE, "b": SCENE}) as run:
        results = list(run)
        assert {name: state.state for name, state in run.status().items()} == {"a": "done", "b": "done"}
    for name in ("a", "b"):
        assert_like([one for one in results if one.stream == name], expected)
    assert results[0].time == 0
    assert results[0].name == "00000"


@pytest.mark.parametrize(
    "kind", ["LayerActor", "CoordinatorActor", "SegmenterActor", "ReaderActor", "SinkActor"]
)
def test_a_killed_process_loses_and_repeats_no_result(
    kind: str, host: ThreadHost, expected: list[Result]
) -> None:
    with orchestrator.start({"a": SCENE}) as run:
        results = [next(run)]
        assert host.kill_oldest(kind)
        results += run
        assert run.status()["a"].state == "done"
        # A layer may have been released just then, and a reader may have been at its end.
        assert run.status()["a"].returns >= (0 if kind in ("LayerActor", "ReaderActor") else 1)
    assert_like(results, expected)


def test_a_slow_program_holds_its_streams_up_and_gets_everything_in_the_end(host: ThreadHost) -> None:
    with orchestrator.start({"long": LONG}) as run:
        frames = [next(run).frame]
        wait_until(lambda: run.status()["long"].committed > 64)
        time.sleep(1.0)
        assert run.status()["long"].committed < 160
        frames += [one.frame for one in run]
    assert frames == list(range(240))


def test_streams_come_and_go_while_the_run_is_iterated(host: ThreadHost) -> None:
    with orchestrator.start({"first": LONG}) as run:
        frames: dict[str, list[int]] = {"first": [next(run).frame]}
        with pytest.raises(ConfigError, match="has a stream 'first' already"):
            run.add("first", SCENE)
        run.add("second", "synthetic:demo?frames=10&width=64&height=48")
        run.remove("first")
        for one in run:
            frames.setdefault(one.stream, []).append(one.frame)
        status = run.status()
        assert status["first"].interrupted
        assert frames["first"] == list(range(status["first"].committed))
        assert status["first"].committed < 240
        assert frames["second"] == list(range(10))
        with pytest.raises(ConfigError, match="no stream 'third'"):
            run.remove("third")


def test_a_stream_that_fails_ends_alone_and_its_state_says_why(host: ThreadHost, tmp_path: Path) -> None:
    (tmp_path / "bad.mp4").write_bytes(b"no video")
    good = "synthetic:demo?frames=10&width=64&height=48"
    with orchestrator.start({"bad": tmp_path / "bad.mp4", "good": good}) as run:
        assert [one.stream for one in run] == ["good"] * 10
        assert run.status()["bad"].state == "failed"
        assert "bad.mp4" in str(run.status()["bad"].error)


def test_what_was_read_when_a_run_is_stopped_can_still_be_taken(host: ThreadHost) -> None:
    with orchestrator.start({"long": LONG}) as run:
        first = next(run)
        run.stop()
        frames = [first.frame, *(one.frame for one in run)]
        assert frames == list(range(run.status()["long"].committed))
        with pytest.raises(ConfigError, match="has been stopped"):
            run.add("other", SCENE)


def test_an_iteration_that_is_cancelled_loses_nothing(host: ThreadHost) -> None:
    async def frames() -> list[int]:
        async with orchestrator.start({"long": LONG}) as run:
            taken: list[int] = []

            async def take() -> None:
                async for one in run:
                    taken.append(one.frame)

            for _ in range(5):
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(take(), 0.05)
            await take()
            return taken

    assert asyncio.run(frames()) == list(range(240))


def test_references_stand_for_the_results_in_their_order(host: ThreadHost, expected: list[Result]) -> None:
    with orchestrator.start({"a": SCENE}, references=True) as run:
        assert_like([get(one) for one in run], expected)


def test_a_folder_of_ones_own_gets_what_is_to_be_saved_and_no_second_run(
    host: ThreadHost, tmp_path: Path
) -> None:
    source = "synthetic:demo?frames=10&width=64&height=48"
    with orchestrator.start({"a": source}, output=tmp_path / "out", save=["masks"], max_frames=6) as run:
        assert len(list(run)) == 6
    assert len(list((tmp_path / "out/a/masks").iterdir())) == 6
    with pytest.raises(ConfigError, match="holds a run already"):
        orchestrator.start({"a": source}, output=tmp_path / "out")


def test_wrong_words_are_refused_before_anything_is_started() -> None:
    with pytest.raises(ConfigError, match="save holds 'mask'"):
        orchestrator.start({"a": SCENE}, save=["mask"])
    with pytest.raises(ConfigError, match=r"'a/b' cannot be the name"):
        orchestrator.start({"a/b": SCENE})
    with pytest.raises(ConfigError, match="object store"):
        orchestrator.start({"a": SCENE}, output="s3://bucket/prefix")
    with pytest.raises(ConfigError, match="max_frames is 0"):
        orchestrator.start({"a": SCENE}, max_frames=0)
    with pytest.raises(ConfigError, match="max_side is 10"):
        orchestrator.start({"a": SCENE}, max_side=10)


@pytest.mark.parametrize(
    ("streams", "settings", "sentence"),
    [
        ({"a": SCENE}, {"max_frames": "3"}, "max_frames is '3'; it must be a whole number, at least 1"),
        ({"a": SCENE}, {"max_side": 320.0}, "max_side is 320.0; it must be a whole number, at least 64"),
        ({"a": SCENE}, {"config": "x.yaml"}, "config is 'x.yaml'; .* load it with mlbs_actors.load_config"),
        ({"a": SCENE}, {"save": ["masks"]}, "nothing would be left: give output, a folder, too"),
        ({"a": SCENE}, {"save": "masks"}, r"save is one word, 'masks'; give a list: \['masks'\]"),
        ({"a": SCENE}, {"output": 3}, "output is 3; give the path of a folder"),
        (3, {}, "streams is 3; give a list of sources, or a dict by their names"),
        ([3], {}, "A source is 3; give a path or an address as text"),
        ({"a": None}, {}, "A source is None; give a path"),
        ({3: SCENE}, {}, "A stream is named 3; give its name as text"),
        ({"a": "stret.mp4"}, {}, r"There is no file or folder .*stret\.mp4; did you mean 'street\.mp4'\?$"),
        (["street.mp5"], {}, r"There is no file or folder .*street\.mp5"),
    ],
)
def test_what_cannot_be_started_is_told_before_ray_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, streams: Any, settings: dict[str, Any], sentence: str
) -> None:
    (tmp_path / "street.mp4").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(starting, "present_ray", None)
    with pytest.raises(ConfigError, match=sentence):
        orchestrator.start(streams, **settings)


def test_an_output_that_holds_a_run_is_told_before_ray_is_and_without_options_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(starting, "present_ray", None)
    (tmp_path / "run.json").touch()
    with pytest.raises(ConfigError, match=r"holds a run already; choose another one with output=\.$"):
        orchestrator.start({"a": SCENE}, output=tmp_path)
    (tmp_path / "run.json").unlink()
    (tmp_path / "a").touch()
    with pytest.raises(ConfigError, match=r"holds 'a' already, .*; choose another folder with output=\.$"):
        orchestrator.start({"a": SCENE}, output=tmp_path)


def test_a_run_that_could_not_begin_leaves_its_folder_to_the_next_try(
    host: ThreadHost, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_node(*_: object, **__: object) -> Node:
        raise ConfigError("No node can be used.")

    with monkeypatch.context() as broken:
        broken.setattr(library_run, "host_of", no_node)
        with pytest.raises(ConfigError, match="No node can be used"):
            orchestrator.start({"a": SCENE}, output=tmp_path / "out")
    with orchestrator.start({"a": SCENE}, output=tmp_path / "out", max_frames=2) as run:
        assert len(list(run)) == 2


def test_a_run_that_is_left_open_is_closed_at_the_end_of_the_program_and_not_again(
    host: ThreadHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_exit: list[Callable[[], None]] = []
    monkeypatch.setattr(atexit, "register", at_exit.append)
    monkeypatch.setattr(atexit, "unregister", at_exit.remove)
    open_run = orchestrator.start({"a": LONG})
    assert at_exit.count(open_run.close) == 1
    next(open_run)
    at_exit[at_exit.index(open_run.close)]()
    assert open_run.status()["a"].interrupted
    assert open_run.close not in at_exit


def test_a_run_whose_session_has_ended_fails_and_calls_nothing_any_more(
    host: ThreadHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = orchestrator.start({"a": LONG})
    next(run)
    monkeypatch.setattr(host, "there", False)
    monkeypatch.setattr(host, "spawn", None)
    monkeypatch.setattr(host, "kill", None)
    with pytest.raises(MlbsError, match=r"close the run before ray\.shutdown\(\)"):
        list(run)
    run.close()


@pytest.mark.long
@pytest.mark.ray
@pytest.mark.parametrize("ending", ["", "ray.shutdown()", "run.close(); ray.shutdown()"])
def test_a_program_that_leaves_a_run_open_ends_and_joins_no_other_session(
    tmp_path: Path, ending: str
) -> None:
    program = (
        "import ray, orchestrator, time\n"
        "begun, init = [], ray.init\n"
        "ray.init = lambda *a, **k: (begun.append(1), print('init', flush=True), init(*a, **k))\n"
        "ray.init(address='local', num_cpus=2, logging_level='ERROR', log_to_driver=False)\n"
        f"run = orchestrator.start({{'a': {LONG!r}}})\n"
        "next(run); print('one', flush=True)\n"
        f"{ending}\n"
        "if not ray.is_initialized(): time.sleep(5)\n"
        "print('end', flush=True)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == ["init", "one", "end"], ended.stderr


@pytest.mark.long
@pytest.mark.ray
def test_a_session_of_its_own_ends_with_the_run(tmp_path: Path) -> None:
    program = (
        "import orchestrator, sys\n"
        f"with orchestrator.start({{'a': {SCENE!r}}}, max_frames=9) as run:\n"
        "    print(sum(1 for _ in run))\n"
        "import ray; print(ray.is_initialized())\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == ["9", "False"]
