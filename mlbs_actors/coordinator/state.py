"""Everything that determines a coordinator's next frame: the state of the stream and of its epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.clustering.left_scenes import LeftScene
from mlbs_actors.clustering.registry_state import RegistryState
from mlbs_actors.clustering.repulsion import Repulsion
from mlbs_actors.clustering.two_views import FocalLength, Places
from mlbs_actors.config import Config
from mlbs_actors.coordinator.held_frames import HeldFrame
from mlbs_actors.flow.estimate import Picture
from mlbs_actors.footage.fixed import FixedState
from mlbs_actors.messages import Array, FrameStatus
from mlbs_actors.tracking.trajectories import TrajectoryState, empty_trajectories

__all__ = ["CoordinatorState", "EpochState", "NewFrame", "WaitingFrame"]

#: That of a stream that has shown nothing yet.
NO_VIEW = Picture(np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.uint8), np.zeros((0, 0, 3), np.uint8))


@dataclass(frozen=True, slots=True)
class NewFrame:
    """A frame that has come.

    Attributes
    ----------
    frame_index : int
    picture : Picture
    stage_ms : mapping of str to float
        Time that its stages have taken so far.
    """

    frame_index: int
    picture: Picture
    stage_ms: dict[str, float]


@dataclass(frozen=True, slots=True)
class WaitingFrame:
    """A frame in which the last picture does not go on: the next ones say what it is.

    Attributes
    ----------
    new : NewFrame
    status : FrameStatus
        What it is if one of them goes on from the last picture.
    lost : bool
        Whether the last picture is not found again in it.
    """

    new: NewFrame
    status: FrameStatus
    lost: bool

    @property
    def frame_index(self) -> int:
        """Of the frame."""
        return self.new.frame_index


@dataclass(slots=True)
class EpochState:
    """What is known of the present scene, at the present size.

    Attributes
    ----------
    first : int
        Its first picture; before there is one, the frame from which on it may begin.
    cut : bool
        Whether it is another scene than the one before.
    shape : (H, W)
        Of its frames; (0, 0) before the stream's first one.
    pictures : int
        Its pictures so far: frames that were not passed over.
    picture : Picture
        The last picture.
    view : Picture
        The last picture that went on from the one before nearly everywhere.
    astray : (rows,) float32
        :func:`~mlbs_actors.footage.continuity.rows_astray` of the last picture.
    fixed : FixedState
        What is fixed in it.
    waiting : tuple of WaitingFrame
        The newest frames, if the last picture does not go on in them; oldest first.
    lost : int
        Frames since the last picture in which it was not found again.
    focus : (rows, columns) bool
        Blocks around which the next flow needs its finest level; empty for everywhere.
    trajectories : TrajectoryState
    labels : (n,) int64
        Label of each live trajectory after the last frame.
    static : (n,) float32
        Log-odds, gathered over its life, that each is a part of the scene, by its motion, nats; NaN where
        nothing is known.
    focal_length : FocalLength
        Of the camera.
    places : tuple of Places
        Where the trajectories were in the last pictures, newest first.
    spreads : (T,) float64
        Noise scale of the last frames' displacements, newest first, px.
    registry : RegistryState
    repulsion : Repulsion
        Between the labels of the registry and of the trajectories.
    clustered : bool
        Whether the first clustering is done.
    last_clustering : int
        Frame of the newest one; 0 if there was none.
    held : tuple of HeldFrame
        Oldest first.
    """

    first: int
    cut: bool
    shape: tuple[int, int]
    pictures: int
    picture: Picture
    view: Picture
    astray: Array
    fixed: FixedState
    waiting: tuple[WaitingFrame, ...]
    lost: int
    focus: Array
    trajectories: TrajectoryState
    labels: Array
    static: Array
    focal_length: FocalLength
    places: tuple[Places, ...]
    spreads: Array
    registry: RegistryState
    repulsion: Repulsion
    clustered: bool
    last_clustering: int
    held: tuple[HeldFrame, ...]

    @staticmethod
    def beginning(
        config: Config, first: int, shape: tuple[int, int], registry: RegistryState, cut: bool = False
    ) -> EpochState:
        """Return the state before an epoch's first picture."""
        return EpochState(
            first=first,
            cut=cut,
            shape=shape,
            pictures=0,
            picture=NO_VIEW,
            view=NO_VIEW,
            astray=np.zeros(0, np.float32),
            fixed=FixedState.beginning(np.zeros((0, 0), np.uint8)),
            waiting=(),
            lost=0,
            focus=np.zeros((0, 0), bool),
            trajectories=empty_trajectories(config.trajectories),
            labels=np.zeros(0, np.int64),
            static=np.zeros(0, np.float32),
            focal_length=FocalLength(),
            places=(),
            spreads=np.zeros(0),
            registry=registry,
            repulsion=Repulsion.empty(),
            clustered=False,
            last_clustering=0,
            held=(),
        )


@dataclass(slots=True)
class CoordinatorState:
    """Everything that determines the coordinator's next frame.

    Attributes
    ----------
    next_frame : int
        Index of the next frame.
    epoch : EpochState
    evaluated : dict of int to int
        Last emitted frame of each layer that has a process.
    left : tuple of LeftScene
        Scenes with objects that cuts have ended, newest first.
    """

    next_frame: int
    epoch: EpochState
    evaluated: dict[int, int]
    left: tuple[LeftScene, ...]

    @staticmethod
    def beginning(config: Config) -> CoordinatorState:
        """Return the state before the first frame."""
        return CoordinatorState(0, EpochState.beginning(config, 0, (0, 0), RegistryState.empty()), {}, ())
