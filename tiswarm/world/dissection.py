"""Order of elimination by nested dissection, with METIS.

A separator is a set of nodes without which a graph falls into two parts of about equal size. Nodes
of the parts are eliminated before those of the separator, and each part is divided in the same way
(Karypis and Kumar, A Fast and High Quality Multilevel Scheme for Partitioning Irregular Graphs,
1998). In large structures this fills in less than minimum degree.
"""

from types import ModuleType

import numpy as np
from scipy.sparse import coo_array

from tiswarm.base.aliases import AnyInts, Ints
from tiswarm.base.errors import EnvironmentTroubleError

_SEED = 0
"""Seed of METIS: an order depends on the graph alone."""


def import_metis() -> ModuleType:
    """Import METIS.

    Raises:
        EnvironmentTroubleError: it is not installed.
    """
    try:
        import pymetis  # noqa: PLC0415 - optional
    except ImportError as error:
        msg = "mechanics.order: nested-dissection needs METIS; pip install 'tiswarm[large]'"
        raise EnvironmentTroubleError(msg) from error
    return pymetis


def dissected(nodes: AnyInts, pairs: AnyInts) -> Ints:
    """Order nodes of a graph for elimination.

    Args:
        nodes: Numbers of the nodes, ascending, shape (n,).
        pairs: Numbers of nodes that are neighbors, each pair once, shape (E, 2).

    Returns:
        The nodes in the order in which to eliminate them, shape (n,).

    Raises:
        EnvironmentTroubleError: METIS is not installed.
    """
    if not len(pairs):
        return np.asarray(nodes, np.int64)
    metis = import_metis()
    whole = metis.zero_copy_dtype()
    a, b = np.searchsorted(nodes, pairs).T
    ones = np.ones(2 * len(pairs), np.int8)
    graph = coo_array((ones, (np.r_[a, b], np.r_[b, a])), shape=(len(nodes), len(nodes))).tocsr()
    order, _ = metis.nested_dissection(
        adjacency=metis.CSRAdjacency(graph.indptr.astype(whole), graph.indices.astype(whole)),
        options=metis.Options(seed=_SEED),
    )
    ordered: Ints = np.asarray(nodes, np.int64)[order]
    return ordered
