"""What decides the last bits of numbers is named, and its digests follow the values."""

import re

import numpy as np
from threadpoolctl import threadpool_limits

from tiswarm.compute import numerics
from tiswarm.compute.lang import LIBRARY, ti


def test_libraries_that_round_numbers_are_named_with_digests_of_their_values():
    """Two machines with the same text give the same bytes, however much else differs."""
    found = numerics.current()

    assert found.kernels.startswith(f"{LIBRARY} ")
    assert "blas" in found.blas
    for text in (found.numpy, found.blas, found.libm):
        assert re.fullmatch(r".+ \([0-9a-f]{6}\)", text)


def test_the_digest_of_blas_is_that_of_any_number_of_threads():
    """It names the code that was chosen, not how busy the machine is."""
    numerics.current.cache_clear()
    with threadpool_limits(1):
        alone = numerics.current()

    numerics.current.cache_clear()

    assert numerics.current() == alone


def test_linear_algebra_of_other_packages_is_not_named(monkeypatch):
    """A plug-in that imports another library changes no number here, and no byte of a case."""
    own = {"user_api": "blas", "internal_api": "openblas", "version": "1", "architecture": "Zen"}
    own |= {"filepath": "/lib/numpy.libs/libscipy_openblas.so"}
    other = {**own, "internal_api": "mkl", "filepath": "/lib/torch/lib/libmkl.so"}
    found = [[own], [own, other], [other]]
    monkeypatch.setattr(numerics, "threadpool_info", lambda: found.pop(0))

    names = [numerics.current.__wrapped__().blas.partition(" (")[0] for _ in range(3)]

    assert names == ["numpy openblas 1 Zen", "numpy openblas 1 Zen", "mkl 1 Zen"]


def test_numpy_without_code_for_any_processor_is_named(monkeypatch):
    """Distributions build such a numpy, and no run fails for it."""
    monkeypatch.setattr(numerics.np, "show_config", lambda mode: {"Build Dependencies": {}})

    assert ", baseline (" in numerics.current.__wrapped__().numpy


def test_llvm_alone_optimizes_kernels_without_checks_of_bounds(monkeypatch):
    """The library takes seconds for a long kernel; afterwards it optimizes kernels again."""
    config = ti.lang.impl.current_cfg()
    optimized_by_library = {}

    for checks_bounds in (False, True):
        monkeypatch.setattr(config, "debug", checks_bounds)
        with numerics.optimized_by_llvm():
            optimized_by_library[checks_bounds] = config.advanced_optimization

    assert optimized_by_library == {False: False, True: True}
    assert config.advanced_optimization


def test_arrays_of_vectors_begin_where_a_vector_may():
    """Processors refuse to load the longest vectors from other addresses."""
    arrays = [numerics.aligned_zeros(n, 8) for n in range(1, 20)]
    arrays.append(numerics.aligned_zeros(3, 5, dtype=np.int32))

    assert [array.ctypes.data % 64 for array in arrays] == [0] * len(arrays)
    assert not any(array.any() for array in arrays)
    assert arrays[-1].dtype == np.int32
