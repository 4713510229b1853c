"""How a structure grew: its size and what it bore, join by join."""

import numpy as np
import pandas as pd

from tiswarm.world.history import History


def by_join(history: History) -> pd.DataFrame:
    """One row a join; mechanics are empty where the structure was not solved after it."""
    position, walks, strain = history.position, history.walks, history.strain
    joined = np.arange(1, len(walks) + 1)
    center_of_mass = np.cumsum(position[:, 0]) / joined
    return pd.DataFrame(
        {
            "robots": joined,
            "height_R": np.maximum.accumulate(position[:, 2]) - history.ground_z,
            "depth_R": history.ground_z - np.minimum.accumulate(position[:, 2]),
            "reach_R": np.maximum.accumulate(position[:, 0]),
            "peak_stress": [s.peak for s in strain],
            "sensed_max": [s.sensed_max for s in strain],
            "calling": [s.calling for s in strain],
            "recruited": np.cumsum([walk.recruited for walk in walks]),
            "flips": [walk.stance_count - 1 for walk in walks],
            "contacts": [len(walk.at_rest(walk.contacts)) for walk in walks],
            "ground_docks": [
                len(walk.at_rest(walk.ground_docks)) + len(walk.at_rest(walk.edge_docks))
                for walk in walks
            ],
            "least_support": [s.least_support for s in strain],
            "overhang_R": center_of_mass - history.terrain.left_edge
            if not history.terrain.is_plane
            else np.nan,
        }
    )


def totals(history: History) -> dict[str, float | int]:
    """What a structure came to, for the summary."""
    last = history.strain[-1]
    position = history.position
    return {
        "height_R": float(position[:, 2].max() - history.ground_z),
        "reach_R": float(position[:, 0].max()),
        "depth_R": float(history.ground_z - position[:, 2].min()),
        "peak_stress": last.peak,
        "sensed_max": last.sensed_max,
        "recruited": sum(walk.recruited for walk in history.walks),
        "spawns": history.spawns,
        "crossed": int(history.crossed),
    }
