"""The rigid scenes of a clip, one for each of its parts, solved when it is first asked for."""

from __future__ import annotations

from mlbs_actors.messages import Array
from orchestrator.make.background_motion import BackgroundMotion, Sketch
from orchestrator.make.point_tracks import PointTracks
from orchestrator.make.scene_geometry import RigidScene, solved

__all__ = ["ScenesOfClip"]

#: Frames that share a scene, and frames before and after them from which it is known.
PART, AROUND = 24, 48
#: With fewer steps that no homography describes there is no depth to be found.
LEAST_BENDS = 4


class ScenesOfClip:
    """Follows points through a clip, frame by frame, and finds scenes by them."""

    def __init__(self, motion: BackgroundMotion) -> None:
        self._motion = motion
        self._tracks = PointTracks()
        self._part: tuple[int, int] | None = None
        self._scene: RigidScene | None = None

    def add(self, sketch: Sketch) -> None:
        """Add the next frame, after the motion knows of it."""
        poses = self._motion.poses
        same = len(poses) > 1 and poses[-2].shot == poses[-1].shot
        self._tracks.add(sketch.gray, sketch.free, poses[-2].into(poses[-1]) if same else None)

    def scene(self, index: int) -> RigidScene | None:
        """Return the scene around a frame; None if it has no place in one, or a homography is enough."""
        part = (index // PART, self._motion.poses[index].shot)
        if part != self._part:
            self._part, self._scene = part, self._found(*part)
        known = self._scene is not None and index in self._scene.numbers
        return self._scene if known else None

    def _found(self, part: int, shot: int) -> RigidScene | None:
        poses = self._motion.poses
        around = range(max(0, part * PART - AROUND), min(len(poses), (part + 1) * PART + AROUND))
        frames = [index for index in around if poses[index].shot == shot]
        if self._motion.bends(frames[0], frames[-1]) < LEAST_BENDS:
            return None
        return solved(self._tracks.between(frames), self._motion.size, self._homography)

    def _homography(self, index: int, other: int) -> Array:
        return self._motion.poses[index].into(self._motion.poses[other])
