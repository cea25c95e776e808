"""A Dask cluster that runs the jobs of a sweep.

The scheduler gives a job to another worker if the one that has it dies. A result is fetched as soon as it is
there and kept by the sweep's store on this machine; from then on nothing that happens to the cluster can harm
it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from typing import Any

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import install_instruction

_PATIENCE = 30
"""Seconds to wait for the scheduler, and then for a first worker."""


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """The cluster whose scheduler is at ``address``: what runs jobs, and how many threads it has now.

    Workers may come and go. Raises UsageError if the cluster cannot be reached, has no worker or is lost, or
    if a job keeps killing its workers.
    """
    try:
        import distributed as dask  # noqa: PLC0415
        from distributed.comm.core import CommClosedError  # noqa: PLC0415
    except ImportError as error:
        message = f"Dask cannot be loaded ({error}); to install it, {install_instruction('cluster')}"
        raise UsageError(message) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is raised
    client = _client(dask, address)
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
        yield client.get_executor(pure=False), lambda: max(1, sum(client.nthreads().values()))
    except TimeoutError as error:
        message = f"the cluster at {address} has no workers; start some: dask worker {address}"
        raise UsageError(message) from error
    except (dask.KilledWorker, CancelledError, CommClosedError) as error:
        reason = " ".join(str(error).split())
        message = f"the cluster at {address} failed; what was finished is kept: run the same again ({reason})"
        raise UsageError(message) from error
    finally:
        client.close()


def _client(dask: Any, address: str) -> Any:
    """A client that is connected; made when the scheduler has exchanged first messages with us.

    A client exchanges them too, but without a limit in time: it would wait forever for a server that is
    silent. And one that fails is left to the garbage collector, which closes it in any thread; in the one
    that the next client has just started, the two wait for each other.
    """
    from distributed.comm import connect  # noqa: PLC0415

    async def greet() -> None:
        security = dask.Security().get_connection_args("client")
        connection = await connect(address, timeout=_PATIENCE, **security)
        await connection.close()

    try:
        dask.utils.LoopRunner().run_sync(greet, callback_timeout=_PATIENCE + 1)
        return dask.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, MemoryError) as error:
        # A timeout may say nothing; where memory runs out, another server's words were taken for a length.
        reason = "another server answers" if isinstance(error, MemoryError) else str(error) or "timed out"
        raise UsageError(f"no Dask scheduler at {address}: {reason}; start one: dask scheduler") from error
