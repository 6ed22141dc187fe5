"""Compiled functions (numba): scalars and float64 arrays, in place, allocation-free, no BLAS.

All kernels of navigation live in the rooms of this folder and are decorated with `cache.kernel`,
which keys the cache directory of a file by all sources that it stands on. Products of small
matrices are written out, so that a result depends on nothing but its inputs and the CPU model.
Callers pass writable C-contiguous float64 arrays and float scalars only: anything else would
compile a second version. `polar_nav_core.earth`, `.grid` and `.strapdown` are the comfortable way
in.

Rooms: `frames` (ellipsoid, grid frame, strapdown), `vehicle` (dynamic models), `sins` (the filter
of mode sins), `station` (the filter of mode station); `queues` serves both filters. Units are SI
and rad, stamps int64 [ns]; the last letter of a name is its frame (docs/frames.md). A kernel
without a result fills the arrays that its first line names.
"""

from .cache import cache_directory, cache_key, kernel

__all__ = ['cache_directory', 'cache_key', 'kernel']
