"""Calls the commands of benchmarks in processes of their own."""

from tests.runs import python


def call(name, *arguments):
    """Call `python -m benchmarks.NAME`, without bounds checks in kernels."""
    return python("-m", f"benchmarks.{name}", *arguments)
