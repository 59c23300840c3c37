#!/usr/bin/env bash
# Batches on a cluster, with faults: Slurm with two nodes of one core and an S3 server, both on the
# loopback. Every picture must be that of one command without a cache.
#
#     tests/farm/check.sh [FOLDER]
#
# Installs Debian's Slurm and, into FOLDER/venv, moto and openjd-cli of PyPI. Needs root. With
# RELIGHT_NO_FARM=1 it is skipped; FRAMES=240 makes a longer film.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
if [ "${RELIGHT_NO_FARM:-}" ] || [ "$(id -u)" != 0 ]; then
    echo "tests/farm/check.sh is skipped: RELIGHT_NO_FARM is set, or this is not root"
    exit 0
fi
relight=${RELIGHT:-$here/../../target/release/relight}
mkdir -p "${1:-/tmp/relight-farm}"
cd "${1:-/tmp/relight-farm}"
work=$PWD
source "$here/slurm.sh"
server=
finish() {
    slurm_stop
    [ -z "$server" ] || { kill -CONT "$server"; kill "$server"; } 2> /dev/null || true
    mountpoint -q "$work/full" 2> /dev/null && umount "$work/full" || true
}
trap finish EXIT

[ -x venv/bin/openjd ] || { python3 -m venv venv && venv/bin/pip install --quiet 'moto[server]==5.2.5' openjd-cli==0.8.0; }
export XDG_CONFIG_HOME=$work/config AWS_ACCESS_KEY_ID=farm AWS_SECRET_ACCESS_KEY=farm-secret-farm \
    AWS_REGION=us-east-1 AWS_ENDPOINT_URL=http://127.0.0.1:5123
venv/bin/moto_server -H 127.0.0.1 -p 5123 > moto.log 2>&1 &
server=$!
s3() { # s3 PYTHON, with the client `s3` and the bucket "farm"
    venv/bin/python -c "import boto3; s3 = boto3.client('s3', endpoint_url='$AWS_ENDPOINT_URL')
$1"
}
for _ in $(seq 50); do s3 "s3.create_bucket(Bucket='farm')" 2> /dev/null && break || sleep 0.2; done

# Six photos that differ in their working size, two edits each, and a film.
frames=${FRAMES:-24}
rm -rf out* plan* cache* full
mkdir -p edits
echo 'Edit(version: 1, lights: { "lamp_0": Off })' > edits/off.ron
echo 'Edit(version: 1, lights: { "window_0": Scale(0.4) })' > edits/dim.ron
echo 'Edit(version: 1, frames: '$frames', lights: { "lamp_0": Scale(Keys([(0, 1.0), (23, 0.0)])), "desk": Lamp(shape: Sphere(radius: 0.07), at: Point(0.12, -0.56, -2.94), radiance: Keys([(0, (72, 44, 20)), (12, (10, 44, 80))])) })' > edits/day.ron
{
    echo "scene,edit,out,scene.long_side"
    for size in 96 100 104 108 112 116; do
        for edit in off dim; do echo "$here/../scenes/small,edits/$edit.ron,p$size/$edit,$size"; done
    done
} > photos.csv
echo 'Batch(version: 1, graph: "physics", table: "photos.csv")' > photos.ron
echo "Batch(version: 1, graph: \"physics\", scenes: [\"$here/../scenes/small\"], edits: [\"edits/day.ron\"], chunk: $((frames / 6)), set: [\"scene.long_side=96\"])" > film.ron
run() { "$relight" batch "$@" > /dev/null 2> last.log || { tail -5 last.log; return 1; }; }
sum() { (cd "$1" && find . -name 'picture*.png' | sort | xargs sha256sum | sha256sum | cut -c1-16); }
same() { # same NAME FOLDER REFERENCE
    if [ "$(sum "$2")" = "$(sum "$3")" ]; then
        echo "ok: $1: $(find "$2" -name 'picture*.png' | wc -l) pictures the same"
    else
        echo "FAILED: $1: pictures differ from $3"
        exit 1
    fi
    rm -rf "$2"
}
told() { grep -h "$@" | sort | uniq -c | head -3 | cut -c1-230; }
twice() { # keys that ran in more than one job, of all that ran
    find "$1" -name 'report*.json' -print0 | xargs -0 jq -r '(.frames // [.])[] | .nodes[] | select(.status == "ran") | .key + " " + .kind' \
        | sort | uniq -c | awk '{ all++; if ($1 > 1) { n++; kinds[$3] += $1 - 1 } } END { printf "%d of %d keys computed more than once", n, all; for (kind in kinds) printf " %s:%d", kind, kinds[kind]; print "" }'
}
step() { echo "== $* (${SECONDS} s)"; }

