"""Run the jobs of a sweep on a Dask cluster.

The scheduler gives a job to another worker if the one that has it dies. A result is fetched as soon as it is
there and kept by the sweep's store on this machine; from then on nothing that happens to the cluster can harm
it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.common import UsageError, software_versions
from mcp_asdf_tools.experiments.measurement import Measured

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.simulation import Job

_PATIENCE = 30
"""Seconds to wait for the scheduler, and then for a first worker."""

_AHEAD = 2
"""Jobs given out for each thread of the cluster: one that runs and one that waits."""


def run_on_cluster(jobs: Iterator[Job], address: str) -> Iterator[tuple[Job, Measured]]:
    """Run jobs on the cluster whose scheduler is at ``address``; yields results as they come.

    Workers may come and go. Raises UsageError if the cluster cannot be reached or is lost, if it has another
    version of this program, or if a job keeps killing its workers.
    """
    with _connected(address) as (client, completed):
        running: dict[Any, Job] = {}
        while True:
            room = _AHEAD * max(1, sum(client.nthreads().values()))  # workers come and go
            for job in islice(jobs, max(0, room - len(running))):
                future = client.submit(_run, job, pure=False)
                running[future] = job
                completed.add(future)
            if not running:
                return
            future = next(completed)
            version, measured = future.result()
            _check_version(version)
            yield running.pop(future), measured


def _run(job: Job) -> tuple[str, Measured]:
    """Run a job on a worker; returns the worker's version too."""
    return software_versions()["mcp-asdf"], job.run()


def _check_version(version: str) -> None:
    own = software_versions()["mcp-asdf"]
    if version != own:
        raise UsageError(
            f"a worker of the cluster has mcp-asdf {version}, this is {own}; install the same on all"
        )


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """A client of the cluster with at least one worker, and a queue for what is done.

    Failures there become UsageErrors.
    """
    try:
        import distributed as dask  # noqa: PLC0415
        from distributed.comm.core import CommClosedError  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(f"no Dask here ({error}); install it: pip install 'mcp-asdf[cluster]'") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is raised
    client = _client(dask, address)
    try:
        _await_worker(client, address)
        queue: Any = dask.as_completed
        yield client, queue(loop=client.loop)
    except (dask.KilledWorker, dask.client.FutureCancelledError, CommClosedError) as error:
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
        reason = _reason(error)
        raise UsageError(f"no Dask scheduler at {address}: {reason}; start one: dask scheduler") from error


def _reason(error: Exception) -> str:
    """Why there is no connection."""
    if isinstance(error, TimeoutError):  # some say nothing
        return f"timed out after {_PATIENCE} s"
    if isinstance(error, MemoryError):  # its first bytes were taken for the length of the rest
        return "another server answers"
    return str(error)


def _await_worker(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        message = f"the cluster at {address} has no workers; start some: dask worker {address}"
        raise UsageError(message) from error
