"""Two nodes of Ray or Dask on this machine, in the environment that has them; prints the address.

usage: .venv-clusters/bin/python tests/clusters/cluster.py ray|dask

``kill`` on the standard input kills one of the nodes, the end of it stops the cluster.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable


def ray_cluster() -> tuple[str, Callable[[], object], Callable[[], object]]:
    # By default its workers wait for all others on a busy machine.
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    other = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    return cluster.address, lambda: cluster.remove_node(other, allow_graceful=False), cluster.shutdown


def dask_cluster() -> tuple[str, Callable[[], object], Callable[[], object]]:
    from distributed import LocalCluster

    cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    victim = cluster.workers[0]
    return cluster.scheduler_address, lambda: os.kill(victim.pid, signal.SIGKILL), cluster.close


def main(kind: str) -> None:
    address, kill, close = {"ray": ray_cluster, "dask": dask_cluster}[kind]()
    print(address, flush=True)
    for line in sys.stdin:
        if line.strip() == "kill":
            kill()
            print("killed", flush=True)
    close()


if __name__ == "__main__":
    main(sys.argv[1])
