"""Does the jobs of a fleet on a Ray cluster, then merges them: python ray_fleet.py MANIFEST [BATCH].

All nodes see the folder of the manifest under the same path, and the program as `abbe` (or what ABBE names).
RAY_ADDRESS names a cluster; without it Ray uses this machine.
"""

import json
import os
import subprocess
import sys

import ray

ABBE = os.environ.get("ABBE", "abbe")


@ray.remote(num_cpus=1, max_retries=10, retry_exceptions=True)
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
    ray.init()
    has_round = True
    while has_round:
        waiting = [batch_of_jobs.remote(manifest, first, batch) for first in range(0, jobs, batch)]
        while waiting:
            done, waiting = ray.wait(waiting)
            ray.get(done)
        # Estimates in shards have several rounds; all else is done.
        told = subprocess.run([ABBE, "fleet", "next", manifest], stdout=subprocess.PIPE, text=True).stdout
        has_round = told.startswith("a new round")
    ray.shutdown()
    return subprocess.run([ABBE, "fleet", "merge", manifest]).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
