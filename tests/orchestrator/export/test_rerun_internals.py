"""Trajectories, motion fields and posteriors in a recording for rerun, read back by rerun's own reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from record_fakes import write_stream

from mlbs_actors import Config, MultilayerSubtractor
from mlbs_actors.inspection import FrameInspection, LayerInspection
from mlbs_actors.messages import Region
from mlbs_actors.motion_field.field import MotionParameters, motion_field
from mlbs_actors.pictures.layer_colours import layer_colour
from mlbs_actors.record.recorded_stream import RecordedFrame
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame
from orchestrator.export.__main__ import main
from orchestrator.export.replay import InspectedFrame
from orchestrator.options import recorded
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.working_size import FullSizeRecord, shrunk

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

FRAMES, WIDTH, HEIGHT = 9, 240, 180
SAVED = frozenset({"masks", "parquet"})
SCENE = f"synthetic:pan?frames=60&width={WIDTH}&height={HEIGHT}"
Rows = dict[str, list[dict[str, Any]]]


def write_run(folder: Path, sources: dict[str, str], max_side: int | None = None) -> list[FrameInspection]:
    """A run of the first frames of a scene, the stream ``pan``, beside others that hold something else."""
    video = scene("pan", frames=60, width=WIDTH, height=HEIGHT)
    record = (FullSizeRecord if max_side else StreamRecord)(folder / "pan", "pan", SAVED)
    seen: list[FrameInspection] = []
    subtractor = MultilayerSubtractor(Config(), seen.append)
    pictures = [video.frame(t) for t in range(FRAMES)]
    worked = [picture if max_side is None else shrunk(picture, max_side) for picture in pictures]
    results = [one for picture in worked for one in subtractor.apply(picture)] + subtractor.flush()
    for t, result in enumerate(results):
        original = None if max_side is None else pictures[t]
        record.write(result, SourceFrame(t, worked[t], t / 25, f"{t:05d}", original=original))
    record.close(whole=True)
    for name in sources.keys() - {"pan"}:
        write_stream(folder / name, SAVED)
    streams = [
        ListedStream(name, parse_address(source, folder), line)
        for line, (name, source) in enumerate(sources.items(), start=1)
    ]
    RunFolder(folder).create(describe_run(streams, Config(), recorded({"save": SAVED, "max_side": max_side})))
    return seen


def read_recording(out: Path) -> Rows:
    """Entity → its rows, as rerun's reader finds them."""
    chunk = pytest.importorskip("rerun.chunk", reason="rerun is not installed, see CONTRIBUTING.md")
    rows: Rows = {}
    for one in chunk.RrdReader(out).stream():
        rows.setdefault(one.entity_path, []).extend(one.to_record_batch().to_pylist())
    return rows


def by_frame(rows: list[dict[str, Any]], column: str) -> dict[int, Any]:
    return {row["frame"]: row[column] for row in rows if row.get(column)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rows, list[FrameInspection], str]:
    """The recording of a run, what was inside when it was made, and what the export told."""
    pytest.importorskip("rerun", reason="rerun is not installed, see CONTRIBUTING.md")
    folder = tmp_path_factory.mktemp("run")
    seen = write_run(folder / "out", {"pan": SCENE})
    with pytest.MonkeyPatch.context() as patch:
        told: list[str] = []
        patch.setattr("builtins.print", lambda text, **_: told.append(str(text)))
        assert main(["rerun", "--internals", str(folder / "out"), str(folder / "run.rrd")]) == 0
    return read_recording(folder / "run.rrd"), seen, "\n".join(told[:-1])


def test_nothing_is_told_if_the_label_maps_are_the_recorded_ones(
    whole: tuple[Rows, list[FrameInspection], str],
) -> None:
    assert whole[2] == ""


def test_every_layer_has_its_trajectories_at_every_frame_of_both_timelines(
    whole: tuple[Rows, list[FrameInspection], str],
) -> None:
    rows, seen, _ = whole
    layers = {layer.layer for one in seen for layer in one.layers}
    assert len(layers) > 1, "a scene without an object proves little"
    assert {entity for entity in rows if entity.startswith("/pan/trajectories/")} == {
        f"/pan/trajectories/{layer}{end}" for layer in layers for end in ("", "/steps")
    }
    for layer in layers:
        frames = {one.frame_index: one for one in seen if layer in {inner.layer for inner in one.layers}}
        points = by_frame(rows[f"/pan/trajectories/{layer}"], "Points2D:positions")
        steps = by_frame(rows[f"/pan/trajectories/{layer}/steps"], "LineStrips2D:strips")
        for index, one in frames.items():
            (inner,) = (inner for inner in one.layers if inner.layer == layer)
            assert len(points.get(index, [])) == len(steps.get(index, [])) == len(inner.positions)
            if len(inner.positions):
                np.testing.assert_allclose(points[index], inner.positions)
                before = np.array(steps[index])[:, 0]
                np.testing.assert_allclose(before, inner.positions + inner.motions, atol=1e-4)
    background = rows["/pan/trajectories/0"]
    assert {row["frame"] for row in background} == set(range(FRAMES))
    assert max(row["time"].total_seconds() for row in background) == pytest.approx((FRAMES - 1) / 25)


