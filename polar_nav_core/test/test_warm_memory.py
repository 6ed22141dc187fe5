"""A node gives back the compiler's memory, and yet a kernel can be compiled afterwards."""

import subprocess
import sys

import numba
import pytest

CHILD = """
import numpy as np
from numba import njit
from polar_nav_core.kernels.sins import late
from polar_nav_core.warm import drop_intermediate_code, warm_filter

warm_filter(('tagged',), whole=False)
library = next(iter(late.newest_until.overloads.values())).library
assert library._shared_module is not None
assert drop_intermediate_code() > 5
assert library._shared_module is None
assert drop_intermediate_code() == 0

@njit(error_model='numpy')
def find(stamps, count, stamp_ns):
    return late.newest_until(stamps, count, stamp_ns)

print(find(np.arange(10), 10, 5))
"""


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_a_kernel_compiles_after_the_intermediate_code_of_others_was_dropped():
    done = subprocess.run(
        [sys.executable, '-c', CHILD], capture_output=True, text=True, check=True
    )
    assert done.stdout == '5\n'


WITHOUT_BLAS = """
import sys
import numpy as np
from polar_nav_core.warm import forgo_blas, warm_filter

forgo_blas()
warm_filter(('tagged',), whole=False)
assert not [name for name in sys.modules if name.startswith('scipy.linalg')]
import scipy.linalg
print(round(float(scipy.linalg.inv(np.array([[4.0]]))[0, 0]), 2))
"""


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_a_node_loads_no_blas_and_scipy_is_whole():
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_BLAS], capture_output=True, text=True, check=True
    )
    assert done.stdout == '0.25\n'
