"""The workers of a Dask cluster, through the interface of ``concurrent.futures``; Dask is loaded here alone."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from recon.batch.batch_run import Crew
from recon.batch.cores import place
from recon.errors import MissingProgramError, ReconError

CONNECT_LIMIT_S = 20.0


@contextmanager
def cluster_crew(address: str, *, threads: int) -> Iterator[Crew]:
    """Give the workers behind the scheduler at ``address`` (``tcp://host:port``).

    Raises
    ------
    ReconError
        Where no scheduler answers, or a worker would run several sessions in one process.
    MissingProgramError
        Where Dask is not installed.
    """
    try:
        import distributed
        from distributed.comm import CommClosedError
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise MissingProgramError(
            "recon batch --scheduler needs Dask, which is not installed; install refractive-scan[cluster]"
        ) from None
    try:
        client = distributed.Client(address, timeout=CONNECT_LIMIT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ReconError(
            f"{address}: no Dask scheduler answers there within {CONNECT_LIMIT_S:.0f} s ({error}); "
            "start `dask scheduler` and give its address"
        ) from None
    try:
        with client:
            _check_threads(client.scheduler_info(n_workers=-1)["workers"])
            workers_at = Counter(client.run(place).values())
            # Not pure: the same session is handed out again after a loss.
            executor = client.get_executor(pure=False)
            name = f"{workers_at.total()} workers of {address}"
            yield Crew(name, executor, KilledWorker, threads=threads, workers_at=workers_at)
    except CommClosedError as error:
        raise ReconError(
            f"{address}: the Dask scheduler is gone ({error}); what is done is kept, "
            "and `recon batch --resume` goes on with the rest"
        ) from None


def _check_threads(workers: dict[str, dict[str, object]]) -> None:
    many = [address for address, worker in workers.items() if worker["nthreads"] != 1]
    if many:
        raise ReconError(
            f"{many[0]}: this Dask worker has several threads, which would share one process among sessions; "
            "start the workers with --nthreads 1 (recon uses the cores itself)"
        )
