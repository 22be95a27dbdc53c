"""Line sets of the paper's geometry and of every degenerate kind."""

from collections.abc import Callable

import numpy as np
import pytest
from benchmarks._hard_lines import HARD, RCM_MM, Lines, adversarial, cone


@pytest.fixture
def gold() -> Callable[..., Lines]:
    """The paper's gold standard: lines in a 57° cone that miss the RCM by noise."""

    def make(count: int = 70, *, seed: int = 0, apex_deg: float = 57.0, noise: float = 0.1):
        random = np.random.default_rng(seed)
        axes = cone(random, count, apex_deg)
        along = random.uniform(50, 100, (count, 1)) * axes
        return RCM_MM + noise * random.standard_normal((count, 3)) + along, axes

    return make


@pytest.fixture(params=HARD)
def hard_sets(request) -> list[Lines]:
    return [adversarial(request.param, seed) for seed in range(25)]
