"""A layer's motion at every pixel, inferred from its trajectories (§5, Gaussian belief propagation).

Read in this order: ``field`` (the model and what the others call), ``node_grid`` (where it is solved),
``screened_poisson`` (how: exactly, with the marginal variances).
"""
