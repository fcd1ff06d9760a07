"""A layer's motion at every pixel, inferred from its trajectories (§5, Gaussian belief propagation).

Read in this order: ``field`` (the model and the entry point), ``node_grid`` (the grid it is solved on),
``screened_poisson`` (the exact solver, with the marginal variances).
"""
