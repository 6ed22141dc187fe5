"""Random streams: each has its own seed, made from the run seed and the stream's name.

Nothing else in the simulation makes random numbers. Adding a sensor, or starting the nodes in
another order, never changes the draws of another stream, and a bag that holds the run seed and the
names can be made again.
"""

from __future__ import annotations

import hashlib

import numpy as np


def seed_sequence(run_seed: int, name: str) -> np.random.SeedSequence:
    """Seed of one stream.

    Parameters
    ----------
    run_seed : int
        Seed of the whole run, >= 0.
    name : str
        Name of the stream, e.g. ``follower/imu``.

    Returns
    -------
    numpy.random.SeedSequence
        Entropy is the run seed and the SHA-256 of the name (Python's own hash of a text differs
        from process to process).
    """
    if run_seed < 0:
        raise ValueError(f'run seed {run_seed} is negative')
    digest = hashlib.sha256(name.encode()).digest()
    words = [int.from_bytes(digest[i : i + 4], 'little') for i in range(0, 16, 4)]
    return np.random.SeedSequence([run_seed, *words])


def stream(run_seed: int, name: str) -> np.random.Generator:
    """Generator of one stream, at its beginning (PCG64)."""
    return np.random.Generator(np.random.PCG64(seed_sequence(run_seed, name)))
