"""Whether OpenCV serves as a reference for sampling between pixels."""

from __future__ import annotations

import cv2
import pytest

__all__ = ["exact_opencv"]

#: Before version 5, remap rounds positions to 1/32 px; version 4.10 and 4.11 were tried.
exact_opencv = pytest.mark.skipif(
    int(cv2.__version__.split(".")[0]) < 5, reason="this OpenCV samples at rounded positions"
)
