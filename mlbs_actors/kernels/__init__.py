"""Compiled kernels: the decorators, where machine code is kept, and functions for other kernels to call.

``jit`` has the decorators, ``machine_code`` the folder on disk. ``image_rows``, ``fast_log`` and ``simd``
(vector registers) are building blocks.
"""
