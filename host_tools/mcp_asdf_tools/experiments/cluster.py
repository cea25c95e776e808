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

_TIMEOUT = 30
"""Seconds to wait for the scheduler, and then for a first worker."""


@contextmanager
def connect_cluster(address: str) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """Connect to the cluster whose scheduler is at ``address``, until this context ends.

    Yields an executor for jobs, and a function that returns how many threads the cluster has at present,
    since workers may come and go. Raises UsageError if the cluster cannot be reached, has no worker or is
    lost, or if a job keeps killing its workers.
    """
    try:
        import distributed as dask  # noqa: PLC0415
    except ImportError as error:
        message = f"Dask cannot be loaded ({error}); to install it, {install_instruction('cluster')}"
        raise UsageError(message) from error
    # What matters in Dask's log is raised as an exception as well.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    client = _connect_client(dask, address)

    def count_threads() -> int:
        """Return the number of threads; 1 if there is no worker, for the scheduler to keep a job for one."""
        thread_count: int = sum(client.nthreads().values())
        return max(1, thread_count)

    try:
        with _explaining_losses(dask, client, address):
            _wait_for_worker(client, address)
            # Dask runs pure jobs of equal arguments only once.
            yield client.get_executor(pure=False), count_threads
    finally:
        client.close()


def _wait_for_worker(client: Any, address: str) -> None:
    """Wait until the cluster has a worker. Raises UsageError, with the fix, if it gets none in time."""
    try:
        client.wait_for_workers(1, timeout=_TIMEOUT)
    except TimeoutError as error:
        message = f"the cluster at {address} has no workers; start some: dask worker {address}"
        raise UsageError(message) from error


@contextmanager
def _explaining_losses(dask: Any, client: Any, address: str) -> Iterator[None]:
    """Raise UsageError, with the fix, where Dask raises in this context that a job or the cluster is lost.

    What a job itself has raised passes unchanged, unless it is an OSError.
    """
    try:
        yield
    except (dask.KilledWorker, CancelledError, OSError) as error:
        # A job keeps killing its workers, or was cancelled since the scheduler is lost. An OSError comes from
        # asking a scheduler that is gone: the connection is closed, or times out.
        raise _lost_cluster_error(address, error) from error
    except TypeError as error:
        # If a cluster is lost just when a result comes from it, Dask takes the result for an exception, and
        # fails to raise it. While the cluster is there, a TypeError is what a job has raised.
        if client.status == "running":
            raise
        raise _lost_cluster_error(address, error) from error


def _lost_cluster_error(address: str, error: BaseException) -> UsageError:
    """Return an error in one line that says why the cluster has failed, by ``error``, and how to go on."""
    reason = " ".join(str(error).split())  # Dask's messages have several lines
    return UsageError(
        f"the cluster at {address} failed; what was finished is kept: run the same again ({reason})"
    )


def _connect_client(dask: Any, address: str) -> Any:
    """Return a Dask client of the scheduler at ``address``, once that has answered a first message.

    Raises UsageError if no scheduler answers in time.
    """
    from distributed.comm import connect  # noqa: PLC0415

    async def exchange_first_messages() -> None:
        """Open a connection to the scheduler, by which first messages are exchanged, and close it."""
        security = dask.Security().get_connection_args("client")
        connection = await connect(address, timeout=_TIMEOUT, **security)
        await connection.close()

    # No client is made before the scheduler has answered. A client would wait without a limit for a server
    # that is silent. And a client that has failed is closed by the garbage collector, in any thread. In the
    # thread of the next client, both clients would wait for each other.
    try:
        # A second more, so that the error is that of connect, which says what went wrong.
        dask.utils.LoopRunner().run_sync(exchange_first_messages, callback_timeout=_TIMEOUT + 1)
        return dask.Client(address, timeout=_TIMEOUT, set_as_default=False)
    except MemoryError as error:
        # Another kind of server answered, and Dask took what it sent for the length of a message.
        raise _no_scheduler_error(address, "another server answers") from error
    except (OSError, ValueError, TypeError) as error:
        raise _no_scheduler_error(address, str(error) or "timed out") from error


def _no_scheduler_error(address: str, reason: str) -> UsageError:
    """Return the error that says why nothing at ``address`` can be used, and how to start a scheduler."""
    return UsageError(f"no Dask scheduler at {address}: {reason}; start one: dask scheduler")
