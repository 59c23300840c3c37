#!/usr/bin/env bash
# A cluster of Slurm on the loopback: munged, slurmctld and several slurmd of one core each. Sourced
# by the scripts beside it: `slurm_start N`, `slurm_stop`, `slurm_kill_node K`, `slurm_start_node K`.
# Installs Debian's packages where they are missing, which needs root.

slurm_install() {
    command -v slurmctld slurmd sbatch munged > /dev/null && return
    apt-get update --quiet --quiet
    DEBIAN_FRONTEND=noninteractive apt-get install --quiet --quiet --yes --no-install-recommends \
        slurmctld slurmd slurm-client munge > /dev/null
}

# slurm_start NODES [CPUS of each]
slurm_start() {
    local nodes=$1 cpus=${2:-1} host
    slurm_install
    slurm=$(mktemp -d /tmp/slurm.XXXXXX)
    host=$(hostname -s)
    export SLURM_CONF=$slurm/slurm.conf
    mkdir -p "$slurm"/{state,spool,log} /run/munge
    head -c 1024 /dev/urandom > "$slurm/munge.key"
    chmod 600 "$slurm/munge.key"
    munged --force --key-file="$slurm/munge.key" --socket="$slurm/munge.socket" \
        --pid-file="$slurm/munged.pid" --log-file="$slurm/log/munged" --seed-file="$slurm/munge.seed"
    {
        cat << CONF
ClusterName=loopback
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$slurm/munge.socket
CredType=cred/munge
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
StateSaveLocation=$slurm/state
SlurmdSpoolDir=$slurm/spool/%n
SlurmctldPidFile=$slurm/slurmctld.pid
SlurmdPidFile=$slurm/slurmd.%n.pid
SlurmctldLogFile=$slurm/log/slurmctld
SlurmdLogFile=$slurm/log/slurmd.%n
SlurmdTimeout=10
SlurmctldTimeout=10
MessageTimeout=20
InactiveLimit=0
KillWait=5
ReturnToService=2
JobRequeue=1
SchedulerType=sched/backfill
SchedulerParameters=sched_interval=1,bf_interval=1,sched_min_interval=100000
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
CONF
        for ((node = 1; node <= nodes; node++)); do
            echo "NodeName=n$node NodeHostname=$host NodeAddr=127.0.0.1 Port=$((16819 + node)) CPUs=$cpus RealMemory=4000 State=UNKNOWN"
        done
        echo "PartitionName=main Nodes=n[1-$nodes] Default=YES MaxTime=INFINITE State=UP"
    } > "$SLURM_CONF"
    slurmctld
    for ((node = 1; node <= nodes; node++)); do slurm_start_node $node; done
    for _ in $(seq 100); do
        [ "$(sinfo --noheader --Node --states=idle 2> /dev/null | wc -l)" = "$nodes" ] && return
        sleep 0.2
    done
    echo "slurm: the nodes did not come up" >&2
    tail -5 "$slurm"/log/* >&2
    return 1
}

slurm_start_node() {
    slurmd -N "n$1"
}

# The daemon of a node and all that it runs die at once, as of a machine that loses its power.
slurm_kill_node() {
    local process
    kill -KILL "$(cat "$slurm/slurmd.n$1.pid")"
    for process in /proc/[0-9]*; do
        # Steps keep the log of their daemon open; programs have the name of their node.
        if ls -l "$process/fd" 2> /dev/null | grep -q "$slurm/log/slurmd.n$1\$" ||
            { grep -qz "^SLURMD_NODENAME=n$1\$" "$process/environ" && grep -qz "^SLURM_CONF=$SLURM_CONF\$" "$process/environ"; } 2> /dev/null; then
            kill -KILL "${process#/proc/}" 2> /dev/null || true
        fi
    done
}

# Waits for a job to leave the queue: slurm_wait JOB SECONDS
slurm_wait() {
    local end=$((SECONDS + $2))
    while squeue --noheader --jobs="$1" 2> /dev/null | grep -q .; do
        if ((SECONDS > end)); then
            squeue >&2
            return 1
        fi
        sleep 0.5
    done
}

slurm_stop() {
    [ -n "${slurm:-}" ] || return 0
    scancel --state=RUNNING,PENDING --user=root 2> /dev/null || true
    for pid in "$slurm"/*.pid; do
        [ -e "$pid" ] && kill "$(cat "$pid")" 2> /dev/null
    done
    sleep 1
    rm -rf "$slurm"
    slurm=
}
