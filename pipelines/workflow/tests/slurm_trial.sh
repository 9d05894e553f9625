#!/usr/bin/env bash
# A Slurm cluster of two nodes on this machine, and batches on it. With Snakemake: a node is killed in the middle, the run must
# complete. As arrays: KILLS units (20) are killed at random and submitted again. The products of both must be those of an
# undisturbed batch.
#
#   pipelines/workflow/tests/slurm_trial.sh FOLDER        (a new folder; logs and products stay there)
#
# Needs root, Debian's slurmctld, slurmd, slurm-client and munge, and Snakemake with its Slurm executor
# (pip install snakemake snakemake-executor-plugin-slurm) on the PATH or in SNAKEMAKE; HELIOSPLAT names the program.
set -euo pipefail

repository=$(cd "$(dirname "$0")/../../.." && pwd)
folder=$(mkdir -p "$1" && cd "$1" && pwd)
program=${HELIOSPLAT:-$repository/target/release/heliosplat}
snakemake=${SNAKEMAKE:-snakemake}
iterations=${ITERATIONS:-60}
kills=${KILLS:-20}
started=()

# Job steps look for the configuration where Debian puts it, whatever the environment says.
well_known=/etc/slurm/slurm.conf
[ ! -e "$well_known" ] || { echo "$well_known exists: this machine belongs to a cluster; not touched"; exit 1; }

descendants() {
    local child
    for child in $(pgrep -P "$1"); do echo "$child"; descendants "$child"; done
}
stop() {
    # Only what was started here, by its number.
    local pid
    for pid in "${started[@]}"; do kill -KILL "$pid" $(descendants "$pid") 2>/dev/null || true; done
    rm -f "$well_known"
}
trap stop EXIT

say() { printf '%s  %s\n' "$(date +%H:%M:%S)" "$*"; }

# --- authentication ------------------------------------------------------------------------------------------------
mkdir -p "$folder"/{munge,state,log} "$(dirname "$well_known")"
chmod 0755 "$folder/munge"
chmod 0700 "$folder/log"
dd if=/dev/urandom of="$folder/munge/key" bs=1024 count=1 status=none
chmod 0400 "$folder/munge/key"
munged --foreground --force --key-file "$folder/munge/key" --socket "$folder/munge/socket" \
    --pid-file "$folder/munge/pid" --seed-file "$folder/munge/seed" --log-file "$folder/log/munged.log" &
started+=($!)

# --- the cluster -----------------------------------------------------------------------------------------------------
host=$(hostname -s)
cat > "$folder/slurm.conf" <<CONF
ClusterName=trial
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
CredType=cred/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool-%n
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd-%n.pid
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdLogFile=$folder/log/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SchedulerType=sched/backfill
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SlurmdParameters=config_overrides
SlurmdTimeout=10
MinJobAge=600
ReturnToService=2
NodeName=node1 NodeHostname=$host NodeAddr=127.0.0.1 Port=17001 CPUs=1 RealMemory=4000
NodeName=node2 NodeHostname=$host NodeAddr=127.0.0.1 Port=17002 CPUs=1 RealMemory=4000
PartitionName=trial Nodes=node1,node2 Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$folder/slurm.conf
ln -s "$SLURM_CONF" "$well_known"
sleep 1
slurmctld -D -f "$SLURM_CONF" > "$folder/log/slurmctld.out" 2>&1 &
started+=($!)
declare -A node
for n in 1 2; do
    mkdir -p "$folder/spool-node$n"
    slurmd -D -N "node$n" -f "$SLURM_CONF" > "$folder/log/slurmd-node$n.out" 2>&1 &
    started+=($!)
    node[$n]=$!
done
for _ in $(seq 30); do
    [ "$(sinfo -h -t idle -o %D | awk '{n += $1} END {print n + 0}')" = 2 ] && break
    sleep 1
done
sinfo

