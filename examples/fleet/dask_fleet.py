"""Does the jobs of a fleet on a Dask cluster, then merges them: python dask_fleet.py MANIFEST [BATCH].

All nodes see the folder of the manifest under the same path, and the program as `abbe` (or what ABBE names).
DASK_SCHEDULER_ADDRESS names a cluster; without it Dask starts processes on this machine.
"""

import json
import os
import subprocess
import sys

import dask
from distributed import Client, as_completed

ABBE = os.environ.get("ABBE", "abbe")


def batch_of_jobs(manifest, first, count):
    """A batch. Status 1 says that jobs failed, which `abbe fleet status` names; anything else is tried again."""
    job = [ABBE, "fleet", "job", manifest, "--index", str(first), "--count", str(count)]
    status = subprocess.run(job, stdout=subprocess.DEVNULL).returncode
    if status not in (0, 1):
        raise RuntimeError(f"{' '.join(job)} ended with {status}")


def main(manifest, batch="100"):
    manifest, batch = os.path.abspath(manifest), int(batch)
    with open(manifest, encoding="utf-8") as lines:
        jobs = json.loads(next(lines))["jobs"]
    # How many workers may die that had the same batch. The scheduler of another cluster has its own setting.
    dask.config.set({"distributed.scheduler.allowed-failures": 10})
    with Client() as client:
        has_round = True
        while has_round:
            batches = range(0, jobs, batch)
            submit = lambda first: client.submit(batch_of_jobs, manifest, first, batch, pure=False, retries=10)
            for done in as_completed([submit(first) for first in batches]):
                done.result()
            # Estimates in shards have several rounds; all else is done.
            told = subprocess.run([ABBE, "fleet", "next", manifest], stdout=subprocess.PIPE, text=True).stdout
            has_round = told.startswith("a new round")
    return subprocess.run([ABBE, "fleet", "merge", manifest]).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