def test_trajectories_have_the_colour_of_their_layer(
    whole: tuple[Rows, list[FrameInspection], str],
) -> None:
    rows, seen, _ = whole
    layer = max(inner.layer for one in seen for inner in one.layers)
    blue, green, red = layer_colour(layer)
    colours = by_frame(rows[f"/pan/trajectories/{layer}"], "Points2D:colors")
    assert all(found == [red << 24 | green << 16 | blue << 8 | 255] for found in colours.values())


def test_the_arrows_of_a_motion_field_point_where_the_scene_moves(
    whole: tuple[Rows, list[FrameInspection], str],
) -> None:
    rows, _, _ = whole
    video = scene("pan", frames=60, width=WIDTH, height=HEIGHT)
    origins = by_frame(rows["/pan/motion_fields/0"], "Arrows2D:origins")
    vectors = by_frame(rows["/pan/motion_fields/0"], "Arrows2D:vectors")
    assert list(vectors) == list(range(FRAMES))
    assert len(vectors[5]) == len(origins[5]) > 300
    still = video.labels(5) == 0
    expected = np.median(-video.flow(5)[still], axis=0)
    np.testing.assert_allclose(np.median(vectors[5], axis=0), expected, atol=0.3)


def test_a_posterior_is_a_picture_of_the_whole_frame(
    whole: tuple[Rows, list[FrameInspection], str],
) -> None:
    rows, seen, _ = whole
    for inner in seen[7].layers:
        pictures = by_frame(rows[f"/pan/posteriors/{inner.layer}"], "EncodedImage:blob")
        shown = cv2.imdecode(np.array(pictures[7][0], np.uint8), cv2.IMREAD_UNCHANGED)
        assert shown is not None
        assert shown.shape == (HEIGHT, WIDTH)
        inside = shown[inner.region.slices] / 255
        np.testing.assert_allclose(inside, inner.posterior, atol=0.003)
        outside = shown.astype(float)
        outside[inner.region.slices] = np.nan
        assert set(outside[np.isfinite(outside)]) <= {255.0 if inner.layer == 0 else 0.0}


def test_a_layer_without_a_pixel_or_a_trajectory_has_no_arrows(tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun", reason="rerun is not installed, see CONTRIBUTING.md")
    from orchestrator.export.rerun_internals import write_internals

    nowhere, points = Region(0, 0, 0, 0), np.zeros((0, 2), np.float32)
    field = motion_field(points, points, (0, 0), np.zeros(2), MotionParameters())
    hidden = LayerInspection(
        4, "object", points, points, nowhere, field, nowhere, np.zeros((0, 0), np.float32)
    )
    recorded = RecordedFrame(0, 0.0, "00000", HEIGHT, WIDTH, (0.0, 0.0), (), ())
    frame = FrameInspection(0, (HEIGHT, WIDTH), np.eye(3), (hidden,))
    with rerun.RecordingStream("test") as recording:
        recording.save(tmp_path / "run.rrd")
        recording.set_log_time_enabled(False)  # nanoseconds, which Python has no type for
        written = write_internals(recording, "a", [InspectedFrame(recorded, frame, True)])
    assert written.layers == (4,)
    rows = read_recording(tmp_path / "run.rrd")
    assert by_frame(rows["/a/motion_fields/4"], "Arrows2D:vectors") == {}
    assert "/a/posteriors/4" in rows


def test_what_was_worked_on_in_a_smaller_size_is_drawn_in_the_full_one(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed, see CONTRIBUTING.md")
    seen = write_run(tmp_path / "out", {"pan": SCENE}, WIDTH // 2)
    assert main(["rerun", "--internals", str(tmp_path / "out"), str(tmp_path / "run.rrd")]) == 0
    rows = read_recording(tmp_path / "run.rrd")
    points = by_frame(rows["/pan/trajectories/0"], "Points2D:positions")[7]
    np.testing.assert_allclose(points, 2 * seen[7].layers[0].positions + 0.5, atol=1e-4)
    picture = by_frame(rows["/pan/posteriors/0"], "EncodedImage:blob")[7][0]
    shown = cv2.imdecode(np.array(picture, np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert shown.shape == (HEIGHT, WIDTH)


def test_label_maps_that_are_not_the_recorded_ones_and_cameras_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed, see CONTRIBUTING.md")
    others = {"made up": "synthetic:demo?frames=40&width=50&height=36", "gate": "rtsp://bob:hunter2@cam/x"}
    write_run(tmp_path / "out", {"pan": SCENE, **others})
    assert main(["rerun", "--internals", str(tmp_path / "out"), str(tmp_path / "run.rrd")]) == 0
    told = capsys.readouterr().err
    assert "of stream 'made up' came out other than recorded" in " ".join(told.split())
    assert "The source of stream 'gate' gave 0 of its 39 frames again" in told
    assert "stream 'pan'" not in told
    assert "hunter2" not in told


def test_internals_go_with_rerun_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["coco", "--internals", str(tmp_path), str(tmp_path / "out")]) == 2
    assert "--internals goes with the format rerun only" in capsys.readouterr().err
