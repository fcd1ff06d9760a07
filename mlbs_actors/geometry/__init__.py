"""Plane geometry that several parts of the engine share; it knows nothing of layers.

``boxes`` (regions that overlap, in one another and grown), ``distance`` (of cells from the nearest point),
``points_in_box``, ``interpolation`` (maps and flow between cells), ``homography``.
"""
