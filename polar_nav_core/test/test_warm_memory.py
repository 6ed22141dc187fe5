"""A node gives back the compiler's memory, and yet a kernel can be compiled afterwards."""

import subprocess
import sys

import numba
import pytest

pytestmark = pytest.mark.slow

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


RESIDENT = """
import re
from pathlib import Path
from polar_nav_core.warm import drop_intermediate_code, warm_filter

def resident_kb():
    parts = re.split(r'^(?=[0-9a-f]+-)', Path('/proc/self/smaps').read_text(), flags=re.MULTILINE)
    of_it = [p for p in parts if 'libllvmlite' in p.partition('\\n')[0]]
    return sum(int(re.search(r'^Rss: +(\\d+)', p, re.MULTILINE)[1]) for p in of_it)

warm_filter(('tagged',), whole=False)
before = resident_kb()
drop_intermediate_code()
print(before > 20_000, resident_kb() < 0.5 * before)
"""


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='of Linux only')
def test_the_compiler_leaves_the_memory():
    done = subprocess.run(
        [sys.executable, '-c', RESIDENT], capture_output=True, text=True, check=True
    )
    assert done.stdout == 'True True\n'
