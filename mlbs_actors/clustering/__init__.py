"""Labels of trajectories, and the layers that come of them (§4).

Read in this order: ``affinity`` (over ``nearest_neighbours``), ``label_propagation`` (the last frame's
labels), ``splitting`` (``normalized_cut`` of each cluster, on ``graph_coarsening``), ``rigid_scene`` (what
is static, by ``two_views`` of it and the ``outline`` of a label), ``border_motion`` (how motion changes
across borders and inside clusters), ``repulsion`` (two things or one), ``motion_merging`` (labels that move
alike), ``parts`` (clusters on an object's mask), ``layer_registry`` over ``registry_state`` (births, sleep
and ends of layers), ``reidentification`` (which layer wakes).
``label_index`` and ``label_lookup`` find labels among sorted ones.
"""
