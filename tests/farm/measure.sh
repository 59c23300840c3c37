#!/usr/bin/env bash
# The tables of docs/farm.md: photos x edits by a loop, by a batch, and by Slurm with one and two
# nodes of one core; the second edit on a machine with a cold disk and a warm store.
#
#     tests/farm/measure.sh FOLDER PHOTOS    (needs root for Slurm; FOLDER/venv has numpy, pillow, OpenEXR)
#
# Processor time is that of all processes of a variant; the machine may be busy otherwise.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
relight=${RELIGHT:-$here/../../target/release/relight}
work=$(mkdir -p "$1" && cd "$1" && pwd)
count=$2
source "$here/slurm.sh"
trap slurm_stop EXIT
cd "$work"
export XDG_CONFIG_HOME=$work/config

python=python3
[ -x venv/bin/python ] && python=venv/bin/python
[ -d photos ] || "$python" "$here/photos.py" photos "$count"
mkdir -p edits
echo 'Edit(version: 1, lights: { "inv_lamp": Scale(1.4) })' > edits/warmer.ron
echo 'Edit(version: 1, lights: { "lamp_0": Off })' > edits/off.ron
echo 'Edit(version: 1, lights: { "desk": Lamp(shape: Sphere(radius: 0.08), at: Pixel(x: 130, y: 150, lift: 0.3), radiance: (60, 50, 40)) })' > edits/desk.ron
list() { echo "Batch(version: 1, scenes: [\"photos/*\"], edits: [$1], out: \"$2\")" > "$2.ron"; }
all='"edits/warmer.ron", "edits/off.ron", "edits/desk.ron"'
pictures() { (cd "$1" && find . -name picture.png | sort | xargs sha256sum | sha256sum | cut -c1-16); }
# Processor seconds of all children of this shell so far; `times` counts those of its own shell.
cpu() { times > times; tail -1 times | sed 's/m/ /g; s/s//g' | awk '{ printf "%.1f\n", 60 * ($1 + $3) + $2 + $4 }' > "$1"; }
tasks_cpu() { jq -s 'map(.cpu_seconds) | add' "$1"/batch/*.json; }

loop() {
    local start
    cpu before
    start=$(date +%s.%N)
    for scene in photos/*; do
        for edit in edits/warmer.ron edits/off.ron edits/desk.ron; do
            "$relight" run indoor "$edit" --scene "$scene" --out "loop/$(basename "$scene")/$(basename "$edit" .ron)" \
                --cache cache.loop --quiet > /dev/null || echo "failed: $scene $edit"
        done
    done
    cpu after
    echo "loop: $(echo "$(cat after) - $(cat before)" | bc) s of processor, $(echo "$(date +%s.%N) - $start" | bc) s, pictures $(pictures loop)"
}

batch() {
    list "$all" batch
    local start
    start=$(date +%s.%N)
    "$relight" batch batch.ron --cache cache.batch 2> batch.log > /dev/null || true
    echo "batch: $(tasks_cpu batch) s of processor, $(echo "$(date +%s.%N) - $start" | bc) s, pictures $(pictures batch)"
    grep ' jobs, ' batch.log
}

on_slurm() {
    local nodes=$1 start finish
    list "$all" "slurm$nodes"
    rm -rf "plan$nodes" "slurm$nodes"
    "$relight" batch "slurm$nodes.ron" --plan slurm "plan$nodes" --jobs-per-task 6 --cache "$work/cache.slurm$nodes" > /dev/null
    slurm_start "$nodes"
    start=$(date +%s.%N)
    finish=$(bash "plan$nodes/submit.sh")
    slurm_wait "$finish" 3000
    echo "slurm, $nodes nodes: $(tasks_cpu "slurm$nodes") s of processor, $(echo "$(date +%s.%N) - $start" | bc) s, pictures $(pictures "slurm$nodes")"
    tail -1 "plan$nodes/log/finish.txt"
    slurm_stop
}

# The second edit of all photos: alone, and from a store that the first edit has filled.
second() {
    local store=${STORE:-file://$work/store}
    list '"edits/warmer.ron"' first
    list '"edits/desk.ron"' alone
    list '"edits/desk.ron"' second
    "$relight" batch first.ron --cache cache.first --cache-store "$store" > /dev/null 2> first.log
    "$relight" batch alone.ron --cache cache.alone > /dev/null 2> alone.log
    "$relight" batch second.ron --cache cache.second --cache-store "$store" > /dev/null 2> second.log
    for name in first alone second; do
        echo "$name: $(tasks_cpu $name) s of processor, $(awk -F, 'NR > 1 { rays += $7; seconds += $6 } END { print rays " rays, " seconds " s of jobs" }' $name/results.csv), pictures $(pictures $name)"
        grep '^cache store' $name.log || true
    done
    "$relight" cache stat --store "$store"
}

# A film of 240 frames: one run, and chunks on two nodes with a disk each and one store.
film() {
    local frames=240 start finish
    echo "Edit(version: 1, frames: $frames, lights: { \"lamp_0\": Scale(Keys([(0, 1.0), (120, 0.0), (239, 1.2)])), \"desk\": Lamp(shape: Sphere(radius: 0.07), at: Keys([(0, Point(-0.35, -0.33, -2.94)), (239, Point(0.45, -0.33, -2.94))]), radiance: (72, 44, 20)) })" > film_edit.ron
    echo "Batch(version: 1, graph: \"physics\", scenes: [\"$here/../scenes/small\"], edits: [\"film_edit.ron\"], chunk: 24, set: [\"scene.long_side=96\"], out: \"film\")" > film.ron
    rm -rf film film.one planfilm cache.film*
    cpu before
    "$relight" run physics film_edit.ron --scene "$here/../scenes/small" --set scene.long_side=96 --out film.one --cache cache.film.one --quiet > /dev/null
    cpu after
    echo "film, one run: $(echo "$(cat after) - $(cat before)" | bc) s of processor"
    "$relight" batch film.ron --plan slurm planfilm --jobs-per-task 1 --cache "$work/cache.film.node" --cache-store "file://$work/store.film" > /dev/null
    sed -i 's/cache.film.node/cache.film.$SLURMD_NODENAME/' planfilm/task.sbatch
    slurm_start 2
    start=$(date +%s.%N)
    finish=$(bash planfilm/submit.sh)
    slurm_wait "$finish" 3000
    slurm_stop
    echo "film, two nodes: $(tasks_cpu film) s of processor, $(echo "$(date +%s.%N) - $start" | bc) s"
    jq -s -c 'map(.traffic) | {gets: map(.gets) | add, found: map(.found) | add, in: map(.bytes_in) | add, puts: map(.puts) | add, out: map(.bytes_out) | add}' film/batch/task_*.json
    find film -name 'report_*.json' -print0 | xargs -0 jq -r '.frames[] | .nodes[] | select(.status == "ran") | .key + " " + .kind' \
        | sort | uniq -c | awk '{ all++; if ($1 > 1) { n++; kinds[$3] += $1 - 1 } } END { printf "%d of %d keys computed more than once", n, all; for (kind in kinds) printf " %s:%d", kind, kinds[kind]; print "" }'
    diff <(cd film.one && sha256sum picture_*.png) <(cd film/small/film_edit && sha256sum picture_*.png) && echo "film: $(ls film.one/picture_*.png | wc -l) pictures the same"
}

for part in ${PARTS:-loop batch slurm1 slurm2 second}; do
    case $part in
        slurm*) on_slurm "${part#slurm}" ;;
        *) $part ;;
    esac
done
