"""Random vectors, rotations and the like for property tests."""

import numpy as np
from hypothesis import strategies as st

coordinate = st.floats(-5.0, 5.0, allow_nan=False, width=32)
vectors = st.tuples(coordinate, coordinate, coordinate).map(np.array)
unit_vectors = vectors.filter(lambda v: np.linalg.norm(v) > 1e-2).map(
    lambda v: v / np.linalg.norm(v)
)
rotations = st.tuples(coordinate, coordinate, coordinate, coordinate).map(np.array)
rotations = rotations.filter(lambda q: np.linalg.norm(q) > 1e-2).map(
    lambda q: q / np.linalg.norm(q)
)
