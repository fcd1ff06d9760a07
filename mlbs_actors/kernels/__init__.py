"""Compiled loops: how they are made and kept, and what several of them share.

``jit`` is the decorator, ``machine_code`` the place on disk. ``interpolation``, ``image_rows``, ``fast_log``
and ``simd`` (vector registers) are for other kernels to call.
"""
