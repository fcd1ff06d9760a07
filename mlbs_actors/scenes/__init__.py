"""Synthetic videos with exact labels and motion, for trying things out without a video.

Read :mod:`.synthetic`, which renders them, then :mod:`.scene_scripts` (what is in each scene), :mod:`.stage`
(how it is put together), :mod:`.street` and :mod:`.textures` (what it looks like).
"""

from mlbs_actors.scenes.synthetic import SyntheticScene, scene, scene_from_uri

__all__ = ["SyntheticScene", "scene", "scene_from_uri"]
