"""The fast logarithm against the library's."""

import numpy as np

from mlbs_actors.kernels.fast_log import row_log


def test_it_is_the_logarithm_over_all_magnitudes() -> None:
    rng = np.random.default_rng(0)
    values = np.exp(rng.uniform(-80, 80, 5000)).astype(np.float32)
    values[:5] = [1.0, 2.0, np.nextafter(np.float32(2), np.float32(0)), 0.5, 1e-30]
    logs = np.empty_like(values)
    row_log(values, logs)
    np.testing.assert_allclose(logs, np.log(values.astype(np.float64)), atol=3e-5)
    assert abs(logs[0]) < 3e-5
