"""What the chains of one structure come to. Lengths in R."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals

_BY_CHAIN = ("mean", "within", "last", "mean_yaw", "last_yaw", "temperature")


@dataclass(frozen=True, kw_only=True)
class Annealed:
    """Result of the chains of one structure of N robots."""

    mean: Reals
    """Mean position over the hold of each chain [R], shape (chains, N, 3)."""

    within: Reals
    """Within-chain variance of each position, all axes together [R^2], shape (chains, N)."""

    last: Reals
    """Last position in each chain [R], shape (chains, N, 3)."""

    mean_yaw: Reals
    """Mean yaw correction over the hold of each chain [rad], shape (chains, N)."""

    last_yaw: Reals
    """Last yaw correction in each chain [rad], shape (chains, N)."""

    sigma: float
    """Square root of the end temperature [R]."""

    temperature: Reals
    """Mean kinetic temperature of each chain once docks are grown, relative to its target,
    shape (chains,)."""

    iteration: Ints
    """Steps at which the trace was recorded, shape (K,)."""

    trace: Reals
    """Positions of the first chain then [R], shape (K, N, 3)."""

    yaw_trace: Reals
    """Yaw corrections of the first chain then [rad], shape (K, N)."""

    def joined(self, other: "Annealed") -> "Annealed":
        """Add the chains of others that ended at the same temperature."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in _BY_CHAIN
        }
        return replace(self, **arrays)

    def still(self, position: Reals, yaw: Reals) -> "Annealed":
        """Put chains that do not move in place of these: (K, N, 3) and (K, N)."""
        return replace(
            self, mean=position, last=position, mean_yaw=yaw, last_yaw=yaw,
            within=np.zeros(yaw.shape), temperature=np.ones(len(yaw)),
        )  # fmt: skip

    def with_chains(self, chosen: Bools, other: "Annealed") -> "Annealed":
        """Replace some chains, chosen by an array of shape (chains,), by those of `other`."""
        arrays: dict[str, Any] = {
            name: np.where(
                chosen.reshape(-1, *[1] * (getattr(self, name).ndim - 1)),
                getattr(other, name),
                getattr(self, name),
            )
            for name in _BY_CHAIN
        }
        # Traces are those of the first chain.
        if chosen[0]:
            arrays |= {"trace": other.trace, "yaw_trace": other.yaw_trace}
        return replace(self, **arrays)
