"""A program as users write it, with everything that is public; its types are checked as theirs are."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

import orchestrator
from mlbs_actors import (
    Appearance,
    Boxes,
    Config,
    ConfigError,
    FrameError,
    FrameInspection,
    LayerError,
    LayerInspection,
    LayerSummary,
    MissingPackageError,
    MlbsError,
    MultilayerSubtractor,
    Region,
    Result,
    Segmentation,
    SinkError,
    SolverError,
    SourceError,
    StoredMotion,
    compile_kernels,
    load_config,
    pictures,
    record,
    scenes,
)
from orchestrator import Event, Minimum, Rule, Run, StreamResult, Zone, Zones
from orchestrator.evaluation import open_sequence

Picture = npt.NDArray[np.uint8]

#: What the program catches one by one, and how it says so.
WORDS: dict[type[MlbsError], str] = {
    ConfigError: "settings",
    FrameError: "a frame",
    LayerError: "a layer",
    MissingPackageError: "an installation",
    SinkError: "a disk",
    SolverError: "a motion",
    SourceError: "a source",
}


def prepare() -> None:
    """Compile, and say how far it is."""

    def say(seconds: float, kernels: int) -> None:
        print(f"{seconds:.0f} s, {kernels}")

    compile_kernels(say)


def areas_of_video(path: Path) -> dict[int, list[int]]:
    """Areas of each object in a video, px."""
    areas: dict[int, list[int]] = {}
    try:
        for frame, result in MultilayerSubtractor().segment(path):
            assert frame.shape[:2] == result.labels.shape
            for layer in result.layers:
                areas.setdefault(layer.layer, []).append(layer.area)
    except MlbsError as error:
        print(WORDS[type(error)], error)
    return areas


def results_of(frames: Iterable[Picture], config: Config | None = None) -> list[Result]:
    """Results of frames, with their numbers as tags; half of them from a copy."""
    subtractor = MultilayerSubtractor(config or load_config(None, ["layers.lookahead=2"]), flow=None)
    results: list[Result] = []
    for number, frame in enumerate(frames):
        results += subtractor.apply(frame, tag=number)
        if number == 3:
            subtractor = pickle.loads(pickle.dumps(subtractor))
    return results + subtractor.flush()


def largest_box(result: Result) -> tuple[int, tuple[int, ...]] | None:
    """Id and box of the largest object."""
    boxes: Boxes = result.boxes()
    if not len(boxes.ids):
        return None
    mask: npt.NDArray[np.bool_] = np.stack([result.mask(int(one)) for one in boxes.ids])
    largest = int(mask.sum(axis=(1, 2)).argmax())
    return int(boxes.ids[largest]), tuple(map(int, boxes.xyxy[largest]))


def births(results: Iterable[Result]) -> dict[int, int]:
    """Tag of the frame in which each id is born."""
    return {layer: result.tag for result in results for layer in (*result.born, *result.ended)}


def largest_id(labels: npt.NDArray[np.uint16]) -> int:
    """The largest id in a label map, for which a result's own types will do."""
    return int(labels.max(initial=0))


def made(frames: int) -> Iterator[Picture]:
    """Frames of a built-in scene."""
    video: scenes.SyntheticScene = scenes.scene("pan", frames=frames, width=160, height=120)
    assert len(scenes.scene_from_uri("synthetic:pan?frames=3")) == 3
    for index in range(len(video)):
        yield video.frame(index)


def motions(frames: Iterable[Picture]) -> dict[int, list[float]]:
    """How fast the points of each layer move, px/frame, by an inspector and with a flow of one's own."""
    found: dict[int, list[float]] = {}

    def inspect(frame: FrameInspection) -> None:
        for layer in frame.layers:
            one: LayerInspection = layer
            if len(one.motions):
                found.setdefault(one.layer, []).append(float(np.abs(one.motions).mean()))

    def flow(first: Picture, second: Picture) -> npt.NDArray[np.float32]:
        return np.zeros((*first.shape[:2], 2), np.float32)

    for _ in MultilayerSubtractor(inspector=inspect, flow=flow, colour="rgb").segment(frames):
        pass
    return found


def drawn(frame: Picture, segmentation: Segmentation) -> Picture:
    """A picture with all that is known of its objects."""
    picture = pictures.draw_labels(frame, segmentation.labels, ids=False)
    for one in segmentation.layers:
        layer: LayerSummary = one
        region: Region = layer.region
        pictures.draw_box(picture, region.box, layer.layer)
    corners = np.array([[0, 0], [10, 0], [10, 10]], np.float64)
    pictures.draw_outlines(picture, [pictures.Outline("yard", corners)])
    pictures.draw_caption(picture, f"frame {segmentation.frame_index}")
    blue, green, red = pictures.layer_colour(1)
    assert pictures.label_colours(segmentation.labels).shape == (*segmentation.labels.shape, 3)
    return picture if blue + green + red else frame


def happenings(results: Iterable[Result]) -> list[Event]:
    """What happens in a zone and by a rule."""
    yard = Zone(name="yard", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
    rule = Rule.model_validate({"name": "stays", "dwell": {"zone": "yard", "seconds": 0.1}})
    zones: Zones = orchestrator.Zones([yard], minimum=Minimum(area=10), rules=[rule], frame_rate=25)
    said = [event for result in results for event in zones.update(result)]
    return said + zones.end()


def recorded(run: Path) -> dict[str, list[int]]:
    """Largest ids in the frames of each stream of a run."""
    assert record.description_of(run)
    return {
        name: [largest_id(frame.labels()) for frame in frames_of(run / name)]
        for name in record.streams_of(run)
    }


def frames_of(folder: Path) -> Iterator[record.RecordedFrame]:
    """The frames of a stream."""
    yield from record.recorded_stream(folder)


class Plain:
    """An appearance that knows nothing."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def update(self, colours: Picture, won: npt.NDArray[np.bool_], region: Region) -> None:
        """Learn nothing."""

    def log_density(
        self, colours: Picture, region: Region, motion: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Know nothing."""
        return np.full(colours.shape[:2], np.nan, np.float32)


def by_own_appearance(frames: Iterable[Picture]) -> list[Result]:
    """Results with an appearance model of one's own."""
    model: type[Appearance] = Plain
    return [result for _, result in MultilayerSubtractor(appearance=model).segment(frames)]


def streamed(sources: dict[str, str]) -> dict[str, int]:
    """The number of results of each stream."""
    counted: dict[str, int] = {}
    run: Run[StreamResult] = orchestrator.start(sources)
    with run:
        one: StreamResult
        for one in run:
            counted[one.stream] = counted.get(one.stream, 0) + 1
    return counted


def by_stored_flow(name: str, root: Path, flow: Path) -> list[Result]:
    """Results of a data set's sequence, by flow that is stored."""
    sequence = open_sequence(name, root)
    stored = StoredMotion(name, flow=flow)
    subtractor, results = MultilayerSubtractor(flow=stored.flow), list[Result]()
    for index, stem in enumerate(sequence.stems):
        frame = sequence.frame(index)
        stored.follow(index, stem, frame)
        results += subtractor.apply(frame)
    return results + subtractor.flush()
