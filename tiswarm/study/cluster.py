"""A Dask cluster that computes the jobs of a run."""

import asyncio
import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from typing import Any

from tiswarm.base.errors import EnvironmentTroubleError

CONNECT_S = 3  # time that a scheduler has to accept a connection, and again to answer


@contextmanager
def connected(address: str) -> Iterator[tuple[Executor, int]]:
    """Connect to the Dask scheduler at an address; yields its executor and its threads in all.

    Raises:
        EnvironmentTroubleError: Dask is not installed, no scheduler answers, or it is lost.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra, and slow to import
    except ImportError as error:
        msg = "--scheduler needs Dask; pip install 'tiswarm[cluster]'"
        raise EnvironmentTroubleError(msg) from error
    try:
        _greet(address)
        client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        msg = f"no Dask scheduler answers at {address}; start one, or correct --scheduler"
        raise EnvironmentTroubleError(msg) from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # a lost scheduler: below
    with client:
        try:
            yield client.get_executor(pure=False), max(1, sum(client.nthreads().values()))
        except CancelledError as error:
            msg = f"the Dask scheduler at {address} was lost; start it, then run again to continue"
            raise EnvironmentTroubleError(msg) from error


def _greet(address: str) -> None:
    """Exchange a message with the scheduler at an address of Dask.

    A `Client` of another address tries for long, and complains when this process ends.

    Raises:
        OSError: nothing answers as a scheduler does.
        ValueError: this is no address.
    """
    from distributed.core import rpc  # noqa: PLC0415 - an extra

    async def ask() -> None:
        untyped: Any = rpc
        async with untyped(address, timeout=CONNECT_S) as scheduler:
            await scheduler.identity()

    try:
        asyncio.run(asyncio.wait_for(ask(), CONNECT_S))
    except Exception as error:
        raise OSError(str(error)) from error
