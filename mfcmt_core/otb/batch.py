"""Runs many jobs at once through joblib: in processes of this machine, or on a Ray or Dask cluster.

joblib gives up a whole batch when a process dies. Here the jobs that were under way are tried again, at last each
alone, so that only the job that kills its process is lost, and is known by name.
"""

from __future__ import annotations

import os
import platform
import signal
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import cv2
from joblib import Parallel, delayed, parallel_config, register_parallel_backend

from ..errors import DataError, MFCMTError
from .trackers import code_hash

LOCAL = "processes"
BACKENDS = (LOCAL, "ray", "dask")
ATTEMPTS = 3

Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Lost:
    """What became of a job without a result. ``final`` says that the job itself is at fault: it is not tried again."""

    reason: str
    final: bool = False


class NoWorkers(Exception):
    """No process could begin."""


def run_batch(
    work: Callable[[Job], Result], jobs: Iterable[Job], processes: int | None = None, backend: str = LOCAL
) -> Iterator[tuple[Job, Result | Lost]]:
    """Yield each job with what ``work`` returned for it, as soon as it is done.

    Parameters
    ----------
    work : callable
        A function of a module, since it is called in other processes. A job for which it raises MFCMTError is lost.
        One whose process or machine dies, or for which ``work`` raises something else, has :data:`ATTEMPTS`.
    jobs : iterable
        Values that can be pickled, in the order in which they are begun.
    processes : int, optional
        How many jobs run at once, by default one a CPU of this machine or of the cluster.
    backend : str, optional
        One of :data:`BACKENDS`. Ray's cluster is that of RAY_ADDRESS or of this machine's ``ray start``, Dask's that of
        DASK_SCHEDULER_ADDRESS. Their machines need the same mfcmt, and the same files under the same names.

    Raises
    ------
    DataError
        There is no cluster, or its package is not installed.
    """
    width = _CLUSTERS[backend]() if backend in _CLUSTERS else lambda: os.cpu_count() or 1
    todo = dict(enumerate(jobs))
    losses: Counter[int] = Counter()
    starts = 0
    while todo:
        together = {number: job for number, job in todo.items() if losses[number] < ATTEMPTS - 1}
        alone = dict([next(iter(todo.items()))])
        count = (processes or width()) if together else 1
        try:
            for number, result in _run(work, together or alone, count, width(), backend, bool(losses)):
                if isinstance(result, Lost) and not result.final and losses[number] < ATTEMPTS - 1:
                    losses[number] += 1
                    todo[number] = todo.pop(number)  # after those that have not had their turn
                else:
                    yield todo.pop(number), result
        except NoWorkers as failed:
            starts += 1
            if not losses or starts == ATTEMPTS:
                raise DataError(f"the backend {backend} cannot work: {failed}") from failed
            # A cluster that has just lost a machine may begin processes there until it notices.


def _run(
    work: Callable[[Job], Result], jobs: dict[int, Job], processes: int, width: int, backend: str, again: bool
) -> Iterator[tuple[int, Result | Lost]]:
    """Yield what became of the jobs, by number; of those that have not begun nothing, if the workers die.

    ``width`` is the number of CPUs, and ``again`` says that some jobs were lost before.
    """
    begun: set[int] = set()
    code = code_hash() if backend in _CLUSTERS else None

    def calls() -> Iterator[object]:
        for number, job in jobs.items():
            begun.add(number)
            yield delayed(_do)(work, number, job, code)

    # joblib works in this very process where it may have only one: two, of which one is idle, protect it. (Ray refuses
    # more processes than its cluster has CPUs, so with a single one left the work is done here.)
    count = max(2, processes) if backend == LOCAL else min(max(2, processes), width)
    options: dict[str, object] = {"max_nbytes": None}
    if backend == LOCAL:
        options |= {
            "inner_max_num_threads": 1,
            "initializer": signal.signal,
            "initargs": (signal.SIGINT, signal.SIG_IGN),
        }
    elif backend == "ray":
        # After a loss Ray may still count the CPUs of a machine that is gone, and would wait for them.
        strategy = {"num_cpus": 0, "scheduling_strategy": "SPREAD"} if again else {"num_cpus": 1}
        options |= {"ray_remote_args": strategy}
    try:
        with parallel_config("loky" if backend == LOCAL else backend, n_jobs=count, **options):
            batch = Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch=min(processes, len(jobs)))
            for number, result in batch(calls()):
                begun.remove(number)
                yield number, result
    except Exception as died:
        if not begun:
            raise NoWorkers(str(died).splitlines()[0]) from died
        for number in begun:
            yield number, Lost(f"its process died: {str(died).splitlines()[0]}")


def _do(work: Callable[[Job], Result], number: int, job: Job, code: str | None) -> tuple[int, Result | Lost]:
    """Do the job in the worker; ``code`` is the hash that its mfcmt must have."""
    cv2.setNumThreads(1)
    if code is not None and code != code_hash():
        return number, Lost(f"{platform.node()} has another mfcmt, whose results may differ: install the same")
    try:
        return number, work(job)
    except MFCMTError as failed:
        return number, Lost(str(failed), final=True)
    except OSError as failed:
        return number, Lost(f"{failed.filename or platform.node()}: {failed.strerror}")
    except Exception as failed:
        return number, Lost(f"{type(failed).__name__}: {failed}")


def _ray() -> Callable[[], int]:
    """Connect to the cluster, and return what counts its processors."""
    try:
        import ray
        from ray.util.joblib.ray_backend import RayBackend
    except ModuleNotFoundError as missing:
        raise DataError("the backend ray is not installed: pip install 'mfcmt[ray]'") from missing

    class Backend(RayBackend):  # type: ignore[misc]
        """As Ray's own, which inherits from a pool of processes that it cannot yield results one by one."""

        supports_return_generator = True

    register_parallel_backend("ray", Backend)
    try:
        ray.init(address="auto", log_to_driver=False, logging_level="error", ignore_reinit_error=True)
    except ConnectionError as absent:
        raise DataError("there is no Ray cluster: set RAY_ADDRESS, or begin one with ray start --head") from absent
    return lambda: int(sum(node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"]))


def _dask() -> Callable[[], int]:
    """Connect to the cluster, and return what counts its threads."""
    try:
        from distributed import Client
    except ModuleNotFoundError as missing:
        raise DataError("the backend dask is not installed: pip install 'mfcmt[dask]'") from missing
    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    if address is None:
        raise DataError("there is no Dask cluster: set DASK_SCHEDULER_ADDRESS, as tcp://scheduler:8786")
    try:
        client = Client(address)
    except OSError as absent:
        raise DataError(f"no Dask scheduler answers at DASK_SCHEDULER_ADDRESS={address}: {absent}") from absent
    return lambda: sum(client.ncores().values())


_CLUSTERS = {"ray": _ray, "dask": _dask}
