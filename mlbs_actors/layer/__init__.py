"""One layer: the processing block of a frame (§3, §5, §6).

Read in this order: ``layer`` (the terms of its posterior, and the step), ``layer_state``, ``object_regions``
(where an object is evaluated), ``posterior_terms`` (the sum of the terms), ``photometric`` (one of them),
``learning`` (where it may learn).
"""
