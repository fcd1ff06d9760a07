"""Minimum of an energy with contrast-sensitive pairs and label costs (§7), by alpha-expansion.

Read in this order: ``energy`` (the energy that is minimised), ``graph_cut`` (the minimisation),
``coarse_cut`` (coarse to fine), ``persistency`` (pixels decided before any cut), ``expansion`` and
``expansion_state``, ``min_cut``, ``label_removal`` (labels that cost more than they save).
"""
