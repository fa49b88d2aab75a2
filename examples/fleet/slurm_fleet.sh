#!/bin/sh
# Does the jobs of a fleet as an array of Slurm, then merges them: slurm_fleet.sh MANIFEST [BATCH].
# All nodes see the folder of the manifest under the same path, and the program as `abbe` (or what ABBE names).
set -eu
manifest=$(realpath "$1")
batch=${2:-100}
abbe=${ABBE:-abbe}
jobs=$(head -n 1 "$manifest" | sed 's/.*"jobs":\([0-9]*\).*/\1/')
last=$(((jobs + batch - 1) / batch - 1))
for round in 1 2 3 4 5 6 7 8 9 10 11 12; do
    # A task that was killed leaves jobs open: they are dealt out again. Those that are done take no time. Estimates in shards have
    # several rounds.
    sbatch --wait --quiet --array="0-$last" --ntasks=1 --output=/dev/null <<END || true
#!/bin/sh
exec "$abbe" fleet job "$manifest" --index \$((SLURM_ARRAY_TASK_ID * $batch)) --count $batch
END
    "$abbe" fleet next "$manifest" || true
    # Its status is 1 where jobs failed.
    if { "$abbe" fleet status "$manifest" || true; } | grep -q ', 0 open$'; then
        break
    fi
    echo "round $round left jobs open" >&2
done
exec "$abbe" fleet merge "$manifest"
