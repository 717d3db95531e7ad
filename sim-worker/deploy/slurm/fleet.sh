#!/usr/bin/env bash
# Computes a fleet dataset on a Slurm cluster: an array job of shards and a merge after it.
usage() {
    cat <<'END'
usage: fleet.sh [options] PLAN OUT SHARDS [sbatch option]...

  PLAN     plan file, visible on all nodes
  OUT      dataset: a folder visible on all nodes, or s3://bucket/prefix
  SHARDS   number of shards; stays the same for the life of the dataset

  --array LIST   only these shards, e.g. 3,7 or 0-15 (default: all)
  --most N       at most N shards at a time (default: as many as the cluster gives)
  --cpus N       processors of a shard (default: as in shards.sbatch)
  --mem M        memory of a shard, e.g. 8G (default: as in shards.sbatch)
  --time T       time limit of a shard (default: as in shards.sbatch)
  --logs DIR     folder of the logs (default: ema-logs)
  --help

All further options go to sbatch, for both jobs, and win: --partition=... --account=... --qos=...

Environment: SIM_WORKER, the program (default: sim-worker on the PATH), and EMA_SECRETS, a file of
lines NAME=value (mode 600) with the S3 credentials: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
AWS_REGION, AWS_ENDPOINT_URL. Credentials never belong in the scripts.

Something was cancelled, killed or ran out of time? The merge says which shards are missing.
Run the same command again, with or without --array: what is done is not computed again. The new
merge waits for all shards of this dataset, also those of earlier commands, and takes the place
of a merge that still waits.
END
}
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

wrong() {
    echo "fleet.sh: $1 (see fleet.sh --help)" >&2
    exit 2
}

array='' most='' logs=ema-logs shard_options=()
while [ $# -gt 0 ]; do
    case $1 in
    --help | -h) usage; exit 0 ;;
    --array | --most | --cpus | --mem | --time | --logs)
        [ $# -ge 2 ] || wrong "$1 needs a value"
        case $1 in
        --array) array=$2 ;;
        --most) most=$2 ;;
        --cpus) shard_options+=("--cpus-per-task=$2") ;;
        --mem) shard_options+=("--mem=$2") ;;
        --time) shard_options+=("--time=$2") ;;
        --logs) logs=$2 ;;
        esac
        shift 2
        ;;
    -*) wrong "unknown option $1" ;;
    *) break ;;
    esac
done
[ $# -ge 3 ] || wrong "PLAN, OUT and SHARDS are needed"
PLAN=$1 OUT=$2 EMA_SHARDS=$3
shift 3

# jobs start elsewhere: only whole paths. A URL stays as it is.
[ -r "$PLAN" ] || wrong "cannot read the plan $PLAN"
PLAN=$(realpath -- "$PLAN")
case $OUT in
*://*) ;;
*) OUT=$(realpath -m -- "$OUT") ;;
esac
case $EMA_SHARDS in
'' | 0* | *[!0-9]*) wrong "SHARDS is a number from 1, not '$EMA_SHARDS'" ;;
esac
case ${array:=0-$((EMA_SHARDS - 1))} in
*[!0-9,:-]*) wrong "--array takes a list such as 3,7 or 0-15, not '$array'" ;;
esac
mkdir -p -- "$logs"
logs=$(realpath -- "$logs")
if [ -n "${EMA_SECRETS:-}" ]; then
    [ -r "$EMA_SECRETS" ] || wrong "cannot read $EMA_SECRETS"
    EMA_SECRETS=$(realpath -- "$EMA_SECRETS")
    export EMA_SECRETS
fi
export PLAN OUT EMA_SHARDS

# the jobs of a dataset are known by their names
dataset=$(printf %s "$OUT" | cksum | cut -d' ' -f1)
user=$(id -un)

shards=$(sbatch --parsable --export=ALL --job-name="ema-shards-$dataset" --array="$array${most:+%$most}" \
    --output="$logs/shard-%a-%A.log" "${shard_options[@]}" "$@" "$here/shards.sbatch")
shards=${shards%%;*}

# a merge that still waits would run too early: this one takes its place
replaced=$(squeue --noheader --user="$user" --name="ema-merge-$dataset" --states=PENDING --format=%A | xargs)
after=$(squeue --noheader --user="$user" --name="ema-shards-$dataset" --format=%F | sort -un | paste -sd:)
# `afterany`: see merge.sbatch. `singleton`: never beside another merge of this dataset.
merge=$(sbatch --parsable --export=ALL --job-name="ema-merge-$dataset" \
    --dependency="afterany:${after:-$shards},singleton" --output="$logs/merge-%j.log" "$@" "$here/merge.sbatch")
merge=${merge%%;*}
if [ -n "$replaced" ]; then
    # shellcheck disable=SC2086
    scancel $replaced
fi

cat <<END
dataset  $OUT
shards   job $shards, tasks $array of $EMA_SHARDS
merge    job $merge, after job ${after:-$shards}
logs     $logs

watch    squeue --jobs=$shards,$merge
         tail -f $logs/merge-$merge.log    (once the merge runs)
stop     scancel $shards $merge
END
