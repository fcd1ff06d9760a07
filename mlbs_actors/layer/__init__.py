"""One layer: the processing block of a frame (§3, §5, §6).

Read in this order: ``layer`` (the terms of its posterior, and the step), ``layer_state``,
``background_frame`` and ``object_frame`` (the step of either kind, with ``object_parameters``),
``object_regions`` (where it is evaluated), ``posterior_terms`` (their sum), ``photometric`` and
``trajectory_distance`` (two of them), ``learning`` (what it may learn), ``points_in_box``.
"""
