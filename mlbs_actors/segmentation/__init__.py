"""One label map from all posteriors (§7).

Read in this order: ``segmenter`` (one frame), ``proposals`` (where a layer can win pixels),
``group_labelling`` (one group from posteriors to labels), ``unaries`` and ``contrast`` (the terms of the
energy), ``cleaning`` over ``label_runs`` (specks and holes), ``shadows`` and ``contact_shadow``,
``mask_score``, ``attached_parts`` (which layers are one object).
"""
