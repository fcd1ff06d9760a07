"""Dense optical flow between two frames, both ways (§3).

Read in this order: ``dense_flow`` (what the others call, and the forward-backward check), ``inverse_search``
(the pyramid), ``patch_search`` (one level of it), ``variational_refinement``, ``focus`` (where the finest
level is worth its time).
"""
