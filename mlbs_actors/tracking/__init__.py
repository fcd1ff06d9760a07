"""Trajectories: points followed from frame to frame, and the camera's motion (§3).

Read in this order: ``tracker`` (one frame), ``trajectories`` (their state), ``seeding`` and ``density``
(where new ones begin and old ones are too many), ``camera`` and ``epipolar`` (how the background moves).
"""
