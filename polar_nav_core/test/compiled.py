"""Mark of tests that need compiled kernels, or take many seconds without them."""

import numba
import pytest

jit_only = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='needs compiled kernels')
