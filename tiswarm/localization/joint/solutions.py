"""Which solutions chains found, where these are too unlike to be one."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.joint.force_kernels import SPACING

MOST_LISTED = 8
"""Robots, and solutions, that are told one by one."""


def listed(
    mean: NDArray[np.float64],
    residual: NDArray[np.float64],
    robot_id: NDArray[np.int64],
    dock_radius: float,
    length_unit: str,
) -> tuple[str, ...]:
    """List the solutions that chains ended in, the one of least residual first, a line each.

    Args:
        mean: Mean position of each chain that counts [R], shape (chains, N, 3).
        residual: Residual of each [R], shape (chains,).
        robot_id: Name of each robot, shape (N,).
        dock_radius: R in the unit that lines are told in.
        length_unit: Name of that unit.

    Returns:
        No line where there is one solution only.
    """
    chains = apart(mean, residual)
    if len(chains) == 1:
        return ()
    best = chains[0]
    lines = []
    for number, chain in enumerate(chains[:MOST_LISTED], start=1):
        least = residual[chain[0]] * dock_radius
        line = (
            f"solution {number} of {len(chains)}: {len(chain)} of {len(mean)} chains, "
            f"residual {least:.3g} {length_unit}"
        )
        if number > 1:
            more = least - residual[best[0]] * dock_radius
            off = np.linalg.norm(mean[chain[0]] - mean[best[0]], axis=1)
            line += (
                f", {more:.2g} {length_unit} more than solution 1; up to "
                f"{off.max() * dock_radius:.3g} {length_unit} from there: {_robots(off, robot_id)}"
            )
        lines.append(line)
    if len(chains) > MOST_LISTED:
        lines.append(f"and {len(chains) - MOST_LISTED} more")
    lines.append(f"the estimate is the mean of all {len(mean)} chains, which is none of these")
    return tuple(lines)


def apart(mean: NDArray[np.float64], residual: NDArray[np.float64]) -> list[list[int]]:
    """Chains of each solution, of less residual before those of more.

    Chains of a solution agree with the best of them on every robot, within the width of a dock:
    beyond that robots could have changed places.
    """
    found: list[list[int]] = []
    for chain in np.argsort(residual, kind="stable").tolist():
        for solution in found:
            if np.linalg.norm(mean[chain] - mean[solution[0]], axis=1).max() <= SPACING:
                solution.append(chain)
                break
        else:
            found.append([chain])
    return found


def _robots(off: NDArray[np.float64], robot_id: NDArray[np.int64]) -> str:
    """Name the robots that are farther off than the width of a dock, the farthest first."""
    far = np.argsort(-off, kind="stable")[: np.count_nonzero(off > SPACING)]
    names = [str(robot_id[i]) for i in far]
    more = len(names) - MOST_LISTED
    text = ", ".join(names[:MOST_LISTED]) + (f" and {more} more" if more > 0 else "")
    return f"robot{'s' if len(names) > 1 else ''} {text}"
