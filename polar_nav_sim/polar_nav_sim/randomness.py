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
    return np.random.SeedSequence([run_seed, *_words(name)])


def stream(run_seed: int, name: str) -> np.random.Generator:
    """Generator of one stream, at its beginning (PCG64)."""
    return np.random.Generator(np.random.PCG64(seed_sequence(run_seed, name)))


def substream(rng: np.random.Generator, name: str) -> np.random.Generator:
    """Generator of one option of a sensor, made from the seed of its stream and a name.

    Nothing is drawn from ``rng``, and the order in which options are asked for does not matter: an
    option that is switched on changes no other number.
    """
    seed = rng.bit_generator.seed_seq
    if not isinstance(seed, np.random.SeedSequence):
        raise TypeError(f'stream of {name}: a generator without a seed sequence has no substreams')
    own = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *_words(name)))
    return np.random.Generator(np.random.PCG64(own))


def _words(name: str) -> list[int]:
    digest = hashlib.sha256(name.encode()).digest()
    return [int.from_bytes(digest[i : i + 4], 'little') for i in range(0, 16, 4)]
