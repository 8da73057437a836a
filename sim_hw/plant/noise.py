"""Seeded randomness: one tree of generators, one independent branch per source of noise.

A branch depends on the seed and its own name alone, so a device that draws more numbers, or a new
device, changes nothing for the others.
"""

from zlib import crc32

import numpy as np

_BLOCK = 512  # numbers drawn at once: a scalar draw from NumPy costs 20 times as much


class NoiseSource:
    """Scalar numbers from one generator."""

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._normals: list[float] = []
        self._uniforms: list[float] = []

    def normal(self) -> float:
        """One standard normal number."""
        if not self._normals:
            self._normals = self._generator.standard_normal(_BLOCK).tolist()
        return self._normals.pop()

    def normals(self, count: int) -> list[float]:
        """The next standard normal numbers, as so many calls of `normal` give them."""
        known = self._normals
        drawn = known[: -count - 1 : -1]
        if len(drawn) < count:
            return [self.normal() for _ in range(count)]
        del known[-count:]
        return drawn

    def uniform(self) -> float:
        """One number in [0, 1)."""
        if not self._uniforms:
            self._uniforms = self._generator.random(_BLOCK).tolist()
        return self._uniforms.pop()

    def chance(self, probability: float) -> bool:
        """Whether an event of this probability happens; none is drawn for the certain ones."""
        if probability <= 0.0:
            return False
        return probability >= 1.0 or self.uniform() < probability

    def random_bytes(self, count: int) -> bytes:
        """``count`` random bytes."""
        return self._generator.bytes(count)


def make_noise_source(seed: int, branch: str) -> NoiseSource:
    """The branch of the seed's tree with this name."""
    sequence = np.random.SeedSequence(seed, spawn_key=(crc32(branch.encode()),))
    return NoiseSource(np.random.Generator(np.random.PCG64(sequence)))
