"""An appearance model of the caller's own: what it is given, and what becomes of its answers."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from mlbs_actors import LayerError, MultilayerSubtractor
from mlbs_actors.messages import Array, LayerKind, Region
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from orchestrator.evaluation.metrics import object_level
from orchestrator.evaluation.overlap import count_overlap

FRAMES = 12


class Histogram:
    """One colour histogram of 8×8×8 bins for the whole layer, slowly forgotten."""

    def __init__(self, kind: LayerKind) -> None:
        self.kind = kind
        self.counts = np.zeros((8, 8, 8))

    def update(self, colours: Array, won: Array, region: Region) -> None:
        np.add.at(self.counts, tuple(colours[won].T // 32), 1.0)

    def log_density(self, colours: Array, region: Region, motion: Array) -> Array:
        if not self.counts.any():
            return np.full(colours.shape[:2], np.nan)
        share = (self.counts + 0.01) / (self.counts + 0.01).sum()
        bins = tuple(np.moveaxis(colours // 32, 2, 0))
        density: Array = np.log(share[bins] / 32**3)
        return density


class Unknowing(Histogram):
    """Never knows anything; notes what it is given."""

    def __init__(self, kind: LayerKind) -> None:
        super().__init__(kind)
        self.learnt: list[tuple[Array, Array, Region]] = []
        self.judged: list[tuple[Array, Region, Array]] = []

    def update(self, colours: Array, won: Array, region: Region) -> None:
        self.learnt.append((colours, won, region))

    def log_density(self, colours: Array, region: Region, motion: Array) -> Array:
        self.judged.append((colours, region, motion))
        return np.full(colours.shape[:2], np.nan)


@pytest.fixture(scope="module")
def made() -> SyntheticScene:
    return scene("demo", frames=FRAMES, width=160, height=120)


def labels_of(subtractor: MultilayerSubtractor, made: SyntheticScene) -> list[Array]:
    return [result.labels for _, result in subtractor.segment(made.frame(index) for index in range(FRAMES))]


def test_objects_are_found_with_a_histogram_in_place_of_samples(made: SyntheticScene) -> None:
    found = labels_of(MultilayerSubtractor(appearance=Histogram), made)
    scores = [object_level(count_overlap(labels, made.labels(index))).f for index, labels in enumerate(found)]
    assert np.mean(scores) > 0.6
    built_in = labels_of(MultilayerSubtractor(), made)
    assert any(not np.array_equal(one, other) for one, other in zip(found, built_in, strict=True))


def test_a_model_that_knows_nothing_is_as_colours_without_weight(made: SyntheticScene) -> None:
    from mlbs_actors import load_config

    without = labels_of(MultilayerSubtractor(load_config(None, ["posterior.appearance=0"])), made)
    found = labels_of(MultilayerSubtractor(appearance=Unknowing), made)
    assert all(np.array_equal(one, other) for one, other in zip(found, without, strict=True))


def test_a_model_learns_what_its_layer_won_then_judges_the_next_frame(made: SyntheticScene) -> None:
    models: list[Unknowing] = []

    def factory(kind: LayerKind) -> Unknowing:
        models.append(Unknowing(kind))
        return models[-1]

    found = labels_of(MultilayerSubtractor(appearance=factory), made)
    background, *objects = models
    assert background.kind == "background"
    assert {one.kind for one in objects} <= {"object", "other"}
    assert len(background.judged) == FRAMES
    assert len(background.learnt) == FRAMES - 1  # the last frame is never followed by another
    for model in models:
        for colours, won, region in model.learnt:
            assert colours.shape == (region.height, region.width, 3)
            assert (won.shape, won.dtype) == (colours.shape[:2], np.dtype(bool))
        for colours, region, motion in model.judged:
            assert motion.shape == (region.height, region.width, 2) == (*colours.shape[:2], 2)
    colours, won, region = background.learnt[3]
    assert (region.x, region.y) == (0, 0)
    side = 160 // region.width
    assert not found[3][::side, ::side][: region.height, : region.width][won].any()


def test_a_subtractor_with_a_model_of_its_own_goes_on_when_pickled(made: SyntheticScene) -> None:
    first = MultilayerSubtractor(appearance=Histogram)
    for index in range(7):
        first.apply(made.frame(index))
    second = pickle.loads(pickle.dumps(first))
    for index in range(7, FRAMES):
        for one, other in zip(first.apply(made.frame(index)), second.apply(made.frame(index)), strict=True):
            assert np.array_equal(one.labels, other.labels)


@pytest.mark.parametrize(
    ("returned", "sentence"),
    [
        (None, "returned NoneType; it must return an array"),
        (np.zeros((2, 3)), r"returned \(2, 3\) float64; it must return the log density"),
        (np.zeros((120, 160), int), r"returned \(120, 160\) int64"),
    ],
)
def test_what_is_no_density_is_refused(made: SyntheticScene, returned: object, sentence: str) -> None:
    class Wrong(Histogram):
        def log_density(self, colours: Array, region: Region, motion: Array) -> Array:
            return returned  # type: ignore[return-value]

    with pytest.raises(LayerError, match=sentence):
        labels_of(MultilayerSubtractor(appearance=Wrong), made)
