"""Dense optical flow between two frames, both ways (§3).

Read in this order: ``estimate`` (the entry point, where the method is chosen), ``consistency`` (where both
directions agree); then our own search: ``bidirectional_search``, ``inverse_search`` (the pyramid),
``patch_search`` (one level of it), ``variational_refinement``, ``focus`` (where the finest level is worth its
time).
"""
