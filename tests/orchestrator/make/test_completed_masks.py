"""Masks that leave something out are completed by the background, and only then."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from record_fakes import HEIGHT, WIDTH, segmentation

from mlbs_actors.messages import Array
from mlbs_actors.record.frame_row import run_length_code
from mlbs_actors.record.recorded_stream import RecordedFrame
from orchestrator.make.completed_masks import KnownObjects, completed_masks
from orchestrator.make.masks_around import AROUND, masks_around


def passing(number: int = 24) -> Iterator[tuple[Array, Array]]:
    """Yield the frames of a moving camera, and where somebody walks through them, (H, W) bool."""
    grey = np.random.default_rng(3).integers(60, 150, (40, 80, 3), np.uint8)
    ground = np.asarray(cv2.resize(grey, (320, 160), interpolation=cv2.INTER_CUBIC))
    for index in range(number):
        there = np.zeros((120, 160), np.bool_)
        there[30:80, 5 * index : 5 * index + 20] = True
        frame = ground[10:130, 60 - 2 * index : 220 - 2 * index].copy()
        frame[there] = (60, 60, 230)
        yield frame, there


def around(mask: Array) -> Array:
    """Widen a mask by two pixels."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)


def test_the_legs_that_masks_leave_out_are_found() -> None:
    whole = [there for _, there in passing()]
    upper = np.zeros((120, 160), np.bool_)
    upper[:72] = True
    completed = list(
        completed_masks(
            lambda: (KnownObjects(frame, there & upper, there & upper) for frame, there in passing())
        )
    )
    legs = sum(int((there & ~upper).sum()) for there in whole)
    found = sum(int((one & there & ~upper).sum()) for one, there in zip(completed, whole, strict=True))
    assert found > 0.9 * legs
    assert sum(int((one & ~around(there)).sum()) for one, there in zip(completed, whole, strict=True)) == 0


def test_a_mask_that_leaves_nothing_out_does_not_grow() -> None:
    completed = completed_masks(lambda: (KnownObjects(frame, mask, mask) for frame, mask in passing(12)))
    for (_, mask), one in zip(passing(12), completed, strict=True):
        assert (one >= mask).all()
        assert not (one & ~around(mask)).any()


def test_an_object_is_found_before_its_first_mask_where_it_is_soon() -> None:
    whole = [there for _, there in passing()]
    completed = completed_masks(
        lambda: (
            KnownObjects(frame, there & (index > 5), there | whole[min(index + 3, 23)])
            for index, (frame, there) in enumerate(passing())
        )
    )
    for there, one in zip(whole, completed, strict=True):
        assert (one & there).sum() > 0.9 * there.sum()
        assert (one & ~around(there)).sum() < 0.2 * there.sum()


def recorded(index: int, *layers: int) -> RecordedFrame:
    """A frame of a camera that moves by two pixels to the right."""
    found = segmentation(index, *(layers or [3]))
    objects = found.layers if layers else ()
    return RecordedFrame(
        index=index,
        pts=index / 10,
        name=f"{index:05d}",
        height=HEIGHT,
        width=WIDTH,
        camera_motion=(2.0, 0.0),
        objects=objects,
        codes=tuple(run_length_code(found.labels, one.layer, one.region) for one in objects),
        camera=(1, 0, 2, 0, 1, 0, 0, 0, 1),
    )


# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("number", [1, 5, AROUND, 3 * AROUND])
def test_the_masks_around_a_frame_are_carried_into_it_by_the_camera(number: int) -> None:
    frames = [recorded(index, *([3] if index % 3 else [])) for index in range(number)]
    expected = []
    for here in range(number):
        joined = np.zeros((HEIGHT, WIDTH + 200), np.bool_)
        for there in range(max(0, here - AROUND), min(number, here + AROUND + 1)):
            if there % 3:
                left = 100 + 2 * (there - here)
                joined[:, left : left + WIDTH] |= segmentation(there, 3).labels > 0
        expected.append(joined[:, 100 : 100 + WIDTH])
    result = list(masks_around(frames, WIDTH))
    assert [index for index, _ in result] == list(range(number))
    for (_, mask), other in zip(result, expected, strict=True):
        assert np.array_equal(mask, other)
