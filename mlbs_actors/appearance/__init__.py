"""A layer's remembered colours, and how likely new ones are (§6).

Read in this order: ``colour_model`` (the samples), ``warp`` (how they follow the layer's motion),
``colour_density`` (the kernel density estimate), ``fusion`` (the layers' densities compared with each other).
All of it works on the frame's cells (:mod:`mlbs_actors.cells`).
"""