# --- the work --------------------------------------------------------------------------------------------------------
[ -d "$folder/scene" ] || "$program" synth satellite --site tiny --seed 5 --out "$folder/scene" > /dev/null
cat > "$folder/batch.toml" <<TOML
[tiles]
side_m = 24.0
overlap_m = 6.0
block = 64
[[images]]
name = "tiny"
scene = "scene"
[[presets]]
name = "fast"
set = { "train.iterations" = $iterations, "train.epochs" = 1000 }
TOML
run() {
    "$snakemake" -s "$repository/pipelines/workflow/Snakefile" --directory "$folder" --config \
        manifest="$folder/batch.toml" out="$folder/$1" program="$program" checkpoint_every=1s "${@:2}"
}

say "undisturbed, on this machine alone (profile local)"
run alone --profile "$repository/pipelines/workflow/profiles/local" --cores 2 > "$folder/log/local.log" 2>&1
tail -3 "$folder/log/local.log"

say "on the cluster (profile slurm)"
run cluster --profile "$repository/pipelines/workflow/profiles/slurm" --slurm-status-command squeue \
    --slurm-init-seconds-before-status-checks 5 --seconds-between-status-checks 5 --slurm-keep-successful-logs \
    --default-resources slurm_partition=trial slurm_account=trial mem_mb=1000 runtime=10 \
    > "$folder/log/slurm.log" 2>&1 &
workflow=$!
started+=($workflow)

# A node dies while a unit trains on it: its daemon and everything that it started, at once.
job_on() { squeue -h -t R -w "$1" -o %A | head -1; }
checkpoints() { find "$folder/cluster" -name training.bin 2>/dev/null | wc -l; }
for _ in $(seq 1200); do
    if [ -n "$(job_on node2)" ] && [ "$(checkpoints)" -gt 0 ]; then break; fi
    kill -0 "$workflow" 2>/dev/null || break
    sleep 0.2
done
job=$(job_on node2)
say "node2 runs job ${job:-none}; killing the node"
[ -n "$job" ] || { say "nothing ran on node2"; exit 1; }
# Steps are started by the daemon but not its children for long: they are known by the job's number.
steps=$(pgrep -f "slurmstepd: \[$job\." || true)
victims="${node[2]} $steps"
for step in $steps; do victims="$victims $(descendants "$step" | tr '\n' ' ')"; done
kill -KILL $victims 2>/dev/null || true
say "killed: $victims"

wait "$workflow" && code=0 || code=$?
say "the workflow ended with exit code $code"
sinfo
squeue -h -t all -o '%A %T %N %j' | sort | tee "$folder/log/jobs.txt"
grep -n -i -E 'node_fail|trying to restart' "$folder/log/slurm.log" || true
grep -h 'due to failure' "$folder/log/slurmctld.log" || true
[ "$code" = 0 ]

same_as_alone() {
    (cd "$folder/alone" && find . -name '*.tif' -o -name 'model.ply' | sort) | while read -r file; do
        cmp "$folder/alone/$file" "$folder/$1/$file"
    done
}
say "products of both, compared"
same_as_alone cluster
grep -q 'Trying to restart job' "$folder/log/slurm.log"
say "the same bytes; a node was killed and its unit was tried again"

# --- as arrays -------------------------------------------------------------------------------------------------------
say "node2 again, and the same batch as arrays; $kills units are killed"
slurmd -D -N node2 -f "$SLURM_CONF" >> "$folder/log/slurmd-node2.out" 2>&1 &
started+=($!)
submitted() {
    "$program" batch "$folder/batch.toml" --out "$folder/arrays" --plan --json 2> "$folder/log/plan.log" |
        python3 "$repository/pipelines/workflow/slurm_array.py" "$folder/batch.toml" "$folder/arrays" "$folder/jobs" --program "$program"
}
killed=0
until [ "$(submitted)" = "all units are finished" ]; do
    "$folder/jobs/submit.sh" --partition=trial > /dev/null
    while [ -n "$(squeue -h -t all -o %T | grep -E 'PENDING|RUNNING|COMPLETING')" ]; do
        sleep "0.$((RANDOM % 9 + 1))"
        units=($(pgrep -f -- "--out $folder/arrays --only" || true))
        if [ "${#units[@]}" -gt 0 ] && [ "$killed" -lt "$kills" ]; then
            kill -KILL "${units[RANDOM % ${#units[@]}]}" 2>/dev/null && killed=$((killed + 1))
        fi
    done
done
same_as_alone arrays
say "the same bytes; $killed units were killed"
[ "$killed" = "$kills" ]
