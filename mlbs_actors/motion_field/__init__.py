"""A layer's motion at every pixel, inferred from its trajectories (§5, Gaussian belief propagation).

Read in this order: ``field`` (the model and what the others call), ``node_grid`` (where it is solved),
``banded_factors`` (small grids, exactly), ``screened_poisson`` (large ones, by multigrid),
``selected_inversion`` (the marginal variances).
"""
