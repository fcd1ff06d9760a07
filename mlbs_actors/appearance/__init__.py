"""What a layer remembers of its colours, and how likely new ones are (§6).

Read in this order: ``cells`` (the blocks of pixels that all of it works on), ``colour_model`` (the samples),
``warp`` (how they follow the layer's motion), ``colour_density`` (the kernel density estimate), ``fusion``
(the layers' densities against each other).
"""