step reference
run photos.ron --out out.photos --no-cache
run film.ron --out out.film --no-cache
store="--cache-store s3://farm"

step "a film in chunks on two nodes"
run film.ron --out out.slurm --plan slurm plan.film --jobs-per-task 1 --cache "$work/cache.film" $store/film
slurm_start 2
slurm_wait "$(bash plan.film/submit.sh)" 300
twice out.slurm
grep -h "cpu_seconds" out.slurm/batch/task_*.json | tr -d ",\n"; echo " in tasks, and $(grep -h cpu_seconds out.film/batch/run.json) in one command"
same "a film on Slurm" out.slurm out.film

step "a node dies in the middle"
run photos.ron --out out.slurm --plan slurm plan.photos --jobs-per-task 2 --cache "$work/cache.photos" $store/photos
job=$(bash plan.photos/submit.sh)
for _ in $(seq 100); do [ "$(find out.slurm -name job.json 2> /dev/null | wc -l)" -ge 3 ] && break || sleep 0.1; done
slurm_kill_node 2
sleep 12 # until the controller has seen it
slurm_start_node 2
slurm_wait "$job" 300
tail -1 plan.photos/log/finish.txt
told 'error: Node\|requeue\|Requeue\|not responding\|DOWN' "$slurm/log/slurmctld" || true
same "a node killed" out.slurm out.photos
slurm_stop

step "the store stands still for a minute"
rm -rf cache.*
kill -STOP $server
(sleep 60; kill -CONT $server) &
run photos.ron --out out.a --cache cache.a $store/stopped
wait $!
told 'warning\|cache store' last.log
same "the store stopped" out.a out.photos

step "blobs flipped, records lost"
run photos.ron --out out.a --cache cache.b $store/flip
rm -rf out.a
s3 "
blobs = [b['Key'] for page in s3.get_paginator('list_objects_v2').paginate(Bucket='farm', Prefix='flip/') for b in page['Contents']]
values = [b for b in blobs if '/cas/' in b]
records = [b for b in blobs if '/ac/' in b]
for key in values[::3]:
    body = bytearray(s3.get_object(Bucket='farm', Key=key)['Body'].read())
    body[len(body) // 2] ^= 4
    s3.put_object(Bucket='farm', Key=key, Body=bytes(body))
for key in records[::5]: s3.delete_object(Bucket='farm', Key=key)
print(len(values[::3]), 'of', len(values), 'values flipped,', len(records[::5]), 'of', len(records), 'records lost')"
run photos.ron --out out.a --cache cache.c $store/flip
told 'cache store' last.log
find out.a -name 'report.json' -print0 | xargs -0 jq -r '.warnings[]' | grep -o 'the store returned other bytes' | sort | uniq -c || true
same "blobs flipped" out.a out.photos

step "two batches on one store"
run photos.ron --out out.a --cache cache.d $store/two &
"$relight" batch photos.ron --out out.b --cache cache.e $store/two > /dev/null 2> two.log
wait $!
told 'cache store' last.log two.log
same "two batches, the first" out.a out.photos
same "two batches, the second" out.b out.photos

step "the disk of the cache is full"
mkdir -p full
if mount -t tmpfs -o size=6m tmpfs full 2> /dev/null; then
    run photos.ron --out out.a --cache full/cache $store/full
    find out.a -name 'report.json' -print0 | xargs -0 jq -r '.warnings[]' | told 'without storing'
    same "the disk full" out.a out.photos
else
    echo "skipped: this machine does not let tmpfs be mounted"
fi

step "Open Job Description"
run photos.ron --out out.a --plan openjd farm --jobs-per-task 4 --cache cache.f $store/openjd
venv/bin/openjd check farm/template.json
for name in Shared Edits Finish; do
    jq -e ".steps[] | select(.name == \"$name\")" farm/template.json > /dev/null || continue
    venv/bin/openjd run farm/template.json --step "$name" > openjd.log 2>&1 || { tail openjd.log; exit 1; }
    grep -h 'Session ended\|Tasks' openjd.log | tail -2 || true
done
same "Open Job Description" out.a out.photos
echo "passed (${SECONDS} s)"
