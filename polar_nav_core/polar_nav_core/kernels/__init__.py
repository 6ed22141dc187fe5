"""Compiled functions (numba): scalars and float64 arrays, in place, allocation-free, no BLAS.

All kernels of navigation live in the rooms of this folder and are decorated with `cache.kernel`,
which keys the cache directory by the sources of all of them. Products of small matrices are
written out, so that a result depends on nothing but its inputs and the CPU model. Callers pass
writable C-contiguous float64 arrays and float scalars only: anything else would compile a second
version. `polar_nav_core.earth`, `.grid` and `.strapdown` are the comfortable way in.
"""

from .cache import cache_directory, cache_key, kernel

cache_directory()

__all__ = ['cache_directory', 'cache_key', 'kernel']
